"""Recordings as they are stored: a folder with settings, true path, odometry and posterior samples."""

from __future__ import annotations

import importlib.metadata
import json
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int64

from filtering.errors import VaporTrackError
from filtering.measurement_noise import MeasurementNoise
from filtering.motion import Odometry
from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from sequences.errors import SequenceError
from sequences.files import read_arrays
from sequences.paths import Cues
from sequences.synthesize import SYNTHESIS
from vapor.cache import code_digest, digest
from vapor.checkpoints.checkpoint import Checkpoint
from vapor.engines.engine import Precision
from vapor.landmarks.localize import VerifiedPose
from vapor.landmarks.verify import verified
from vapor.tracking.follow import posterior_of


def seen_digest(checkpoint: Checkpoint) -> str:
    """Digest of the model and of the code that finds landmarks: everything that a posterior depends on."""
    if checkpoint.landmarks is None:
        return checkpoint.seen_sha256()
    errors = json.loads(json.dumps(asdict(checkpoint.calibration.errors)))
    code = code_digest("vapor.landmarks", "vapor.observation", "vapor.cameras")
    return digest({"seen": checkpoint.seen_sha256(), "errors": errors, "code": code})


@dataclass(frozen=True)
class Settings(ABC):
    """Everything that a recording depends on."""

    @property
    @abstractmethod
    def label(self) -> str:
        """Begin of the name."""

    @property
    def name(self) -> str:
        """Name of its folder: recordings with other settings have other names."""
        return f"{self.label}-{digest(self.stored)}"

    @property
    def stored(self) -> dict[str, Any]:
        """All settings by name, as JSON."""
        return json.loads(json.dumps(asdict(self)))


@dataclass(frozen=True)
class RecordingSettings(Settings):
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
    def label(self) -> str:
        """Scene, cues and seed."""
        return f"{self.scene}-{self.cues}-{self.seed}"


@dataclass(frozen=True)
class FileSettings(Settings):
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
    def label(self) -> str:
        """The sequence."""
        return self.sequence


SETTINGS, PATH, SAMPLES = "settings.json", "path.npz", "samples.f32"
"""The files of a recording: settings for people, arrays, and the float32 of all samples one after the other."""


@dataclass(frozen=True)
class CameraPath:
    """Where the camera goes, and where it sees a landmark.

    Attributes:
        world_from_camera: True poses, batch (n,).
        sees_cue: Whether an image shows something unique, (n,); False everywhere if that is not known.
    """

    world_from_camera: Poses
    sees_cue: Bool[np.ndarray, " n"]


class Observed(NamedTuple):
    """The answers of network and landmarks to an image.

    Attributes:
        samples: Posterior samples (m,), world_from_camera; none of an uninformative image.
        ood_score: See `PosePosterior`.
        verified: The poses that landmarks verify.
    """

    samples: Poses
    ood_score: float
    verified: Sequence[VerifiedPose] = ()

    def posterior(self, checkpoint: Checkpoint, noise: MeasurementNoise) -> PosePosterior:
        """The posterior of the image, by the model and its measurement noise."""
        coarse = posterior_of(self.samples, noise, self.ood_score, checkpoint.training_prior)
        landmarks = checkpoint.landmarks
        if landmarks is None:
            return coarse
        return verified(coarse, self.verified, landmarks.verification, landmarks.mapped)


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

    def observed(self, image: int) -> Observed:
        """The answers to an image, the same bits that the network gave."""
        samples = from_rows(np.asarray(self.samples[image], np.float64))
        return Observed(samples, float(self.ood_score[image]), self.verified[image])

    @property
    def motions(self) -> tuple[Odometry, ...]:
        """Camera motion from the image before to each one, (n,)."""
        return tuple(map(self.motion, range(len(self.times_ns))))

    def motion(self, image: int) -> Odometry:
        """Camera motion from the previous image to this one; for the first image, none in no time."""
        duration_s = float(self.times_ns[image] - self.times_ns[max(image - 1, 0)]) * 1e-9
        return Odometry(self.odometry[image], self.odometry_covariance[image], duration_s)


def load_recording(settings: Settings, directory: Path) -> Recording:
    """A recording made before.

    Raises:
        VaporTrackError: there is none, or it is damaged.
    """
    folder = directory / settings.name
    try:
        stored = read_arrays(folder / PATH)
        samples = np.memmap(folder / SAMPLES, np.float32, "r").reshape(
            len(stored["times_ns"]), settings.stored["num_samples"], 12
        )
    except (SequenceError, OSError, ValueError) as error:
        raise VaporTrackError(f"{folder}: {error}, expected a recording; remove it to make it again") from error
    return Recording(
        stored["times_ns"],
        CameraPath(from_rows(stored["truth"]), stored["sees_cue"]),
        from_rows(stored["odometry"]),
        stored["odometry_covariance"],
        samples,
        stored["ood_score"],
        _verified(stored),
    )


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
