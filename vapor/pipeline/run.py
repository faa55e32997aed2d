"""Where sequence, observation model, filter, smoother, report and viewer meet: `vapor-track run` and `fuse`."""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
import platform
import resource
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from operator import attrgetter
from pathlib import Path
from typing import Any, Literal

import numpy as np

from filtering.error_model import ErrorModel
from filtering.errors import VaporTrackError
from filtering.estimate import Mode, posterior_modes
from filtering.kalman import KalmanConfig, KalmanLocalizer
from filtering.localizer import LocalizerConfig, ParticleLocalizer
from filtering.motion import Odometry
from filtering.posterior import ObservationModel
from filtering.rivals import GaussianSumLocalizer
from filtering.se3 import Poses
from filtering.smoothing import JUDGED_MODES, SMOOTHED_MODES, SmoothingConfig, agreement, smooth
from sequences.atomic import atomic_output
from sequences.estimates import EstimateSequence
from sequences.frame import Trajectory
from sequences.odometry_fit import OdometryFit
from sequences.options import SequenceOptions
from sequences.reader import SequenceReader
from sequences.results import results_folder
from sequences.tum import write_tum
from sequences.writer import EstimateWriter
from vapor.checkpoints.shipped_models import find_model
from vapor.evaluation.trajectory import FILES
from vapor.observation import VaporObservationModel
from vapor.reporting.record import RunRecord, RunRecorder
from vapor.reporting.report import build_report, told_doubtful, write_pictures, write_report, write_status
from vapor.reporting.rerun_viewer import NullViewer, RerunViewer
from vapor.threads import limited_threads
from vapor.training_data.ground import told_unshown

_PUBLISHED_PARTICLES = 500
_PACKAGES = ("vapor-track", "torch", "numpy", "scipy", "filterpy", "gtsam", "opencv-python-headless", "rerun-sdk")
RESULTS = frozenset(
    {
        *FILES.values(),
        *("ground_truth.tum", "status.csv", "config.json", "report.json", "estimate.mcap", "recording.rrd"),
        *("trajectory.png", "particles.png", "errors.png"),
    }
)
"""Names of all files that a run may write."""


@dataclass(frozen=True)
class FilteringConfig:
    """Settings of a run, whatever the observation model."""

    seed: int = 0
    """Of all random draws: same seed, same file, same machine, same output."""
    recording: bool = True
    """Write recording.rrd for the Rerun viewer."""
    view: bool = False
    """Open the Rerun viewer and stream into it."""
    localizer: LocalizerConfig = field(default_factory=LocalizerConfig)
    """The particle filter."""

    def __post_init__(self) -> None:
        if self.seed < 0:
            raise VaporTrackError(f"seed is {self.seed}, expected at least 0")


@dataclass(frozen=True)
class RunConfig(FilteringConfig):
    """Settings of a run with a regressor, beside the sequence and the model."""

    num_samples: int = 1000
    """Posterior samples per image."""
    device: Literal["auto", "cpu", "cuda"] = "auto"
    """Where the network runs."""
    threads: int = 1
    """Processor threads of the network. More pay for a large network on an idle machine; on a busy one they cost."""
    fitted_odometry: bool = True
    """Take the noise of the odometry from the model's calibration, where that had odometry to fit it from; else as the
    sequence states it."""

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("num_samples", "threads"):
            if getattr(self, name) < 1:
                raise VaporTrackError(f"{name} is {getattr(self, name)}, expected at least 1")


@dataclass(frozen=True)
class RunResult:
    """What a run found.

    Attributes:
        record: Everything collected on the way.
        report: Content of `report.json`.
        pictures: Names of the pictures in the output directory.
        notices: What a person should know of the sequence, the model and the smoothed trajectory.
    """

    record: RunRecord
    report: dict[str, Any]
    pictures: tuple[str, ...]
    notices: tuple[str, ...] = ()

    @property
    def few_images(self) -> str | None:
        """A sentence where fewer than half of the images were used."""
        return None if self.record.images is None else self.record.images.warning


@dataclass(frozen=True)
class LoadedModel:
    """A model ready for runs, whatever the number of sequences.

    Attributes:
        name: Name of its file, or the name it ships by.
        file: Where it lies.
        sha256: Of its file.
        observation: The model itself.
    """

    name: str
    file: Path
    sha256: str
    observation: VaporObservationModel


def load_model(model: str, config: RunConfig) -> LoadedModel:
    """Load a model for runs with some settings.

    Args:
        model: Model file, or name of a model that ships with the package.
        config: Settings.

    Raises:
        VaporTrackError: no such model, an unusable file, or no such device.
    """
    checkpoint = find_model(model)
    observation = VaporObservationModel.from_checkpoint(
        str(checkpoint), num_samples=config.num_samples, device=config.device
    )
    return LoadedModel(Path(model).name, checkpoint, hashlib.sha256(checkpoint.read_bytes()).hexdigest(), observation)


def run(
    sequence: Path,
    model: str | LoadedModel,
    output: Path,
    config: RunConfig | None = None,
    *,
    reading: SequenceOptions | None = None,
    overwrite: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> RunResult:
    """Localize a recorded sequence and write everything about it into a directory.

    Args:
        sequence: MCAP file or rosbag2 folder.
        model: Model file, name of a model that ships with the package, or what `load_model` made of one with these
            settings.
        output: Directory for the results, which appear when the run is complete, or not at all: absent, empty, or
            results, which are replaced (see `results_folder`).
        config: Settings.
        reading: What to read of the sequence; None for all of it, as found.
        overwrite: Take any directory as output, and replace in it what has the names of results.
        progress: Called after every image with the number done and an upper bound of all.

    Raises:
        VaporTrackError: unusable sequence, model or output, or fewer than one in ten of the images left to localize.
    """
    config = config or RunConfig()
    loaded = load_model(model, config) if isinstance(model, str) else model
    reads = files_read(sequence, loaded, reading)
    with results_folder(output, "run", writes=RESULTS, reads=reads, overwrite=overwrite) as directory:
        return run_into(directory, sequence, loaded, config, reading=reading, progress=progress)


def files_read(sequence: Path, model: LoadedModel, reading: SequenceOptions | None) -> list[Path]:
    """Files and folders that a run reads, as far as they are known before it."""
    return [sequence, model.file, *(() if reading is None else reading.files_read)]


def run_into(
    directory: Path,
    sequence: Path,
    model: LoadedModel,
    config: RunConfig,
    *,
    reading: SequenceOptions | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> RunResult:
    """As `run`, into a directory that is there, file by file."""
    reading = reading or SequenceOptions()
    reader = SequenceReader(sequence, reading)
    observation = model.observation.seen_by(reader.camera)

    with limited_threads(config.threads):
        calibration = observation.checkpoint.calibration
        fit = calibration.odometry if config.fitted_odometry else None
        record = localize(
            reader,
            observation,
            directory,
            config,
            calibration.errors,
            odometry_fit=fit,
            allow_few_images=reading.allow_few_images,
            progress=progress,
        )
        device = str(observation.device)
        settings = {"run": asdict(config) | {"device": device}, "reading": asdict(reading) | reader.resolved}
        settings = {
            "sequence": {"name": sequence.name, "images": reader.num_images, "odometry": reader.odometry_description},
            "model": {"name": model.name, "sha256": model.sha256},
            **settings,
        }
        result = write_results(record, directory, settings, title=sequence.name)
        notices = [*reader.notices, *observation.notices, *result.notices]
        if (memory := observation.checkpoint.memory) is not None and record.smoothed is not None:
            trained = Poses(memory.rotation.double().numpy(), memory.translation.double().numpy())
            notices += [told] if (told := told_unshown(record.smoothed.poses, trained)) else []
        return replace(result, notices=tuple(notices))


def localize(
    source: SequenceReader | EstimateSequence,
    model: ObservationModel,
    directory: Path,
    config: FilteringConfig,
    errors: ErrorModel,
    *,
    observed: Callable[[Any], np.ndarray] = attrgetter("image"),
    odometry_fit: OdometryFit | None = None,
    allow_few_images: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> RunRecord:
    """Frame by frame: observe, update, show, write; then smooth.

    Args:
        source: The frames.
        model: Maps what was observed to its posterior.
        directory: Where `estimate.mcap` and `recording.rrd` go.
        config: Settings.
        errors: How the model's posteriors err.
        observed: What the model takes of a frame.
        odometry_fit: How wrong the odometry is; None for what the frames state and the settings assume.
        allow_few_images: Go on also where fewer than one in ten of the images asked for were used.
        progress: Called after every frame with the number done and an upper bound of all.

    Raises:
        VaporTrackError: unusable frames, none, or fewer than one in ten of those asked for.
    """
    settings = config.localizer
    if odometry_fit is not None:
        settings = replace(settings, slow_errors=odometry_fit.slow_errors)
    localizer = ParticleLocalizer(model, settings, rng=np.random.default_rng(config.seed))
    kalman = KalmanLocalizer(KalmanConfig(slow_errors=settings.slow_errors, gap=settings.gap))
    gaussian_sum = GaussianSumLocalizer(None, settings, rng=np.random.default_rng(config.seed))
    recorder = RunRecorder()
    modes_of_images: list[tuple[Mode, ...]] = []
    odometry: list[Odometry | None] = []
    ways: list[float] = []
    kalman_poses: list[Poses] = []
    gaussian_sum_poses: list[Poses] = []
    single: Poses | None = None
    previous_ns: int | None = None
    recording = directory / "recording.rrd" if config.recording else None
    viewer = RerunViewer(recording, spawn=config.view) if recording or config.view else NullViewer()
    with viewer, EstimateWriter(directory / "estimate.mcap") as writer:
        for frame in source:
            elapsed_s = 0.0 if previous_ns is None else max(frame.time_ns - previous_ns, 0) * 1e-9
            previous_ns = frame.time_ns
            if frame.odometry is not None and odometry_fit is not None:
                frame = replace(frame, odometry=odometry_fit.restated(frame.odometry))
            begin = time.perf_counter()
            try:
                posterior = localizer.observe(observed(frame))
                estimate = localizer.update(posterior, frame.odometry, elapsed_s=elapsed_s)
            except VaporTrackError as error:
                raise VaporTrackError(f"{source.path}: image at {frame.time_ns} ns: {error}") from error
            step_ms = 1e3 * (time.perf_counter() - begin)
            alone = posterior_modes(posterior)
            if alone:
                single = alone[0].world_from_camera
            elif single is None:
                single = estimate.modes[0].world_from_camera
            modes_of_images.append(() if posterior.says_nothing else alone[:JUDGED_MODES])
            odometry.append(frame.odometry)
            ways.append(estimate.way)
            following = kalman.update(posterior, frame.odometry, elapsed_s=elapsed_s)
            kalman_poses.append(following.world_from_camera)
            bank = gaussian_sum.update(posterior, frame.odometry, elapsed_s=elapsed_s)
            gaussian_sum_poses.append(bank.modes[0].world_from_camera)
            recorder.add(frame, single, estimate, step_ms)
            modes = [(mode.world_from_camera, mode.covariance, mode.weight) for mode in estimate.modes]
            writer.write(frame.time_ns, modes, estimate.cloud(_PUBLISHED_PARTICLES))
            viewer.log(frame, estimate, posterior.samples)
            if progress is not None:
                progress(len(recorder), source.num_images)
    if source.counts.are_very_few and not allow_few_images:
        raise VaporTrackError(
            f"{source.path}: {source.counts.warning} Expected at least one in ten (--allow-few-images localizes fewer)"
        )
    record = recorder.finish(skipped=source.skipped, images=source.counts)
    sure = np.array([status == "converged" for status in record.status])
    smoothed = smooth(
        [modes[:SMOOTHED_MODES] for modes in modes_of_images],
        odometry,
        np.array(ways),
        record.filter,
        sure,
        errors,
        SmoothingConfig(slow_errors=settings.slow_errors),
    )
    return recorder.finish(
        skipped=source.skipped,
        images=source.counts,
        smoothed=Trajectory(record.times_ns, smoothed),
        smoothed_agreement=agreement(smoothed, record.times_ns, modes_of_images, errors),
        kalman=Trajectory(record.times_ns, Poses.stack(kalman_poses)),
        gaussian_sum=Trajectory(record.times_ns, Poses.stack(gaussian_sum_poses)),
        peak_rss_mb=peak_rss_mb(),
    )


def write_results(record: RunRecord, directory: Path, settings: dict[str, Any], *, title: str) -> RunResult:
    """Write trajectories, pictures, `config.json` (settings, and the versions they were used with), `report.json`."""
    for name, trajectory in record.methods.items():
        write_tum(directory / FILES[name], trajectory)
    if record.truth is not None:
        write_tum(directory / "ground_truth.tum", record.truth)
    write_status(directory / "status.csv", record)
    pictures = write_pictures(record, directory, title=title)
    versions = {"python": platform.python_version()} | {name: importlib.metadata.version(name) for name in _PACKAGES}
    with atomic_output(directory / "config.json") as partial:
        partial.write_text(json.dumps(settings | {"versions": versions}, indent=2) + "\n", encoding="utf-8")
    report = build_report(record)
    write_report(directory / "report.json", report)
    told = told_doubtful(record)
    return RunResult(record, report, tuple(picture.name for picture in pictures), (told,) if told else ())


def peak_rss_mb() -> float:
    """Peak resident memory of this process, MiB."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (2**20 if sys.platform == "darwin" else 2**10)
