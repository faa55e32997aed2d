"""One run of `vapor-track run`: a recorded sequence, localized with a model."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from hashlib import sha256
from pathlib import Path

import numpy as np
from jaxtyping import Int64, UInt8

from filtering.errors import VaporTrackError
from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from sequences.datasets import listing
from sequences.datasets.listing import as_typed, require_recording
from sequences.frame import Camera, Frame
from sequences.frame_source import FrameSource, RestatedSequence
from sequences.image_sequence import ImageSequence, is_image_sequence
from sequences.inertial.motion_sensors import Up
from sequences.inertial.sequence import InertialSequence
from sequences.inertial.topics import read_inertial, read_rides, without_metres
from sequences.options import SequenceOptions
from sequences.outputs import Listed, results_folder
from sequences.reader import SequenceReader
from sequences.visual_odometry.odometry import VisualOdometry
from sequences.visual_odometry.sequence import VisualSequence
from vapor.cache import digest
from vapor.checkpoints.checkpoint import ModelDescription
from vapor.evaluation.trained_images import said_of_trained_images
from vapor.landmarks.localize import VerifiedPose
from vapor.landmarks.verify import ShownLandmarks
from vapor.observation import VaporObservationModel
from vapor.pipeline.config import RunConfig
from vapor.pipeline.localize import localize
from vapor.pipeline.model import LoadedModel, load_model
from vapor.pipeline.odometry import USES, camera_of_motion, makes_odometry, require_one_source, usual_depth_m
from vapor.pipeline.results import RESULTS, RunResult, write_results
from vapor.pipeline.unrecognised import MOST_IMAGES, SeenImage, are_unrecognised, why_unrecognised
from vapor.pipeline.verticals import Verticals
from vapor.reporting.outline import Outline
from vapor.reporting.record import EvenlySpaced
from vapor.reporting.report import is_placed, status_parts
from vapor.reporting.rerun_place import Place
from vapor.threads import limited_threads
from vapor.training_data.entries import as_entry, parse_entry
from vapor.training_data.ground import describe_unshown
from vapor.versions import version_of

_SAMPLED, _END_BYTES = 100, 4096  # files of a sequence, of which both ends count
_MOST_KEPT = 7  # images in which landmarks verified a place
_VerifiedImage = tuple[int, UInt8[np.ndarray, "h w 3"], Camera | None, list[VerifiedPose]]


def run(
    sequence: Path | str,
    model: str | LoadedModel,
    output: Path | str,
    config: RunConfig | None = None,
    *,
    reading: SequenceOptions | None = None,
    overwrite: bool = False,
    progress: Callable[[int, int], None] | None = None,
    command: str = "",
) -> RunResult:
    """Localize a recorded sequence and write everything about it into a directory.

    Args:
        sequence: MCAP file, rosbag2 folder or ROS 1 bag; or images without odometry: a video file, a folder of images,
            or the folder of a data set, whose true poses are compared with; of such images, `PATH@START:STOP` is a
            part.
        model: Model file, name of a model that ships with the package, or a model that `load_model` loaded with these
            settings.
        output: Directory for the results, which appear when the run is complete, or not at all. It is absent, empty, or
            has earlier results, which are replaced (see `results_folder`).
        config: Settings.
        reading: Topics and range to read; None for the whole sequence.
        overwrite: Take any directory as output, and replace files in it that have the names of results.
        progress: Called after every image with the number done and an upper bound of all.
        command: The command line, for the page; empty where there was none.

    Raises:
        VaporTrackError: unusable sequence, model or output, or fewer than one in ten of the images left to localize.

    Example:
        >>> import vapor
        >>> config = vapor.RunConfig(recording=False)
        >>> result = vapor.run("walk.mcap", "place.safetensors", "run/", config)
        >>> result.record.methods["filter"].poses.translation.shape  # of world_from_camera, metres
        (25, 3)
        >>> stored = vapor.read_run("run/")  # the same again from the files
    """
    sequence, output = as_entry(sequence), Path(output)
    config = config or RunConfig()
    loaded = load_model(model, config) if isinstance(model, str) else model
    reads = files_read(sequence, loaded, reading)
    with results_folder(output, "run", writes=RESULTS, reads=reads, overwrite=overwrite) as directory:
        return run_into(directory, sequence, loaded, config, reading=reading, progress=progress, command=command)


def files_read(sequence: Path, model: LoadedModel, reading: SequenceOptions | None) -> list[Path]:
    """Files and folders that a run reads, as far as they are known before it."""
    path, _ = parse_entry(sequence)
    return [*listing.files_read(path), model.file, *(() if reading is None else reading.files_read)]


def request_of(sequence: Path, model: LoadedModel, config: RunConfig, reading: SequenceOptions | None) -> str:
    """A hash of what the results of a run depend on: version, model, settings, poses and sequence.

    The sequence counts by name and size of its files, and by both ends of some of them, evenly spread.
    """
    reading, (whole, part) = reading or SequenceOptions(), parse_entry(sequence)
    read = dict.fromkeys(listing.files_read(whole.absolute()))
    found = {each for path in read for each in (path.rglob("*") if path.is_dir() else [path])}
    files = sorted(path for path in found if path.is_file())
    poses = [path for path in reading.files_read if path.is_file()]
    settings = {
        "vapor-track": version_of("vapor-track"),
        "model": model.sha256,
        "run": asdict(config),
        "reading": asdict(reading) | {"poses": [Listed.of(path).sha256 for path in poses]},
        "sequence": [(path.name, path.stat().st_size) for path in files],
        "part": as_typed(part),
        "ends": [_ends(path) for path in files[:: 1 + len(files) // _SAMPLED]],
    }
    return digest(settings)


def _ends(file: Path) -> str:
    """A hash of the first and the last bytes of a file; empty where it cannot be read, as its reader says so."""
    try:
        with file.open("rb") as content:
            begin = content.read(_END_BYTES)
            content.seek(max(0, file.stat().st_size - _END_BYTES))
            return sha256(begin + content.read(_END_BYTES)).hexdigest()
    except OSError:
        return ""


def run_into(
    directory: Path,
    sequence: Path,
    model: LoadedModel,
    config: RunConfig,
    *,
    reading: SequenceOptions | None = None,
    progress: Callable[[int, int], None] | None = None,
    command: str = "",
) -> RunResult:
    """As `run`, but file by file into a directory that exists."""
    request = request_of(sequence, model, config, reading)  # a database that is open has more files
    reading = reading or SequenceOptions()
    reader = _open(sequence, reading, config, model.observation.description.cameras)
    observation = model.observation.seen_by(reader.camera)
    calibration = observation.description.calibration
    verticals = Verticals(observation.description, config.planar)
    fit = calibration.odometry if config.fitted_odometry else None
    frames = reader if fit is None else RestatedSequence(reader, fit.restated)
    frames = _with_visual_odometry(frames, observation.description, config)
    frames = _with_inertial(frames, reading, usual_up=verticals.usual_up)
    bias = VisualOdometry.bias if frames.odometry_origin == "visual" else None if fit is None else fit.odometry_bias
    if bias is not None:
        config = replace(config, localizer=replace(config.localizer, odometry_bias=bias))

    some: EvenlySpaced[SeenImage] = EvenlySpaced(MOST_IMAGES)
    verified = VerifiedImages(observation)
    truth: list[Poses | None] = []

    def seen(frame: Frame) -> np.ndarray:
        observation.camera = frame.camera  # which may zoom
        some.add(lambda: (frame.image, frame.camera))
        truth.append(frame.world_from_camera)
        return frame.image

    with limited_threads(config.threads):
        record = localize(
            frames,
            verified,
            directory,
            config,
            calibration.errors,
            storeys=observation.storeys,
            vertical=lambda frame, posterior: verticals.step(
                posterior, frame.gravity, is_localized=frame.reference_from_camera is None
            ),
            place=Place.of_model(observation.description),
            allow_few_images=reading.allow_few_images,
            progress=progress,
            observed=seen,
        )
        record = replace(
            record,
            odometry=frames.odometry_origin,
            inliers=verified.inliers,
            landmarks=verified.middle(record.methods["filter"].poses),
            outline=Outline.of_model(observation.description),
        )
        engine = {"device": observation.engine.device, "engine": observation.engine.name}
        settings = {
            "request": request,
            "sequence": {
                "name": sequence.name,
                "images": frames.num_images,
                "image_source": frames.image_description,
                "odometry": frames.odometry_description,
                "motion": _motion(frames, config),
                "no_odometry": frames.no_odometry,
            },
            "model": {"name": model.name, "sha256": model.sha256},
            "run": asdict(config) | engine,
            "reading": asdict(reading) | frames.resolved,
        }
        notices = [*frames.notices, *observation.notices, *verticals.notices]
        if are_unrecognised(record.status) and observation.description.ood_model is not None:
            notices.insert(0, why_unrecognised(some.items, observation.ood_score, observation.is_verified))
        if (trained := observation.description.memory_poses) is not None:
            notices[:0] = filter(None, [said_of_trained_images(truth, trained)])
            if is_placed(status_parts(record.status)):
                found = None if record.inliers is None else record.inliers > 0
                notices += filter(None, [describe_unshown(record.methods["smoothed"].poses, trained, verified=found)])
        result = write_results(record, directory, settings, title=sequence.name, notices=notices, command=command)
        used = f"{engine['engine']} on {engine['device']}, {config.precision}"
        missing = f"; none is recorded: {frames.no_odometry}" if frames.no_odometry else ""
        return replace(result, engine=used, motion=_motion(frames, config) + missing)


def _open(sequence: Path, reading: SequenceOptions, config: RunConfig, cameras: Sequence[str]) -> FrameSource:
    path, part = parse_entry(sequence)
    if not is_image_sequence(path):
        require_one_source(config.odometry, reading)
        require_recording(path)
        return SequenceReader(sequence, reading, odometry=USES[config.odometry], usual_cameras=cameras)
    if config.odometry in ("recorded", "both"):
        raise VaporTrackError(
            f"{sequence}: --odometry {config.odometry} with images alone, expected a recording with odometry"
        )
    return ImageSequence(path, reading, rate_hz=config.rate_hz, frames=part)


def _with_visual_odometry(frames: FrameSource, model: ModelDescription, config: RunConfig) -> FrameSource:
    """The sequence with odometry from its images, where that is asked for or there is no other.

    Args:
        frames: The sequence.
        model: Its training camera is that of images without intrinsics; its landmarks say how far away the scene is.
        config: Settings.

    Raises:
        VaporTrackError: it is asked for, and no intrinsics are known.
    """
    if not makes_odometry(config.odometry, is_recorded=frames.odometry_origin is not None):
        return frames
    camera = camera_of_motion(frames.path, frames.camera, model, config.odometry)
    if camera is None:
        return frames
    return VisualSequence(
        frames,
        camera,
        beside=config.odometry == "both",
        most_hz=config.localize_hz,
        usual_depth_m=usual_depth_m(model),
    )


def _with_inertial(frames: FrameSource, reading: SequenceOptions, *, usual_up: Up | None) -> FrameSource:
    """The sequence with gravity and turns of an inertial unit and with rides in lifts, where its recording has them.

    Args:
        frames: The sequence.
        reading: Its topics.
        usual_up: Which way is up for a robot.
    """
    if "image_topic" not in frames.resolved:  # images alone
        return frames
    localized = replace(reading, image_topic=frames.resolved["image_topic"].split(",")[0])
    samples, notices = read_inertial(frames.path, localized)
    if frames.odometry_origin in ("recorded", "both"):
        rides, of_pressure = read_rides(frames.path, reading)
    else:
        rides, of_pressure = [], [without_metres(reading.pressure_topic)] if reading.pressure_topic else []
    return InertialSequence(frames, samples, [*notices, *of_pressure], rides=rides, usual_up=usual_up)


def _motion(frames: FrameSource, config: RunConfig) -> str:
    """What stands in for recorded odometry, for users; empty where that is used."""
    if frames.odometry_origin == "visual":
        return "made from the images; their scale is unknown, and only the filter estimates it"
    if frames.odometry_origin is not None:
        return ""
    unknown = ", as the intrinsics are unknown" if config.odometry == "auto" else ""
    return f"none{unknown}: each hypothesis moves by a velocity of its own"


class VerifiedImages:
    """An observation model that keeps some of the images in which landmarks verified a place, evenly spread."""

    def __init__(self, model: VaporObservationModel) -> None:
        self._model = model
        self._inliers: list[int] = []
        self._kept: EvenlySpaced[_VerifiedImage] = EvenlySpaced(_MOST_KEPT)

    def observe(self, image: np.ndarray, *, rng: np.random.Generator) -> PosePosterior:
        """See `VaporObservationModel.observe`."""
        posterior = self._model.observe(image, rng=rng)
        found = [] if self._model.verifier is None else self._model.verifier.latest
        if found:
            self._kept.add(lambda: (len(self._inliers), image.copy(), self._model.camera, found))
        self._inliers.append(found[0].inliers if found else 0)
        return posterior

    @property
    def inliers(self) -> Int64[np.ndarray, " n"] | None:
        """Landmarks that agree with the best verified pose of each image, (n,); None without landmarks."""
        return None if self._model.verifier is None else np.array(self._inliers, np.int64)

    def middle(self, poses: Poses) -> ShownLandmarks | None:
        """The landmarks in the middle one of the images kept; None where landmarks verified nothing.

        Args:
            poses: Estimate of each image observed so far, (n,): the verified pose nearest to it is shown.
        """
        if self._model.verifier is None or not self._kept.kept:
            return None
        middle = 0.5 * (np.count_nonzero(self._inliers) - 1)
        _, (number, image, camera, found) = min(self._kept.kept, key=lambda each: abs(each[0] - middle))
        metres, _ = Poses.stack([each.world_from_camera for each in found]).distance(poses[number])
        return self._model.verifier.shown(image, camera, found, which=int(np.argmin(metres)), number=number)
