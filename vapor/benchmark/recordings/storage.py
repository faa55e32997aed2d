"""Recordings as they are stored: a folder with settings, true path, odometry and posterior samples."""

from __future__ import annotations

import importlib.metadata
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, BinaryIO, TypeVar

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int64

from filtering.errors import VaporTrackError, quoted
from filtering.motion import Odometry
from filtering.se3 import Poses
from sequences.errors import SequenceError
from sequences.files import read_arrays, read_json
from sequences.paths import Cues
from sequences.synthesize import SYNTHESIS
from vapor.cache import code_digest, digest
from vapor.checkpoints.checkpoint import Checkpoint
from vapor.engines.engine import Precision
from vapor.landmarks.localize import VerifiedPose
from vapor.storage import absent, fetched


def seen_digest(checkpoint: Checkpoint) -> str:
    """Digest of the model and of the code that finds landmarks: everything that a posterior depends on."""
    if checkpoint.landmarks is None:
        return checkpoint.seen_sha256()
    errors = json.loads(json.dumps(asdict(checkpoint.calibration.errors)))
    code = code_digest("vapor.landmarks", "vapor.observation", "vapor.cameras")
    return digest({"seen": checkpoint.seen_sha256(), "errors": errors, "code": code})


@dataclass(frozen=True)
class RecordingSettings:
    """Everything that the recording of a synthetic sequence depends on.

    Attributes:
        seed: Of the path and of all noise.
        cues: Unique things along the path.
        frames: Number of images of the path.
        network_sha256: Of all that the answer of the network depends on.
        stand: The image at which the camera stops, and for how many seconds it stands; None if it does not stop.
        part: The first of the images that are recorded, and how many; None for all.
        change: Change of every image before the network sees it, one of `OUT_OF_DISTRIBUTION`; None for nothing.
        odometry_scale: Error of the odometry's distances, as a fraction of them; None for a random one.
        precision: Of the network's arithmetic; engines agree within rounding.
        camera: The camera that it is rendered with, the numbers of `Camera`; None for that of its scene.
        synthesis: Version of the code that renders.
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
    precision: Precision = "float32"
    camera: tuple[int, int, float, float, float, float] | None = None
    synthesis: int = SYNTHESIS
    package: str = field(default_factory=lambda: importlib.metadata.version("vapor-track"))

    @property
    def name(self) -> str:
        """Name of its folder: recordings with other settings have other names."""
        return f"{self.scene}-{self.cues}-{self.seed}-{digest(self.stored)}"

    @property
    def stored(self) -> dict[str, Any]:
        """All settings by name, as JSON."""
        return json.loads(json.dumps(asdict(self)))


@dataclass(frozen=True)
class FileSettings:
    """Everything that the recording of an MCAP file depends on.

    Attributes:
        made: Digest of everything that the file was made from.
        seen_sha256: Of all that samples and OOD score of an image depend on.
        seed: Of the network's latent noise.
        images: How many, from the first one on; None for all.
        change: Change of every image before the network sees it, one of `OUT_OF_DISTRIBUTION`; None for nothing.
    """

    sequence: str
    made: str
    seen_sha256: str
    seed: int
    num_samples: int
    images: int | None = None
    change: str | None = None
    precision: Precision = "float32"

    @property
    def name(self) -> str:
        """Name of its folder: recordings with other settings have other names."""
        return f"{self.sequence}-{digest(self.stored)}"

    @property
    def stored(self) -> dict[str, Any]:
        """All settings by name, as JSON."""
        return asdict(self)


Settings = TypeVar("Settings", RecordingSettings, FileSettings, RecordingSettings | FileSettings)

SETTINGS, PATH, SAMPLES = "settings.json", "path.npz", "samples.npy"
"""The files of a recording."""


@dataclass(frozen=True)
class CameraPath:
    """Where the camera goes, and where it sees a landmark.

    Attributes:
        world_from_camera: True poses, batch (n,).
        sees_cue: Whether an image shows something unique, (n,); False everywhere if that is not known.
    """

    world_from_camera: Poses
    sees_cue: Bool[np.ndarray, " n"]


@dataclass(frozen=True)
class Recording:
    """A sequence of n images with the posterior of each.

    Attributes:
        times_ns: Stamps of the images, (n,).
        path: True poses and where a landmark is in view.
        odometry: Camera motion since the previous image as read from the file, (n,); the first is the identity.
        odometry_covariance: Of ξ = (v, ω), (n, 6, 6).
        samples: Posterior samples, rotation matrix by rows and translation, (n, m, 12); read from disk when asked for.
        ood_score: Of each image, see `PosePosterior`, (n,).
        verified: The poses that landmarks verify, of each image, (n,).
    """

    times_ns: Int64[np.ndarray, " n"]
    path: CameraPath
    odometry: Poses
    odometry_covariance: Float64[np.ndarray, "n 6 6"]
    samples: Float32[np.ndarray, "n m 12"]
    ood_score: Float64[np.ndarray, " n"]
    verified: tuple[tuple[VerifiedPose, ...], ...]

    def posterior_poses(self, image: int) -> Poses:
        """Posterior samples (m,) of an image, the same bits that the network gave."""
        return from_rows(np.asarray(self.samples[image], np.float64))

    def motion(self, image: int) -> Odometry:
        """Camera motion from the previous image to this one; for the first image, none in no time."""
        duration_s = float(self.times_ns[image] - self.times_ns[max(image - 1, 0)]) * 1e-9
        return Odometry(self.odometry[image], self.odometry_covariance[image], duration_s)


def not_recorded(wanted: Iterable[Settings], directory: Path) -> list[Settings]:
    """Those of some recordings that a directory has not."""
    files = {settings: directory / settings.name / SETTINGS for settings in wanted}
    lacking = absent(files.values(), directory)
    return [settings for settings, file in files.items() if file in lacking]


def load_recording(settings: RecordingSettings | FileSettings, directory: Path) -> Recording:
    """A recording made before.

    Raises:
        VaporTrackError: there is none, or it was made with other settings.
    """
    folder = fetched(directory / settings.name)
    stored = _checked(settings, folder)
    return Recording(
        stored["times_ns"],
        CameraPath(from_rows(stored["truth"]), stored["sees_cue"]),
        from_rows(stored["odometry"]),
        stored["odometry_covariance"],
        np.load(folder / SAMPLES, mmap_mode="r", allow_pickle=False),
        stored["ood_score"],
        _verified(stored),
    )


def load_path(settings: RecordingSettings | FileSettings, directory: Path) -> CameraPath:
    """Where the camera of a recording went.

    Raises:
        VaporTrackError: there is no such recording, or it was made with other settings.
    """
    stored = _checked(settings, directory / settings.name)
    return CameraPath(from_rows(stored["truth"]), stored["sees_cue"])


def write_samples_header(file: BinaryIO, shape: tuple[int, ...]) -> None:
    """Begin an .npy file of float32, whose numbers are then written one after the other.

    It has the same length for any number of images, so it can be overwritten once that number is known.

    A file mapped into memory would have holes: where the disk is full, filling one kills the process.
    """
    description = np.lib.format.dtype_to_descr(np.dtype(np.float32))
    np.lib.format.write_array_header_1_0(file, {"descr": description, "fortran_order": False, "shape": shape})


def to_rows(poses: Poses) -> Float64[np.ndarray, "n 12"]:
    """Poses (n,) as rows of a stored array: the rotation row by row, then the translation."""
    return np.concatenate([poses.rotation.reshape(-1, 9), poses.translation], axis=1)


def from_rows(rows: Float64[np.ndarray, "n 12"]) -> Poses:
    """The poses (n,) of `to_rows`."""
    return Poses(rows[:, :9].reshape(-1, 3, 3).copy(), rows[:, 9:].copy())


def verified_arrays(verified: Sequence[Sequence[VerifiedPose]]) -> dict[str, np.ndarray]:
    """The poses that landmarks verify, of each of n images, as arrays of v poses."""
    every = [(image, each) for image, found in enumerate(verified) for each in found]
    poses = [each.world_from_camera for _, each in every]
    return {
        "verified_image": np.array([image for image, _ in every], np.int64),
        "verified_pose": to_rows(Poses.stack(poses) if poses else Poses.identity(0)),
        "verified_covariance": np.array([each.covariance for _, each in every]).reshape(-1, 6, 6),
        "verified_inliers": np.array([each.inliers for _, each in every], np.int64),
    }


def _verified(stored: Mapping[str, np.ndarray]) -> tuple[tuple[VerifiedPose, ...], ...]:
    found: list[list[VerifiedPose]] = [[] for _ in stored["times_ns"]]
    poses, none = from_rows(stored["verified_pose"]), np.empty((0, 2))
    for i, image in enumerate(stored["verified_image"].tolist()):
        covariance, inliers = stored["verified_covariance"][i], int(stored["verified_inliers"][i])
        found[image].append(VerifiedPose(poses[i], covariance, inliers, none, none))
    return tuple(map(tuple, found))


def _checked(settings: RecordingSettings | FileSettings, folder: Path) -> Mapping[str, np.ndarray]:
    """The arrays of a recording beside its samples, after checking that its settings are these."""
    try:
        found, content = read_json(folder / SETTINGS), read_arrays(folder / PATH)
    except SequenceError as error:
        raise VaporTrackError(
            f"{folder}: cannot be read ({error}), expected a recording; remove it to make it again"
        ) from error
    expected = settings.stored
    if not isinstance(found, dict):
        raise VaporTrackError(
            f"{folder / SETTINGS}: {quoted(found)}, expected a JSON object; remove it to make it again"
        )
    for name in expected | found:
        if found.get(name) != expected.get(name):
            raise VaporTrackError(
                f"{folder}: recorded with {name} {quoted(found.get(name))}, expected {quoted(expected.get(name))};"
                " remove it to make it again"
            )
    return content
