"""Which local features and which solver of poses landmarks are best made of, on images as they are and disturbed.

No network is trained: the map is made of the training images of rows of `benchmark real`, and their test images are
localized where they look alike. Real images; what disturbs them is made.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import Bool

from filtering.errors import VaporTrackError, require_within
from filtering.se3 import Poses
from vapor.benchmark.real.rows import ROWS
from vapor.benchmark.real.trained_network import TrainedNetwork
from vapor.cache import cached, code_digest
from vapor.experiments.disturbances import DISTURBANCES, disturbed
from vapor.experiments.local_features import FEATURES
from vapor.experiments.pose_solvers import SOLVERS
from vapor.experiments.scenes import identities
from vapor.landmarks.build import BuiltMap, build, camera_found, gather
from vapor.landmarks.localize import LandmarkLocalizer
from vapor.landmarks.view_camera import ViewCamera
from vapor.parallel.jobs import Workers, in_parallel
from vapor.training_data.entries import open_sequences
from vapor.training_data.ground import near_scale_m
from vapor.training_data.load import load_training_set
from vapor.training_data.training_set import TrainingSet

_FRAME = 32, 24  # of the images that a network would see: none does
_RECORDINGS = "tum_fr1", "redkitchen", "hololens_rooms"


@dataclass(frozen=True)
class PartsConfig:
    """Settings of the experiment."""

    recordings: tuple[str, ...] = _RECORDINGS
    """Rows of `benchmark real` with images."""
    features: tuple[str, ...] = tuple(FEATURES)
    """Local features; those whose package is not installed are left out."""
    solvers: tuple[str, ...] = tuple(SOLVERS)
    """Robust solvers of poses."""
    disturbances: tuple[str, ...] = tuple(DISTURBANCES)
    """What is done to the test images; the map is made of images as they are."""
    every: int = 4
    """Of so many test images one is localized."""
    workers: int = 1
    """Maps at a time, each with one thread."""

    def __post_init__(self) -> None:
        require_within(self, every=(1, 10**6), workers=(1, 10**6))
        known = {"recordings": _RECORDINGS, "features": FEATURES, "solvers": SOLVERS, "disturbances": DISTURBANCES}
        for name, of in known.items():
            asked: tuple[str, ...] = getattr(self, name)
            if not asked or len(set(asked)) < len(asked):
                raise VaporTrackError(f"{name} are {', '.join(asked) or 'none'}, expected each at most once, and one")
            for each in asked:
                if each not in of:
                    raise VaporTrackError(f"unknown {each!r} in {name}, expected one of {', '.join(of)}")


@dataclass(frozen=True)
class Walks:
    """What a map is made of, and what is localized in it.

    Attributes:
        name: Of the recording.
        training: Files and folders of images with poses, as `train` takes them.
        test: Likewise, of other images.
        evaluated: Which of n of these are localized, (n,).
    """

    name: str
    training: tuple[str, ...]
    test: str
    evaluated: Callable[[int], Bool[np.ndarray, " n"]] = lambda n: np.ones(n, bool)


def walks_of(data: Path, recordings: Sequence[str]) -> tuple[list[Walks], list[str]]:
    """The recordings that are there, and a line on each that is not.

    Args:
        data: Folder with the recordings.
        recordings: Rows of `benchmark real`.

    Raises:
        VaporTrackError: none is there.
    """
    rows = {row.name: row for row in ROWS if isinstance(row, TrainedNetwork)}
    missing = {name: [need for need in rows[name].needs if not (data / need).exists()] for name in recordings}
    lines = [f"left out: {name}, for want of {', '.join(needs)}" for name, needs in missing.items() if needs]
    found = [_walks(data, rows[name]) for name in recordings if not missing[name]]
    if not found:
        lacking = ", ".join(dict.fromkeys(need for needs in missing.values() for need in needs))
        raise VaporTrackError(f"{data}: nothing to measure, expected any of {lacking} in it")
    return found, lines


def _walks(data: Path, row: TrainedNetwork) -> Walks:
    start, stop = row.frames
    test = f"{data / row.dataset}@{start}:{'' if stop is None else stop}"
    training = tuple(str(data / entry) for entry in row.training)
    return Walks(row.name, training, test, row.evaluated[""])


def features_left_out(features: Sequence[str]) -> list[str]:
    """A line on each kind of features that cannot be measured here."""
    kinds = {name: FEATURES[name] for name in features if FEATURES[name].lacking}
    return [
        f"left out: {name}, for want of {', '.join(kind.lacking)} (pip install --no-deps {' '.join(kind.packages)})"
        for name, kind in kinds.items()
    ]


def measured(
    walks: Sequence[Walks], directory: Path, config: PartsConfig, workers: Workers
) -> Iterator[list[dict[str, Any]]]:
    """Cells of each recording and kind of features, in no order; what is done is not done again.

    JSON of a cell: `recording`, `features`, `solver`, `disturbance`; `map`, of what it is made; of each image in turn
    `metres` and `degrees`, how far off the pose is that most landmarks verify, and `inliers`, how many (0, and None for
    the errors, where there is no pose); `features_ms` and `pose_ms`, medians of processor time an image.
    """
    there = [name for name in config.features if not FEATURES[name].lacking]
    jobs = [(each, name, config, directory) for each in walks for name in there]
    yield from in_parallel(_cells, jobs, workers)


def _cells(walks: Walks, features: str, config: PartsConfig, directory: Path) -> list[dict[str, Any]]:
    settings = {
        "data": identities([*walks.training, walks.test]),
        "features": features,
        "versions": FEATURES[features].versions,
        "solvers": config.solvers,
        "disturbances": config.disturbances,
        "every": config.every,
        "code": code_digest(
            "vapor.landmarks",
            "vapor.training_data",
            "vapor.benchmark.real.rows",
            "vapor.experiments.landmarks",
            "vapor.experiments.local_features",
            "vapor.experiments.pose_solvers",
            "vapor.experiments.disturbances",
        ),
    }
    file = directory / "parts" / f"{walks.name}-{features}"
    return cached(file, settings, lambda: _localized(walks, features, config))


def _localized(walks: Walks, features: str, config: PartsConfig) -> list[dict[str, Any]]:
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        training = load_training_set(open_sequences(walks.training), _FRAME, views=True)
        test = load_training_set(open_sequences([walks.test]), _FRAME, views=True, view_camera=training.view_camera)
        evaluated = np.flatnonzero(walks.evaluated(len(test)))
        test = test.select(evaluated[:: config.every])
        built = _map(training, features)
        return [
            {"recording": walks.name, "features": features, "solver": solver, "disturbance": disturbance, **cell}
            for disturbance in config.disturbances
            for solver, cell in _by_solver(built, test, features, config.solvers, disturbance).items()
        ]
    finally:
        cv2.setNumThreads(threads)


def _map(training: TrainingSet, features: str) -> BuiltMap | None:
    """The map of training images, by the camera that fits them."""
    if training.view_camera is None:
        return None
    extractor = FEATURES[features].extractor
    material = gather(
        lambda image: training.views[training.rows[image]],
        training.poses,
        training.view_camera,
        scale_m=near_scale_m(training.poses),
        extractor=extractor,
    )
    if material is None:
        return None
    stated = ViewCamera(training.view_camera)
    found = camera_found(material, stated)
    return build(material, stated if found is None else found.camera)


def _by_solver(
    built: BuiltMap | None, test: TrainingSet, features: str, solvers: Sequence[str], disturbance: str
) -> dict[str, dict[str, Any]]:
    """How images are localized, by the solver."""
    if built is None:
        none = {"metres": [None] * len(test), "degrees": [None] * len(test), "inliers": [0] * len(test)}
        return {solver: {"map": None, **none, "features_ms": None, "pose_ms": None} for solver in solvers}
    material, pinhole = built.material, built.camera.camera
    about = {
        "key_images": len(material.key),
        "points": len(built.points),
        "agreeing": built.agreeing,
        "focal_px": pinhole.fx,
        "size": [pinhole.width, pinhole.height],
    }
    kind = FEATURES[features]
    limits = {"extractor": kind.extractor, "ratio": kind.ratio, "cosine": kind.cosine}
    localizers = {s: LandmarkLocalizer(built.landmarks, solver=SOLVERS[s], **limits) for s in solvers}
    first = next(iter(localizers.values()))
    found: dict[str, list[tuple[float | None, float | None, int]]] = {solver: [] for solver in solvers}
    features_ms: list[float] = []
    pose_ms: dict[str, list[float]] = {solver: [] for solver in solvers}
    for image in range(len(test)):
        view = disturbed(test.views[test.rows[image]], disturbance, image)
        began = time.process_time()
        seen = first.features(view)
        features_ms.append(time.process_time() - began)
        for solver, localizer in localizers.items():
            began = time.process_time()
            poses = localizer.localize(seen)
            pose_ms[solver].append(time.process_time() - began)
            found[solver].append(
                (*_errors(poses[0].world_from_camera, test.poses[image]), poses[0].inliers)
                if poses
                else (None, None, 0)
            )
    return {
        solver: {
            "map": about,
            "metres": [metres for metres, _, _ in rows],
            "degrees": [degrees for _, degrees, _ in rows],
            "inliers": [inliers for _, _, inliers in rows],
            "features_ms": 1e3 * float(np.median(features_ms)),
            "pose_ms": 1e3 * float(np.median(pose_ms[solver])),
        }
        for solver, rows in found.items()
    }


def _errors(pose: Poses, truth: Poses) -> tuple[float, float]:
    metres, radians = pose.distance(truth)
    return float(metres), float(np.degrees(radians))
