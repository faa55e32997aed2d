"""The views that a map shows: taken elsewhere, an image can be verified at another place only, which looks alike."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float64
from scipy.spatial import KDTree

from filtering.se3 import Poses

_STEEPNESS = 4.0
MOST_ELSEWHERE = 0.3
"""Beyond it what the map shows once only would not tell where the camera is: with 0.6 the filter was not `converged`
in one of 100 walks past such a part of rooms that stand in the map three times, with 0.3 in 78 % of the images."""


@dataclass(frozen=True)
class MappedViews:
    """The views that a map of landmarks was made of.

    Attributes:
        poses: world_from_camera of these, (n,), n ≥ 1.
        depth_m: A depth moved is as much of a difference as a radian turned, metres.
        reach: How different a view is, 1 for a depth or a radian, of which half are verified at their place.
        elsewhere: Probability that landmarks verify another place of an image whose own the map does not show.
        reference_from_camera: The camera, of which `poses` are, seen from what poses are asked of; one pose.
    """

    poses: Poses
    depth_m: float
    reach: float
    elsewhere: float
    reference_from_camera: Poses = field(default_factory=Poses.identity)

    @cached_property
    def _tree(self) -> KDTree:
        return KDTree(self._embedded(self.poses))

    def _embedded(self, poses: Poses) -> Float64[np.ndarray, "n 6"]:
        return np.hstack([poses.translation / self.depth_m, poses.rotation[:, :, 2]]).astype(np.float64)

    def distances(self, poses: Poses) -> Float64[np.ndarray, " k"]:
        """How different what a camera at each of k poses sees is from the likest view of the map, (k,)."""
        return self._tree.query(self._embedded(poses @ self.reference_from_camera))[0]

    def unshown(self, poses: Poses) -> Float64[np.ndarray, " k"]:
        """Probability that the map does not show what a camera at each of k poses sees, (k,)."""
        return unshown(self.distances(poses), self.reach)

    def excuse(self, poses: Poses) -> Float64[np.ndarray, " k"]:
        """How far the verified places of an image say nothing against each of k poses, in [0, 1), (k,).

        What the map does not show cannot be verified; so another place is, as often as one looks alike.
        """
        return self.elsewhere * self.unshown(poses)

    def seen_from(self, reference_from_camera: Poses) -> MappedViews:
        """The same, asked of poses of another frame that is fixed to the camera (one pose)."""
        other = replace(self, reference_from_camera=reference_from_camera @ self.reference_from_camera)
        vars(other)["_tree"] = self._tree
        return other


def unshown(distance: Float64[np.ndarray, " k"], reach: float) -> Float64[np.ndarray, " k"]:
    """Probability that a map does not show what is seen from so different a view, half at its reach, (k,)."""
    return 1.0 / (1.0 + (reach / np.maximum(distance, 1e-9)) ** _STEEPNESS)
