"""The rows of `vapor-track benchmark real`: recordings made by others, and how each is brought before the filter."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float64

from filtering.error_model import ErrorModel
from filtering.errors import VaporTrackError
from filtering.localizer import LocalizerConfig
from filtering.motion import MotionNoise, Odometry
from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from sequences.convert import BASE_FROM_CAMERA, convert
from sequences.estimates import EstimateOptions, EstimateSequence
from sequences.odometry import OdometryNoise, simulate_odometry
from sequences.odometry_fit import OdometryStretch, fit_odometry
from sequences.pairing import odometry_between
from sequences.values import read_arrays
from vapor.benchmark.recordings import FileSettings, load_recording, record_file
from vapor.cache import code_digest, digest
from vapor.calibration.calibrate import calibrate
from vapor.calibration.familiarity import EXEMPLARS, learn_familiarity
from vapor.calibration.image_errors import fit_errors
from vapor.calibration.observations import Observations
from vapor.calibration.travel import Travel
from vapor.checkpoints.checkpoint import Checkpoint
from vapor.checkpoints.file_format import load_checkpoint, save_checkpoint
from vapor.checkpoints.scene_scale import default_errors
from vapor.checkpoints.thinning import spaced
from vapor.pipeline.fuse import EstimateConfig, EstimateModel, errors_of, over_sequences
from vapor.tracking.methods import Passage, posterior_of
from vapor.training.presets import PRESETS
from vapor.training.train import Progress, TrainConfig, train
from vapor.training_data.entries import open_sequences
from vapor.training_data.load import load_training_set

Advance = Callable[[str, int, int | None], None]
"""Told what is done, how much of it, and how much there is."""


@dataclass(frozen=True)
class Draw:
    """One draw of a row, ready to be localized.

    Attributes:
        passage: n images.
        errors: How they err.
        localizer: Settings of the filter.
        judged: Images to judge by, (n,), by what they are; the empty name is that of the row itself.
        unit_m: Lengths are judged in units of so many metres.
    """

    passage: Passage
    errors: ErrorModel
    localizer: LocalizerConfig
    judged: Mapping[str, Bool[np.ndarray, " n"]]
    unit_m: float = 1.0


@runtime_checkable
class Row(Protocol):
    """A recording that methods are judged by."""

    @property
    def name(self) -> str:
        """Of its own."""
        ...

    @property
    def group(self) -> str:
        """Name of the rows that differ in one thing only."""
        ...

    @property
    def simulated(self) -> bool:
        """Whether there are several draws of its odometry."""
        ...

    @property
    def unit_m(self) -> float:
        """Lengths are judged in units of so many metres."""
        ...

    @property
    def needs(self) -> tuple[str, ...]:
        """Files and folders of the data."""
        ...

    def prepare(self, place: Place, seed: int) -> dict[str, Any]:
        """Make what a draw needs and is not there yet; gives all that its result depends on beside code, as JSON."""
        ...

    def draw(self, place: Place, seed: int, config: LocalizerConfig) -> Draw:
        """A draw that was prepared."""
        ...


@dataclass(frozen=True)
class Place:
    """Where a benchmark finds its data and keeps what it makes.

    Attributes:
        data: Folder with the recordings of others.
        output: Folder for models, sequences and recordings.
        num_samples: Posterior samples per image.
        advance: Told what is being made.
    """

    data: Path
    output: Path
    num_samples: int = 1000
    advance: Advance = field(default=lambda what, done, total: None, compare=False)

    def folder(self, name: str) -> Path:
        """A folder of the output, made if absent."""
        folder = self.output / name
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise VaporTrackError(
                f"{folder}: cannot write: {error.strerror or error}, expected a directory that can be written to"
            ) from error
        return folder


@dataclass(frozen=True)
class Trained:
    """Images that a network is trained on, calibrated on others of them, and localized in the rest.

    Attributes:
        name: Of the row.
        training: Folders of the data, `PATH@START:STOP`.
        held_out: Likewise.
        config: How to train.
        dataset: Folder of the data with the images that are localized.
        frames: The first of them, and the one after the last; None: to the end.
        odometry: File of the data with recorded odometry; None: it is simulated.
        judged: Which of n images are judged, by what they are.
    """

    name: str
    training: tuple[str, ...]
    held_out: tuple[str, ...]
    config: TrainConfig
    dataset: str
    frames: tuple[int, int | None] = (0, None)
    odometry: str | None = None
    judged: Mapping[str, Callable[[int], Bool[np.ndarray, " n"]]] = field(
        default_factory=lambda: {"": lambda n: np.ones(n, bool)}
    )
    unit_m: float = 1.0

    @property
    def group(self) -> str:
        """It differs from all others."""
        return self.name

    @property
    def simulated(self) -> bool:
        """Whether there are several draws of its odometry."""
        return self.odometry is None

    @property
    def needs(self) -> tuple[str, ...]:
        """Files and folders of the data."""
        folders = [entry.split("@")[0] for entry in (*self.training, *self.held_out)]
        return tuple(dict.fromkeys([*folders, self.dataset, *([self.odometry] if self.odometry else [])]))

    def prepare(self, place: Place, seed: int) -> dict[str, Any]:
        """Convert, train, calibrate, and ask the network about every image."""
        file, _ = self._sequence(place, seed)
        if not file.is_file():
            place.advance("converting", seed, None)
            recorded = None if self.odometry is None else place.data / self.odometry
            noise = OdometryNoise() if recorded is None else None
            convert(
                place.data / self.dataset,
                file,
                odometry=recorded,
                odometry_noise=noise,
                frames=slice(*self.frames),
                seed=seed,
            )
        model = self._calibrated(place)
        checkpoint = load_checkpoint(model)
        settings, recordings = self._recording(place, seed, checkpoint), place.folder("recordings")
        if not (recordings / settings.name).is_dir():
            place.advance("asking the network", seed, None)
            record_file(settings, file, checkpoint, recordings)
        return {"recording": settings.told, "calibration": asdict(checkpoint.calibration)}

    def draw(self, place: Place, seed: int, config: LocalizerConfig) -> Draw:
        """The posteriors of the network, and the odometry of the converted file."""
        checkpoint = load_checkpoint(self._calibrated(place))
        recording = load_recording(self._recording(place, seed, checkpoint), place.folder("recordings"))
        errors, fit = checkpoint.calibration.errors, checkpoint.calibration.odometry

        def posterior(image: int) -> PosePosterior:
            return posterior_of(recording.posterior_poses(image), errors, float(recording.unfamiliarity[image]))

        n = len(recording.times_ns)
        truth, odometry = recording.path.world_from_camera, tuple(recording.motion(i) for i in range(n))
        return Draw(
            Passage(recording.times_ns, odometry, truth, posterior).restated(fit),
            errors,
            config if fit is None else replace(config, slow_errors=fit.slow_errors),
            {what: of(n) for what, of in self.judged.items()},
        )

    @cached_property
    def _training_settings(self) -> dict[str, Any]:
        content = {"training": self.training, "held_out": self.held_out, "config": self.config.settings()}
        return json.loads(json.dumps(content))

    def _trained(self, place: Place) -> Path:
        """The model file, trained if it is not there; an interrupted training goes on."""
        file = place.folder("models") / f"{self.name}-{digest(self._training_settings)}.safetensors"
        if not file.is_file():

            def report(progress: Progress) -> None:
                place.advance(progress.stage, progress.done, progress.total)

            training, held_out = ([place.data / entry for entry in part] for part in (self.training, self.held_out))
            train(training, file, self.config, validation=held_out, progress=report)
        return file

    def _calibrated(self, place: Place) -> Path:
        """The model with what the calibration of today makes of it: anew where its code has changed."""
        trained = self._trained(place)
        file = trained.with_name(f"{trained.stem}-calibrated-{_calibration_code()}.safetensors")
        if file.is_file():
            return file
        place.advance("calibrating", 0, None)
        checkpoint = load_checkpoint(trained)
        training, held_out = (
            load_training_set(
                open_sequences([place.data / entry for entry in part]), checkpoint.network.frame_size, central=True
            )
            for part in (self.training, self.held_out)
        )
        network, most = checkpoint.build_network(), self.config.validation_images
        judged = held_out.select(spaced(len(held_out), most))
        familiar = learn_familiarity(network, training.select(spaced(len(training), EXEMPLARS)), judged)
        result = calibrate(
            network,
            held_out,
            checkpoint.prior_poses,
            checkpoint.calibration,
            training=training,
            familiarity=familiar,
            max_images=most,
            seed=self.config.seed,
            advance=lambda done, total: place.advance("calibrating", done, total),
        )
        provenance = {**checkpoint.training, "calibration": result.provenance}
        calibrated = replace(
            checkpoint,
            calibration=result.calibration,
            familiarity=familiar,
            training=json.loads(json.dumps(provenance)),
        )
        save_checkpoint(file, calibrated, store_float16=self.config.half)
        return file

    def _sequence(self, place: Place, seed: int) -> tuple[Path, str]:
        """The converted file, and a digest of what it is made from."""
        noise = asdict(OdometryNoise()) if self.odometry is None else self.odometry
        made = digest({"dataset": self.dataset, "frames": self.frames, "odometry": noise, "seed": seed})
        return place.folder("sequences") / f"{self.name}-{seed}-{made}.mcap", made

    def _recording(self, place: Place, seed: int, checkpoint: Checkpoint) -> FileSettings:
        file, made = self._sequence(place, seed)
        return FileSettings(file.stem, made, checkpoint.seen_sha256(), seed, place.num_samples)


@dataclass(frozen=True)
class Stored:
    """Posterior samples of a network that others trained, with odometry of which the file holds one draw.

    How images err and how wrong the odometry is are fitted on the first half, the former on images that the network was
    not trained on; the second half is judged.

    Attributes:
        name: Of the row.
        file: Of the data.
        own_seed: That of the draw in the file; further draws count up from it.
    """

    name: str
    file: str
    own_seed: int
    unit_m: float = 1.0
    simulated: bool = True

    @property
    def group(self) -> str:
        """It differs from all others."""
        return self.name

    @property
    def needs(self) -> tuple[str, ...]:
        """Files and folders of the data."""
        return (self.file,)

    def prepare(self, place: Place, seed: int) -> dict[str, Any]:
        """Nothing to make."""
        return {"file": self.file, "seed": seed}

    def draw(self, place: Place, seed: int, config: LocalizerConfig) -> Draw:
        """The file's own odometry, or another draw of it; all is fitted on the first half."""
        stored = read_arrays(place.data / self.file)
        times_ns, previous_from_current = stored["time_ns"], _poses(stored["previous_from_current"])
        covariance, trained_on = stored["odometry_covariance"], stored["trained_on"]
        samples, truth = [_poses(each) for each in stored["samples"]], _poses(stored["truth"])
        n = len(times_ns)
        steps_s = np.diff(times_ns, prepend=times_ns[:1]) * 1e-9
        odometry = tuple(Odometry(previous_from_current[i], covariance[i], float(steps_s[i])) for i in range(n))
        if seed > 0:
            rng = np.random.default_rng(self.own_seed + seed)
            odometry = simulated_motions(times_ns, truth, OdometryNoise(), rng=rng)
        first = np.arange(n) < n // 2
        fit = fit_odometry([OdometryStretch(odometry[1 : n // 2], truth[first])])
        (unseen,) = np.nonzero(first & ~trained_on)
        way = Travel.along(truth[unseen], np.cumsum(np.diff(unseen, prepend=unseen[:1]) > 1))
        scene = truth[trained_on]  # the places that the network knows
        seen = Observations([samples[i] for i in unseen], truth[unseen])
        errors = fit_errors(seen, way, scene, default_errors(scene)).errors
        passage = Passage(times_ns, odometry, truth, lambda image: PosePosterior.from_samples(samples[image], errors))
        localizer = replace(config, slow_errors=fit.slow_errors)
        return Draw(passage.restated(fit), errors, localizer, {"": ~first})


@dataclass(frozen=True)
class Estimates:
    """Pose estimates of others, with simulated odometry.

    Attributes:
        name: Of the row.
        group: Of all rows of the same unit.
        files: Of the data, one for each method.
        truth: File of the data with true poses.
        unit_m: So many metres are taken for one: all lengths are larger by this factor, those of noise too.
    """

    name: str
    group: str
    files: tuple[str, ...]
    truth: str
    unit_m: float = 1.0
    simulated: bool = True

    @property
    def needs(self) -> tuple[str, ...]:
        """Files and folders of the data."""
        return (*self.files, self.truth)

    def prepare(self, place: Place, seed: int) -> dict[str, Any]:
        """Nothing to make."""
        return {"files": self.needs, "unit_m": self.unit_m, "seed": seed, "trust": asdict(EstimateConfig())}

    def draw(self, place: Place, seed: int, config: LocalizerConfig) -> Draw:
        """The estimates with odometry simulated from the true poses, all lengths in the unit."""
        usual, noise = EstimateConfig(), OdometryNoise()
        trust = replace(usual, std_m=tuple(std_m * self.unit_m for std_m in usual.std_m))
        noise = replace(
            noise,
            translation_bias_m_per_s=noise.translation_bias_m_per_s * self.unit_m,
            translation_white_m_per_sqrt_s=noise.translation_white_m_per_sqrt_s * self.unit_m,
        )
        sequence = EstimateSequence(
            [place.data / file for file in self.files],
            simulate_odometry_from=place.data / self.truth,
            options=EstimateOptions(direction="world-to-camera", noise=noise, unit_m=self.unit_m),
            seed=seed,
        )
        errors = errors_of(sequence, trust)
        model = EstimateModel(len(self.files), trust, errors)
        frames = list(sequence)
        truth = [frame.world_from_camera for frame in frames if frame.world_from_camera is not None]
        if len(truth) < len(frames):
            raise VaporTrackError(
                f"{self.truth}: no true pose of {len(frames) - len(truth)} frames, expected one of all"
            )
        rng = np.random.default_rng(0)  # nothing is drawn of it
        return Draw(
            Passage(
                np.array([frame.time_ns for frame in frames], np.int64),
                tuple(frame.odometry for frame in frames),
                Poses.stack(truth),
                lambda image: model.observe(frames[image].estimates, rng=rng),
            ),
            errors,
            over_sequences(config),
            {"": np.ones(len(frames), bool)},
            self.unit_m,
        )


def simulated_motions(
    times_ns: np.ndarray, truth: Poses, noise: OdometryNoise, *, rng: np.random.Generator
) -> tuple[Odometry, ...]:
    """Motion of a camera since the image before, (n,), as a reader finds it in a sequence that `convert` wrote.

    Args:
        times_ns: Stamps of the images, strictly increasing, (n,).
        truth: world_from_camera, batch (n,).
        noise: Of the odometry.
        rng: Of its errors.
    """
    odom_from_base, twist = simulate_odometry(times_ns, truth @ BASE_FROM_CAMERA.inverse(), noise, rng=rng)
    spans = pairwise([times_ns[0], *times_ns])
    return tuple(
        odometry_between(
            times_ns,
            odom_from_base,
            twist,
            int(start),
            int(end),
            base_from_camera=BASE_FROM_CAMERA,
            motion_noise=MotionNoise(),
        )
        for start, end in spans
    )


def _poses(rows: Float64[np.ndarray, "n 7"]) -> Poses:
    """From rows of tx ty tz qx qy qz qw."""
    rows = np.asarray(rows, np.float64)
    return Poses.from_quat_xyzw(rows[:, :3], rows[:, 3:])


def _calibration_code() -> str:
    """Digest of the code that calibration depends on."""
    return code_digest("sequences.odometry_fit", "vapor.calibration", "vapor.checkpoints", "vapor.training_data")


def _config(preset: str, epochs: int, width: int, height: int, shortest: int) -> TrainConfig:
    chosen = PRESETS[preset]
    network = replace(chosen.network, image_width=width, image_height=height, shortest_edge=shortest)
    return replace(chosen, network=network, epochs=epochs, calibrate=False)


def _tum_fr1() -> Trained:
    """Two sequences of one desk: one of them and half of the other trained on, the rest localized."""
    rpy, xyz = (f"tum_fr1/rgbd_dataset_freiburg1_{name}" for name in ("rpy", "xyz"))
    return Trained(
        "tum_fr1",
        (f"{rpy}@0:651", f"{xyz}@0:359"),
        (f"{rpy}@651:", f"{xyz}@359:399"),
        _config("demo", 20, 128, 128, 146),
        xyz,
        (399, None),
        f"{xyz}/rgbdslam_drift.txt",
    )


def _redkitchen() -> Trained:
    """One sequence: its end trained on, its beginning localized."""
    folder = "7scenes_redkitchen/seq-01"
    config = _config("efficientnet-lite0", 20, 96, 72, 80)
    return Trained("redkitchen", (f"{folder}@300:930",), (f"{folder}@930:1000",), config, folder, (0, 300))


def _hololens_rooms() -> Trained:
    """One walk: 20 of every 30 images trained on, the last two of them held out; all localized, the others judged."""
    folder, images, trained, block = "hololens_rooms/seq-01", 373, 20, 30
    spans = [(start, min(start + trained, images)) for start in range(0, images, block)]
    tails = [(stop - round(0.1 * (stop - start)), stop) for start, stop in spans]
    return Trained(
        "hololens_rooms",
        tuple(f"{folder}@{start}:{tail}" for (start, _), (tail, _) in zip(spans, tails, strict=True)),
        tuple(f"{folder}@{tail}:{stop}" for tail, stop in tails),
        _config("efficientnet-lite0", 40, 120, 80, 88),
        folder,
        judged={"": lambda n: np.arange(n) % block >= trained, "all": lambda n: np.ones(n, bool)},
    )


SCALE = 30.0
"""How much larger the scaled rows are: a car park instead of a room."""


def _stairs(scale: float = 1.0) -> Sequence[Estimates]:
    """Six methods' estimates of a repetitive staircase, each alone and all together."""
    folder, group = "7scenes_stairs", "stairs" if scale == 1.0 else f"stairs_x{scale:g}"
    methods = {
        name: f"{folder}/estimates/stairs_{name}.txt"
        for name in ("hloc", "r2d2_rgb", "r2d2_rgbd", "as", "dsac_rgb", "dsac_rgbd")
    }
    inputs = {name: (file,) for name, file in methods.items()} | {
        "all": tuple(methods[name] for name in sorted(methods))
    }
    truth = f"{folder}/stairs_test.txt"
    return [Estimates(f"{group}_{name}", group, files, truth, scale) for name, files in inputs.items()]


# To add one: a row of one of these kinds, or another class with their properties.
ROWS: tuple[Row, ...] = (
    _tum_fr1(),
    _redkitchen(),
    _hololens_rooms(),
    Stored("corridor_posteriors", "corridor_posteriors/floor.npz", own_seed=4),
    *_stairs(),
    *_stairs(SCALE),
)
