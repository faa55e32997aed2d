"""Sequences as a benchmark keeps them: rendered or converted once, seen by the network once, replayed often."""

from __future__ import annotations

import importlib.metadata
import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int64

from filtering.errors import VaporTrackError, quoted
from filtering.motion import Odometry
from filtering.se3 import Poses
from sequences.atomic import workspace
from sequences.errors import SequenceError
from sequences.frame import Camera, Frame
from sequences.options import SequenceOptions
from sequences.paths.choose import Cues
from sequences.reader import SequenceReader
from sequences.rendering.render import sees_cue
from sequences.scenes import find_scene
from sequences.synthesize import SYNTHESIS, Stand, SyntheticSequence, synthesize, write_synthetic
from sequences.values import read_arrays, read_json
from vapor.benchmark.foreign_images import FOREIGN, Image
from vapor.cache import digest
from vapor.checkpoints.checkpoint import Checkpoint
from vapor.observation import VaporObservationModel
from vapor.threads import limited_threads

_NO_MOTION = Odometry(Poses.identity(), np.zeros((6, 6)), 0.0)
_SETTINGS, _PATH, _SAMPLES = "settings.json", "path.npz", "samples.npy"


@dataclass(frozen=True)
class RecordingSettings:
    """Everything that a recording depends on.

    `stand`: the image at which the camera stops, and for how many seconds it stands; None for a camera that does not.
    `part`: the first of the images that are recorded, and how many; None for all. `change`: what is done to every image
    before the network sees it, one of `FOREIGN`; None for nothing. `odometry_scale`: the error of the odometry's
    distances, as a share of them; None for a random one. `camera`: with which it is rendered, the numbers of `Camera`;
    None for that of its scene.
    """

    scene: str
    seed: int
    cues: Cues
    frames: int
    width: int
    height: int
    network_sha256: str
    num_samples: int
    rate_hz: float = 10.0
    stand: tuple[int, float] | None = None
    part: tuple[int, int] | None = None
    change: str | None = None
    odometry_scale: float | None = None
    camera: tuple[int, int, float, float, float, float] | None = None
    synthesis: int = SYNTHESIS
    package: str = field(default_factory=lambda: importlib.metadata.version("vapor-track"))

    @property
    def name(self) -> str:
        """Of its folder: recordings of other settings lie beside it."""
        return f"{self.scene}-{self.cues}-{self.seed}-{digest(self.told)}"

    @property
    def told(self) -> dict[str, Any]:
        """All of it by name; what is as it is in most recordings is not said."""
        content = asdict(self)
        unusual = ("stand", "part", "change", "odometry_scale", "camera")
        for name, ordinary in (("rate_hz", 10.0), *((name, None) for name in unusual)):
            if content[name] == ordinary:
                del content[name]
        return json.loads(json.dumps(content))


@dataclass(frozen=True)
class FileSettings:
    """Everything that the recording of an MCAP file depends on.

    Attributes:
        sequence: Name of the file.
        made: Digest of all that it was made from.
        seen_sha256: Of what the network says of an image, its samples and how familiar it is.
        seed: Of the network's latent noise.
        num_samples: Posterior samples per image.
        images: So many, from the first one on; None for all.
        change: What is done to every image before the network sees it, one of `FOREIGN`; None for nothing.
    """

    sequence: str
    made: str
    seen_sha256: str
    seed: int
    num_samples: int
    images: int | None = None
    change: str | None = None

    @property
    def name(self) -> str:
        """Of its folder: recordings of other settings lie beside it."""
        return f"{self.sequence}-{digest(self.told)}"

    @property
    def told(self) -> dict[str, Any]:
        """All of it by name; what is as it is in most recordings is not said."""
        unusual = ("images", "change")
        return {name: value for name, value in asdict(self).items() if name not in unusual or value is not None}


@dataclass(frozen=True)
class CameraPath:
    """Where the camera goes, and what it comes by.

    Attributes:
        world_from_camera: True poses, batch (n,).
        sees_cue: Whether an image shows something unique, (n,); nowhere where that is not known.
    """

    world_from_camera: Poses
    sees_cue: Bool[np.ndarray, " n"]


@dataclass(frozen=True)
class Recording:
    """A sequence of n images with the posterior of each.

    Attributes:
        times_ns: Stamps of the images, (n,).
        path: True poses and what is seen.
        odometry: Camera motion since the previous image as read from the file, (n,); the first is the identity.
        odometry_covariance: Of ξ = (v, ω), (n, 6, 6).
        samples: Posterior samples, rotation matrix by rows and translation, (n, m, 12); on disk until they are asked
            for.
        unfamiliarity: Of each image, see `PosePosterior`, (n,).
    """

    times_ns: Int64[np.ndarray, " n"]
    path: CameraPath
    odometry: Poses
    odometry_covariance: Float64[np.ndarray, "n 6 6"]
    samples: Float32[np.ndarray, "n m 12"]
    unfamiliarity: Float64[np.ndarray, " n"]

    def posterior_poses(self, image: int) -> Poses:
        """Posterior samples (m,) of an image, the same bits that the network gave."""
        return from_rows(np.asarray(self.samples[image], np.float64))

    def motion(self, image: int) -> Odometry:
        """Camera motion from the image before to this one; of the first, none in no time."""
        duration_s = float(self.times_ns[image] - self.times_ns[max(image - 1, 0)]) * 1e-9
        return Odometry(self.odometry[image], self.odometry_covariance[image], duration_s)


def make_recording(settings: RecordingSettings, checkpoint: Checkpoint, directory: Path) -> None:
    """Render a sequence to a file, read it as a user's would be, ask the network, and keep the answers; once.

    The folder appears in `directory` when it is complete.

    Raises:
        VaporTrackError: there is no such sequence, or the directory cannot be written to.
    """
    _keep(settings, directory, lambda folder: _record(settings, checkpoint, folder))


def record_file(
    settings: FileSettings, file: Path, checkpoint: Checkpoint, directory: Path, reading: SequenceOptions | None = None
) -> None:
    """Read a sequence in which every image has a true pose and odometry, and go on as `make_recording`.

    Images before the first that has a true pose, and after the last, are left out.

    Raises:
        VaporTrackError: the file cannot be read or lacks some of it, or the directory cannot be written to.
    """
    rng = np.random.default_rng([settings.seed, settings.num_samples])
    asked = _Asked(settings.num_samples, rng, settings.images, _change(settings))
    _keep(settings, directory, lambda folder: _observe(file, checkpoint, asked, folder, reading=reading))


def load_recording(settings: RecordingSettings | FileSettings, directory: Path) -> Recording:
    """A recording made before.

    Raises:
        VaporTrackError: there is none, or it was made with other settings.
    """
    folder = directory / settings.name
    stored = _checked(settings, folder)
    return Recording(
        stored["times_ns"],
        CameraPath(from_rows(stored["truth"]), stored["sees_cue"]),
        from_rows(stored["odometry"]),
        stored["odometry_covariance"],
        np.load(folder / _SAMPLES, mmap_mode="r", allow_pickle=False),
        stored.get("unfamiliarity", np.zeros(len(stored["times_ns"]))),
    )


def camera_path(settings: RecordingSettings, directory: Path) -> CameraPath:
    """Where the camera of a recording goes: as recorded, or where there is no recording yet as it will be.

    Raises:
        VaporTrackError: there is no such sequence, or what is there was made with other settings.
    """
    folder = directory / settings.name
    if folder.is_dir():
        stored = _checked(settings, folder)
        return CameraPath(from_rows(stored["truth"]), stored["sees_cue"])
    sequence = _sequence(settings)
    seen = sees_cue(sequence.scene, sequence.camera, sequence.world_from_camera)
    return CameraPath(sequence.world_from_camera, seen)


def _sequence(settings: RecordingSettings) -> SyntheticSequence:
    sequence = synthesize(
        settings.scene,
        seed=settings.seed,
        num_frames=settings.frames,
        cues=settings.cues,
        width=settings.width,
        height=settings.height,
        noise=replace(find_scene(settings.scene).noise, fixed_scale=settings.odometry_scale),
        rate_hz=settings.rate_hz,
        stand=None if settings.stand is None else Stand(*settings.stand),
    )
    if settings.camera is not None:
        sequence = replace(sequence, camera=Camera(*settings.camera))
    if settings.part is None:
        return sequence
    first, count = settings.part
    part = slice(first, first + count)
    return replace(
        sequence,
        image_times_ns=sequence.image_times_ns[part],
        world_from_camera=sequence.world_from_camera[part],
    )


def _keep(settings: RecordingSettings | FileSettings, directory: Path, record: Callable[[Path], object]) -> None:
    """Let a recording be made in a hidden folder, and give that its name; nothing to do where it is there."""
    folder = directory / settings.name
    if folder.is_dir():
        return
    try:
        directory.mkdir(parents=True, exist_ok=True)
        with workspace(directory, settings.name) as work:
            partial = work / settings.name
            partial.mkdir()
            with limited_threads(1):
                record(partial)
            (partial / _SETTINGS).write_text(json.dumps(settings.told, indent=2) + "\n", encoding="utf-8")
            if not folder.is_dir():  # another process may have been faster
                partial.rename(folder)
    except OSError as error:
        raise VaporTrackError(
            f"{folder}: cannot write: {error.strerror or error}, expected a directory that can be written to"
        ) from error


def _record(settings: RecordingSettings, checkpoint: Checkpoint, folder: Path) -> None:
    sequence = _sequence(settings)
    seen = sees_cue(sequence.scene, sequence.camera, sequence.world_from_camera)
    file = folder / "sequence.mcap"
    write_synthetic(sequence, file)
    rng = np.random.default_rng([settings.seed, settings.num_samples])
    asked = _Asked(settings.num_samples, rng, len(seen), _change(settings))
    found = _observe(file, checkpoint, asked, folder, seen=seen)
    if found != len(seen):
        raise VaporTrackError(f"{file}: {found} images read, expected the {len(seen)} that were written")
    file.unlink()


@dataclass(frozen=True)
class _Asked:
    """What the network is asked: for so many samples of at most so many images, each changed."""

    num_samples: int
    rng: np.random.Generator
    images: int | None
    changed: Callable[[Image], Image]


def _change(settings: RecordingSettings | FileSettings) -> Callable[[Image], Image]:
    """What is done to images."""
    name, rng = settings.change, np.random.default_rng([settings.seed, settings.num_samples, 1])
    return lambda image: image if name is None else np.ascontiguousarray(FOREIGN[name](image, rng))


def _observe(
    file: Path,
    checkpoint: Checkpoint,
    asked: _Asked,
    folder: Path,
    *,
    seen: Bool[np.ndarray, " n"] | None = None,
    reading: SequenceOptions | None = None,
) -> int:
    """Ask the network about the images of a file, and write the answers and all that is known beside them.

    Returns:
        How many images.
    """
    reader = SequenceReader(file, reading, true_poses="required")
    model = VaporObservationModel(checkpoint, num_samples=asked.num_samples, device="cpu", camera=reader.camera)
    times_ns, odometry, covariance, truth, unfamiliarity = [], [], [], [], []
    ended: Frame | None = None
    shape = (asked.num_samples, 12)
    with (folder / _SAMPLES).open("wb") as samples:
        _write_header(samples, (reader.num_images, *shape))
        for frame in reader:
            if frame.world_from_camera is None:
                ended = ended or (frame if truth else None)
                continue
            if ended is not None or (truth and frame.odometry is None):
                lacking, what = (ended, "true pose") if ended is not None else (frame, "odometry")
                raise VaporTrackError(
                    f"{file}: the image at {lacking.time_ns} ns has no {what}, expected one of every image between the"
                    " first and the last that have a true pose"
                )
            posterior = model.observe(asked.changed(frame.image), rng=asked.rng)
            samples.write(to_rows(posterior.samples).astype(np.float32).tobytes())
            motion = frame.odometry if truth and frame.odometry is not None else _NO_MOTION
            times_ns.append(frame.time_ns)
            truth.append(frame.world_from_camera)
            odometry.append(motion.previous_from_current)
            covariance.append(motion.covariance)
            unfamiliarity.append(posterior.unfamiliarity)
            if len(truth) == asked.images:
                break
        if not truth:
            raise VaporTrackError(f"{file}: no image has a true pose, expected all to have one")
        samples.seek(0)
        _write_header(samples, (len(truth), *shape))
    np.savez(
        folder / _PATH,
        times_ns=np.array(times_ns, np.int64),
        truth=to_rows(Poses.stack(truth)),
        sees_cue=np.zeros(len(truth), bool) if seen is None else seen,
        odometry=to_rows(Poses.stack(odometry)),
        odometry_covariance=np.stack(covariance),
        unfamiliarity=np.array(unfamiliarity),
    )
    return len(truth)


def _write_header(file: BinaryIO, shape: tuple[int, ...]) -> None:
    """Begin an .npy file of float32, whose numbers are then written one after the other.

    It is as long for any number of images, so it can be written again.

    A file mapped into memory would have holes: where the disk is full, filling one kills the process.
    """
    description = np.lib.format.dtype_to_descr(np.dtype(np.float32))
    np.lib.format.write_array_header_1_0(file, {"descr": description, "fortran_order": False, "shape": shape})


def _checked(settings: RecordingSettings | FileSettings, folder: Path) -> Mapping[str, np.ndarray]:
    """What a recording holds beside its samples, once its settings are found to be these."""
    try:
        found, content = read_json(folder / _SETTINGS), read_arrays(folder / _PATH)
    except SequenceError as error:
        raise VaporTrackError(
            f"{folder}: cannot be read ({error}), expected a recording; remove it to make it anew"
        ) from error
    expected = settings.told
    if not isinstance(found, dict):
        raise VaporTrackError(
            f"{folder / _SETTINGS}: {quoted(found)}, expected a JSON object; remove it to make it anew"
        )
    for name in expected | found:
        if found.get(name) != expected.get(name):
            raise VaporTrackError(
                f"{folder}: recorded with {name} {quoted(found.get(name))}, expected {quoted(expected.get(name))};"
                " remove it to make it anew"
            )
    return content


def to_rows(poses: Poses) -> Float64[np.ndarray, "n 12"]:
    """Poses (n,) as rows of a stored array: the rotation row by row, then the translation."""
    return np.concatenate([poses.rotation.reshape(-1, 9), poses.translation], axis=1)


def from_rows(rows: Float64[np.ndarray, "n 12"]) -> Poses:
    """The poses (n,) of `to_rows`."""
    return Poses(rows[:, :9].reshape(-1, 3, 3).copy(), rows[:, 9:].copy())
