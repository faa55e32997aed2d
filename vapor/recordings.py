"""Sequences as a benchmark keeps them: rendered or converted once, seen by the network once, replayed often."""

from __future__ import annotations

import hashlib
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
from sequences.place import find_place
from sequences.reader import SequenceReader
from sequences.render import sees_cue
from sequences.route import Cues
from sequences.synthesize import SYNTHESIS, Stand, SyntheticSequence, synthesize, write_synthetic
from sequences.values import read_arrays, read_json
from vapor.checkpoint import Checkpoint
from vapor.familiarity_benchmark import FOREIGN, Image
from vapor.observation import VaporObservationModel
from vapor.threads import limited_threads

_SETTINGS, _PATH, _SAMPLES = "settings.json", "path.npz", "samples.npy"


@dataclass(frozen=True)
class RecordingSettings:
    """Everything that a recording depends on.

    `stand`: the image at which the camera stops, and for how many seconds it stands; None for a camera that does not.
    `part`: the first of the images that are recorded, and how many; None for all. `change`: what is done to every image
    before the network sees it, one of `FOREIGN`; None for nothing. `odometry_scale`: the error of the odometry's
    distances, as a share of them; None for a random one.
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
        unusual = ("stand", "part", "change", "odometry_scale")
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
    """

    sequence: str
    made: str
    seen_sha256: str
    seed: int
    num_samples: int

    @property
    def name(self) -> str:
        """Of its folder: recordings of other settings lie beside it."""
        return f"{self.sequence}-{digest(self.told)}"

    @property
    def told(self) -> dict[str, Any]:
        """All of it by name."""
        return asdict(self)


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


def record_file(settings: FileSettings, file: Path, checkpoint: Checkpoint, directory: Path) -> None:
    """Read an MCAP file in which every image has a true pose and odometry, and go on as `make_recording`.

    Raises:
        VaporTrackError: the file cannot be read or lacks some of it, or the directory cannot be written to.
    """
    rng = np.random.default_rng([settings.seed, settings.num_samples])
    num_samples = settings.num_samples
    _keep(settings, directory, lambda folder: _observe(file, checkpoint, num_samples, folder, rng=rng))


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


def digest(settings: Mapping[str, Any]) -> str:
    """Ten characters that other settings hardly share."""
    text = json.dumps(settings, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:10]


def _sequence(settings: RecordingSettings) -> SyntheticSequence:
    sequence = synthesize(
        settings.scene,
        seed=settings.seed,
        num_frames=settings.frames,
        cues=settings.cues,
        width=settings.width,
        height=settings.height,
        noise=replace(find_place(settings.scene).noise, fixed_scale=settings.odometry_scale),
        rate_hz=settings.rate_hz,
        stand=None if settings.stand is None else Stand(*settings.stand),
    )
    if settings.part is None:
        return sequence
    first, count = settings.part
    part = slice(first, first + count)
    return replace(
        sequence,
        image_times_ns=sequence.image_times_ns[part],
        world_from_camera=sequence.world_from_camera[part],
    )


def _keep(settings: RecordingSettings | FileSettings, directory: Path, record: Callable[[Path], None]) -> None:
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
    changing = np.random.default_rng([settings.seed, settings.num_samples, 1])

    def changed(image: Image) -> Image:
        return image if settings.change is None else np.ascontiguousarray(FOREIGN[settings.change](image, changing))

    _observe(file, checkpoint, settings.num_samples, folder, rng=rng, seen=seen, changed=changed)
    file.unlink()


def _observe(
    file: Path,
    checkpoint: Checkpoint,
    num_samples: int,
    folder: Path,
    *,
    rng: np.random.Generator,
    seen: Bool[np.ndarray, " n"] | None = None,
    changed: Callable[[Image], Image] = lambda image: image,
) -> None:
    """Ask the network about every image of a file, and write the answers and all that is known beside them."""
    reader = SequenceReader(file)
    model = VaporObservationModel(checkpoint, num_samples=num_samples, device="cpu", camera=reader.camera)
    n = reader.num_images if seen is None else len(seen)
    times_ns, odometry, covariance, truth = np.empty(n, np.int64), [Poses.identity()], np.zeros((n, 6, 6)), []
    unfamiliarity = np.zeros(n)
    count = 0
    with (folder / _SAMPLES).open("wb") as samples:
        _write_header(samples, (n, num_samples, 12))
        for i, frame in enumerate(reader):
            if i >= n or frame.world_from_camera is None or (i > 0 and frame.odometry is None):
                raise VaporTrackError(
                    f"{file}: image {i} at {frame.time_ns} ns has no odometry or no true pose, or is one too many"
                )
            posterior = model.observe(changed(frame.image), rng=rng)
            samples.write(to_rows(posterior.samples).astype(np.float32).tobytes())
            times_ns[i], unfamiliarity[i] = frame.time_ns, posterior.unfamiliarity
            truth.append(frame.world_from_camera)
            if i > 0 and frame.odometry is not None:
                odometry.append(frame.odometry.previous_from_current)
                covariance[i] = frame.odometry.covariance
            count = i + 1
    if count != n:
        raise VaporTrackError(f"{file}: {count} images read, expected the {n} that were written")
    np.savez(
        folder / _PATH,
        times_ns=times_ns,
        truth=to_rows(Poses.stack(truth)),
        sees_cue=np.zeros(n, bool) if seen is None else seen,
        odometry=to_rows(Poses.stack(odometry)),
        odometry_covariance=covariance,
        unfamiliarity=unfamiliarity,
    )


def _write_header(file: BinaryIO, shape: tuple[int, ...]) -> None:
    """Begin an .npy file of float32, whose numbers are then written one after the other.

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
