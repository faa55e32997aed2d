"""One building: training walks, a model as `train` makes it, and test walks, each localized as `run` does."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro

from filtering.errors import VaporTrackError, require_within
from sequences.frame import Trajectory
from sequences.options import SequenceOptions
from sequences.scenes.building.plan import draw_plan
from sequences.scenes.building.ways import ways
from vapor.benchmark.rendered import RenderedWalk
from vapor.cache import cached, code_digest, digest
from vapor.checkpoints.file_format import load_checkpoint
from vapor.evaluation.consistency import REGIONS
from vapor.evaluation.trajectory import RIGHT, associate, is_right
from vapor.pipeline.config import RunConfig
from vapor.pipeline.run import run
from vapor.reporting.record import RunRecord
from vapor.training.config import TrainConfig
from vapor.training.presets import PRESETS
from vapor.training.train import train

SHOWN = ("single_image", "kalman", "filter", "smoothed")
"""Methods whose figures are kept."""

_IMAGES_A_METRE = 1.5
_SLOW_HZ, _USUAL_HZ, _VISUAL_HZ = 2.0, 2.5, 10.0
_LOCALIZED = "/camera/image/compressed"
_TRAINED_BY = (
    "sequences",
    "vapor.calibration",
    "vapor.cameras",
    "vapor.checkpoints",
    "vapor.images",
    "vapor.landmarks",
    "vapor.regressors",
    "vapor.training",
    "vapor.training_data",
)
_LOCALIZED_BY = (
    "sequences",
    "vapor.benchmark.buildings",
    "vapor.cameras",
    "vapor.engines",
    "vapor.evaluation",
    "vapor.images",
    "vapor.landmarks",
    "vapor.observation",
    "vapor.pipeline",
    "vapor.reporting.record",
    "vapor.reporting.report",
    "vapor.tracking",
)


@dataclass(frozen=True)
class BuildingsConfig:
    """Settings of a benchmark of buildings."""

    training_walks: int = 5
    """Walks to learn from in each building, by day and with nobody else there; five go all the way round."""
    test_walks: int = 2
    """Walks to localize, at another hour and among people."""
    cameras: int = 1
    """Cameras of the robot, evenly all round; with several, the one that is localized is also used alone."""
    imu: bool = False
    """Have an inertial unit on test walks, and also localize them without it."""
    frames: tuple[int, int] = (600, 1200)
    """Images of a training walk: one and a half for each metre of the tour, at least and at most so many."""
    test_frames: int = 400
    """Images of a test walk; with odometry from images it takes as long, at ten images a second."""
    height: int = 120
    """Height of the images, which are 4:3, pixels."""
    train: TrainConfig = PRESETS["auto"]
    """How each model is trained; by default as `train` does without options."""
    run: Annotated[RunConfig, tyro.conf.arg(name="")] = field(default_factory=lambda: RunConfig(recording=False))

    def __post_init__(self) -> None:
        least, most = self.frames
        require_within(
            self,
            training_walks=(1, 100),
            test_walks=(1, 1000),
            cameras=(1, 8),
            test_frames=(2, 10**6),
            height=(8, 10**4),
        )
        if not 2 <= least <= most:
            raise VaporTrackError(f"frames are {least} and {most}, expected at least 2, and the larger number last")


@dataclass(frozen=True)
class Building:
    """A building by its number, and what is done in it.

    Raises:
        VaporTrackError: no building has this number.
    """

    number: int
    config: BuildingsConfig

    def __post_init__(self) -> None:
        _ = self.tour_m  # refuses the number before anything is rendered

    @property
    def scene(self) -> str:
        """Its name as a scene."""
        return f"building-{self.number}"

    @cached_property
    def tour_m(self) -> float:
        """Length of the tour through all of it, metres."""
        return float(ways(draw_plan(self.number)).lengths_m()[-1])

    @property
    def training_walks(self) -> list[RenderedWalk]:
        """Walks round its tour."""
        c, metres = self.config, self.tour_m
        frames = int(np.clip(round(_IMAGES_A_METRE * metres), *c.frames))
        return [self._walk("train", seed, frames, frames / (2.0 * metres)) for seed in range(c.training_walks)]

    @property
    def test_walks(self) -> list[RenderedWalk]:
        """Walks from one place to another, at the rate of the training walks unless that is slow."""
        c, usual = self.config, self.training_walks[0].rate_hz
        assert usual is not None
        rate_hz, frames = usual if usual >= _SLOW_HZ else _USUAL_HZ, c.test_frames
        if c.run.odometry in ("visual", "both"):
            rate_hz, frames = _VISUAL_HZ, round(frames * _VISUAL_HZ / rate_hz)
        return [self._walk("test", seed, frames, rate_hz) for seed in range(c.test_walks)]

    def _walk(self, split: Any, seed: int, frames: int, rate_hz: float) -> RenderedWalk:
        c = self.config
        inertial = c.imu and split == "test"
        return RenderedWalk(self.scene, split, seed, frames, c.height, rate_hz, c.cameras, inertial)

    @property
    def ways_to_read(self) -> Mapping[str, SequenceOptions]:
        """What is read of a test walk, each for itself, by a name for it; one without a name."""
        cameras = {"": {}}
        if self.config.cameras > 1:
            cameras = {"one camera": {"image_topic": _LOCALIZED}, f"{self.config.cameras} cameras": {}}
        units = {"no imu": {"imu_topic": ""}, "imu": {}} if self.config.imu else {"": {}}
        return {
            ", ".join(filter(None, names)): SequenceOptions(**cameras[names[0]], **units[names[1]])
            for names in product(cameras, units)
        }


def measure_building(building: Building, directory: Path) -> list[dict[str, Any]]:
    """The results of all test walks of a building; files and results that are there already are kept.

    A model depends on the code that makes it, a result on all code: both are made anew where that has changed. An
    interrupted training goes on.

    Returns:
        For each walk and way to read it: `building`, `tour_m`, `walk`, `reads`, what `figures` gives, `run_s` and
        `train_s` (wall-clock seconds), and of the model `landmarks`, the number of its points, None without a map.
    """
    for walk in (*building.training_walks, *building.test_walks):
        walk.render(directory)
    model, trained = _trained(building, directory)
    results = []
    for number, walk in enumerate(building.test_walks):
        for reads, reading in building.ways_to_read.items():
            names = {"building": building.number, "tour_m": building.tour_m, "walk": number, "reads": reads}
            results.append(names | trained | _localized(walk, reads, reading, model, building.config.run, directory))
    return results


def _trained(building: Building, directory: Path) -> tuple[Path, dict[str, Any]]:
    """The model file, and what it is."""
    walks, config = building.training_walks, building.config.train
    settings = json.loads(
        json.dumps(
            {
                "walks": [walk.name for walk in walks],
                "config": config.settings(),
                "code": code_digest(*_TRAINED_BY),
            },
            default=str,
        )
    )
    file = directory / "models" / f"{building.scene}-{digest(settings)}.safetensors"
    file.parent.mkdir(exist_ok=True)

    def compute() -> dict[str, Any]:
        begin_s = time.monotonic()
        if not file.is_file():
            train([walk.file(directory) for walk in walks], file, config)
        landmarks = load_checkpoint(file).landmarks
        points = None if landmarks is None else len(landmarks.map.points)
        return {"train_s": time.monotonic() - begin_s, "landmarks": points}

    return file, cached(directory / "models" / building.scene, settings, compute)


def _localized(
    walk: RenderedWalk, reads: str, reading: SequenceOptions, model: Path, config: RunConfig, directory: Path
) -> dict[str, Any]:
    name = "-".join([walk.name, *reads.replace(",", "").split()])
    settings = {"model": model.name, "reads": asdict(reading), "config": asdict(config)}
    settings = json.loads(json.dumps(settings | {"code": code_digest(*_LOCALIZED_BY)}, default=str))

    def compute() -> dict[str, Any]:
        begin_s = time.monotonic()
        result = run(walk.file(directory), str(model), directory / "runs" / name, config, reading=reading)
        return figures(result.record, result.report) | {"run_s": time.monotonic() - begin_s}

    return cached(directory / "results" / name, settings, compute)


def figures(record: RunRecord, report: Mapping[str, Any]) -> dict[str, Any]:
    """What a run with true poses is worth, as JSON.

    Returns:
        `images`; `methods`: for each of `SHOWN` `right` (fraction of the images within 0.3 m and 20°), `median_m`,
        `median_deg`, and `right_from_s` (from when on it is right, see `convergence_s`; None for never, and of single
        images); `status`: fraction of the images by the filter's status; `wrong`: fraction of the `converged` images
        that are not right; `coverage` and `smoothed_coverage`: by region, of the filter's `converged` images, and of
        the smoothed poses that fit (None where there are none); `first_right_s`, `first_converged_s`: when the filter
        is so for the first time, seconds since the first image (None for never); `verified`: fraction of the images in
        which landmarks verify a place, None without a map; `height_m`, `tilt_deg`, `rotation_deg`: median errors of
        filter and smoothed poses over their right images, None where there are none.
    """
    assert record.truth is not None
    first = {name: _first_s(record, flags) for name, flags in _flags(record).items()}
    hindsight = report["hindsight"]
    return {
        "images": report["frames"],
        "methods": {
            name: {
                "right": report[name]["recall"][RIGHT],
                "median_m": report[name]["median_translation_m"],
                "median_deg": report[name]["median_rotation_deg"],
                "right_from_s": report[name].get("converged_at_s"),
            }
            for name in SHOWN
        },
        "status": report["status"],
        "wrong": report["consistency"]["wrong"],
        "coverage": report["consistency"]["coverage"] or dict.fromkeys(REGIONS),
        "smoothed_coverage": hindsight["consistency"]["coverage"] or dict.fromkeys(REGIONS),
        **first,
        "verified": report.get("verified"),
        **_upright_errors(record.methods, record.truth),
    }


def _flags(record: RunRecord) -> Mapping[str, np.ndarray]:
    """Of each image with a true pose, whether the filter is right; of all images, whether it is converged."""
    assert record.truth is not None
    trajectory = record.methods["filter"]
    found, truth = associate(trajectory.times_ns, record.truth)
    right = np.zeros(len(found), bool)
    right[found] = is_right(trajectory.poses[found], truth)
    return {"first_right_s": right, "first_converged_s": np.array([each == "converged" for each in record.status])}


def _first_s(record: RunRecord, flags: np.ndarray) -> float | None:
    if not flags.any():
        return None
    return float(record.times_ns[np.argmax(flags)] - record.times_ns[0]) / 1e9


def _upright_errors(methods: Mapping[str, Trajectory], truth: Trajectory) -> dict[str, dict[str, float | None]]:
    """Median errors of height, of where up is, and of rotation, over the images that are right."""
    errors: dict[str, dict[str, float | None]] = {"height_m": {}, "tilt_deg": {}, "rotation_deg": {}}
    for name in ("filter", "smoothed"):
        found, true_poses = associate(methods[name].times_ns, truth)
        poses = methods[name].poses[found]
        right = is_right(poses, true_poses)
        poses, true_poses = poses[right], true_poses[right]
        cosine = np.einsum("ni,ni->n", poses.rotation[:, 2], true_poses.rotation[:, 2])  # of up, in the camera
        values = {
            "height_m": np.abs(poses.translation[:, 2] - true_poses.translation[:, 2]),
            "tilt_deg": np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))),
            "rotation_deg": np.degrees(poses.distance(true_poses)[1]),
        }
        for key, each in values.items():
            errors[key][name] = float(np.median(each)) if len(each) else None
    return errors
