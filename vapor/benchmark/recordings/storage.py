"""Recordings as they are stored: a folder with the settings, the true path and odometry, and the posterior samples."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, TypeVar

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int64

from filtering.errors import VaporTrackError, quoted
from filtering.motion import Odometry
from filtering.se3 import Poses
from sequences.errors import SequenceError
from sequences.files import read_arrays, read_json
from vapor.benchmark.recordings.settings import FileSettings, RecordingSettings
from vapor.landmarks.localize import VerifiedPose
from vapor.storage import absent, fetched

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
        unfamiliarity: Of each image, see `PosePosterior`, (n,).
        verified: The poses that landmarks verify, of each image, (n,).
    """

    times_ns: Int64[np.ndarray, " n"]
    path: CameraPath
    odometry: Poses
    odometry_covariance: Float64[np.ndarray, "n 6 6"]
    samples: Float32[np.ndarray, "n m 12"]
    unfamiliarity: Float64[np.ndarray, " n"]
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
        _path(stored),
        from_rows(stored["odometry"]),
        stored["odometry_covariance"],
        np.load(folder / SAMPLES, mmap_mode="r", allow_pickle=False),
        stored.get("unfamiliarity", np.zeros(len(stored["times_ns"]))),
        _verified(stored),
    )


def load_path(settings: RecordingSettings | FileSettings, directory: Path) -> CameraPath:
    """Where the camera of a recording went.

    Raises:
        VaporTrackError: there is no such recording, or it was made with other settings.
    """
    return _path(_checked(settings, directory / settings.name))


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
    if "verified_image" in stored:
        poses, none = from_rows(stored["verified_pose"]), np.empty((0, 2))
        for i, image in enumerate(stored["verified_image"].tolist()):
            covariance, inliers = stored["verified_covariance"][i], int(stored["verified_inliers"][i])
            found[image].append(VerifiedPose(poses[i], covariance, inliers, none, none))
    return tuple(map(tuple, found))


def _path(stored: Mapping[str, np.ndarray]) -> CameraPath:
    return CameraPath(from_rows(stored["truth"]), stored["sees_cue"])


def _checked(settings: RecordingSettings | FileSettings, folder: Path) -> Mapping[str, np.ndarray]:
    """What a recording holds beside its samples, after checking that its settings are these."""
    try:
        found, content = read_json(folder / SETTINGS), read_arrays(folder / PATH)
    except SequenceError as error:
        raise VaporTrackError(
            f"{folder}: cannot be read ({error}), expected a recording; remove it to make it anew"
        ) from error
    expected = settings.stored
    if not isinstance(found, dict):
        raise VaporTrackError(
            f"{folder / SETTINGS}: {quoted(found)}, expected a JSON object; remove it to make it anew"
        )
    for name in expected | found:
        if found.get(name) != expected.get(name):
            raise VaporTrackError(
                f"{folder}: recorded with {name} {quoted(found.get(name))}, expected {quoted(expected.get(name))};"
                " remove it to make it anew"
            )
    return content
