"""Features that are tracked, with the depth that is known of each, and the key frames that saw them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int64

from filtering.se3 import Poses

LEAST_DEPTH = 1e-3  # of a point in front of a camera, of the depth of its anchor


@dataclass(frozen=True)
class Tracks:
    """Features in the latest image, n of them.

    A feature is a point on a ray of its *anchor*, the key frame that it is a feature of: (ray, 1) over its inverse
    depth.

    Attributes:
        ids: A number of each, increasing, (n,).
        pixels: Where it is in the latest image, (n, 2).
        covariance: How exactly it is tracked, pixels², (n, 2, 2).
        anchor: Number of its key frame, (n,).
        ray: Of it in the anchor's camera, at depth 1, (n, 2).
        inverse_depth: (n,).
        variance: Of the inverse depth, (n,).
    """

    ids: Int64[np.ndarray, " n"]
    pixels: Float32[np.ndarray, "n 2"]
    covariance: Float64[np.ndarray, "n 2 2"]
    anchor: Int64[np.ndarray, " n"]
    ray: Float64[np.ndarray, "n 2"]
    inverse_depth: Float64[np.ndarray, " n"]
    variance: Float64[np.ndarray, " n"]

    @staticmethod
    def none() -> Tracks:
        """No features."""
        number = np.zeros(0, np.int64)
        points, values = np.zeros((0, 2)), np.zeros(0)
        return Tracks(number, points.astype(np.float32), np.zeros((0, 2, 2)), number, points, values, values)

    def __len__(self) -> int:
        return len(self.ids)

    def __getitem__(self, which: Bool[np.ndarray, " n"]) -> Tracks:
        return Tracks(*(getattr(self, each.name)[which] for each in fields(self)))

    def joined(self, others: Tracks) -> Tracks:
        """These features and others."""
        return Tracks(*(np.concatenate([getattr(self, f.name), getattr(others, f.name)]) for f in fields(self)))


@dataclass(frozen=True)
class KeyFrame:
    """An image whose pose is kept.

    Attributes:
        number: Of it, increasing.
        pose: camera_from_map, one pose.
        ids: Of the features in it, increasing, (n,).
        pixels: Where they are in it, (n, 2).
    """

    number: int
    pose: Poses
    ids: Int64[np.ndarray, " n"]
    pixels: Float32[np.ndarray, "n 2"]


@dataclass(frozen=True)
class Projection:
    """Points of n features in a camera, per unit of their inverse depth: R ray + ρ t.

    Attributes:
        rotation: R of each, camera_from_anchor, (n, 3, 3).
        translation: t of each, (n, 3).
        points: (n, 3).
    """

    rotation: Float64[np.ndarray, "n 3 3"]
    translation: Float64[np.ndarray, "n 3"]
    points: Float64[np.ndarray, "n 3"]


def project(tracks: Tracks, pose: Poses, key_frames: Sequence[KeyFrame]) -> Projection:
    """The features as a camera at a pose (camera_from_map) sees them."""
    numbers = np.array([frame.number for frame in key_frames])
    relative = pose @ Poses.stack([frame.pose for frame in key_frames]).inverse()
    which = np.searchsorted(numbers, tracks.anchor)
    rotation, translation = relative.rotation[which], relative.translation[which]
    ray = np.column_stack([tracks.ray, np.ones(len(tracks))])
    points = (rotation @ ray[:, :, None])[:, :, 0] + tracks.inverse_depth[:, None] * translation
    return Projection(rotation, translation, points)


def pixel_jacobian(
    points: Float64[np.ndarray, "n 3"], focal: Float64[np.ndarray, " 2"]
) -> Float64[np.ndarray, "n 2 3"]:
    """Derivative of where points are in the image by the points, in front of the camera."""
    depth = np.maximum(points[:, 2], LEAST_DEPTH)
    jacobian = np.zeros((len(points), 2, 3))
    jacobian[:, 0, 0], jacobian[:, 1, 1] = focal[0] / depth, focal[1] / depth
    jacobian[:, :, 2] = -focal * points[:, :2] / depth[:, None] ** 2
    return jacobian
