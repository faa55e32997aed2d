"""A planar robot: the tilt and the height of its camera, which its training poses show, as a vertical.

A robot on wheels keeps its camera at one tilt, and at one height above a floor. So the training poses tell both for
where it drives later: the tilt as the direction of the axis about which they turn, and the height by a local linear
regression of theirs over the floor, ramps and stairs included. The spread about either is the noise.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float64, Int64
from scipy.spatial import KDTree

from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from filtering.storeys import up_axis
from filtering.vertical import HeightsAt, Vertical, vertical_errors

_MOST_TILT_RAD = float(np.radians(1.5))  # standard deviation about each axis, of a robot
_OFF_AXIS_RAD = float(np.radians(3.0))
_TURNS = 25.0  # times as much as they tilt: else the axis about which poses turn is not known
_LEAST_TILT_RAD, _LEAST_HEIGHT = 3e-3, 1e-2  # standard deviations; of the height in neighbourhoods
_FEWEST = 20  # training poses
_NEIGHBOURS = 12
_FREE = 0.01  # of a neighbourhood, squared: slopes within it are allowed for
_FAR = 2.0  # neighbourhoods: nothing is known of heights so far from any training pose
_STDS = 6.0  # or at another height by so many standard deviations, and a neighbourhood
_WATCHED, _FEWEST_WATCHED = 30, 5  # images
_DISAGREES = 3.0  # median squared distance of an image's place, per degree of freedom; 0.8 where all is as stated
_LONG, _FEWEST_LONG, _OFF = 150, 30, 1.0  # images over which errors of one sign are watched, and standard deviations


@dataclass(frozen=True, eq=False)
class HeightMap:
    """The heights of n training poses over the floor, as heights known near them (`filtering.vertical.Heights`).

    A height is that of a plane through the nearest training poses, by least squares. Its slope leans towards none, as
    far as slopes are unusual in the whole map.

    Attributes:
        positions: Of training poses, (n, 3), n ≥ 2.
        world_up: Unit vector.
        least_std_m: Standard deviation beside the spread of the heights, metres.

    Example:
        >>> import numpy as np
        >>> import vapor
        >>> ramp = np.array([[x, y, 1.2 + 0.1 * x] for x in np.arange(0, 4, 0.5) for y in np.arange(0, 4, 0.5)])
        >>> vapor.HeightMap(ramp).at(np.array([[2.0, 2.0, 1.0]])).height_m.round(2)
        array([1.4])
    """

    positions: Float64[np.ndarray, "n 3"]
    world_up: tuple[float, float, float] = (0.0, 0.0, 1.0)
    least_std_m: float = 0.0

    def at(self, positions: Float64[np.ndarray, "n 3"]) -> HeightsAt:
        """See `filtering.vertical.Heights`; unknown far from training poses, and between storeys."""
        near_m, near = self._nearest(positions, self._count)
        plane = self._planes(positions, near, self._stiffness)
        std_m = np.sqrt(plane.variance + self._spread**2 * plane.leverage + self.least_std_m**2)
        std_m = np.maximum(std_m, _LEAST_HEIGHT * self._reach_m)
        above_m = np.abs(positions @ np.asarray(self.world_up) - plane.height_m)
        plan_m = np.sqrt(np.maximum(near_m[:, 0] ** 2 - above_m**2, 0.0))
        unknown = (plan_m > _FAR * self._reach_m) | (above_m > _STDS * std_m + self._reach_m)
        unknown |= std_m > self._reach_m
        return HeightsAt(plane.height_m, plane.slope, np.where(unknown, np.inf, std_m))

    @property
    def spread_m(self) -> float:
        """Standard deviation of a training pose's height from the others' about it, metres."""
        return float(np.hypot(self._spread, self.least_std_m))

    @cached_property
    def _tree(self) -> KDTree:
        return KDTree(self.positions)

    def _nearest(
        self, positions: Float64[np.ndarray, "p 3"], count: int
    ) -> tuple[Float64[np.ndarray, "p k"], Int64[np.ndarray, "p k"]]:
        """Distances and numbers of the nearest training positions."""
        distances, numbers = self._tree.query(positions, count)
        return np.asarray(distances), np.asarray(numbers)

    @property
    def _count(self) -> int:
        return min(_NEIGHBOURS, len(self.positions))

    @cached_property
    def _reach_m(self) -> float:
        """How far the neighbours of a training pose reach."""
        return max(float(np.median(self._nearest(self.positions, self._count)[0][:, -1])), 1e-9)

    @cached_property
    def _own(self) -> tuple[float, float]:
        """How little slopes are allowed for, and the standard deviation of heights from the planes of others about.

        The first is the variance of heights about planes over that of slopes along either axis, m².
        """
        near = self._nearest(self.positions, min(self._count + 1, len(self.positions)))[1][:, 1:]
        free = self._planes(self.positions, near, _FREE * self._reach_m**2)
        slope_variance = float(np.mean(np.sum(np.square(free.slope), axis=1))) / 2.0
        stiffness = float(np.mean(free.variance)) / max(slope_variance, 1e-12)
        stiffness = max(stiffness, _FREE * self._reach_m**2)
        off = self.positions @ np.asarray(self.world_up) - self._planes(self.positions, near, stiffness).height_m
        return stiffness, max(float(np.sqrt(np.mean(np.square(off)))), 1e-12)

    @property
    def _stiffness(self) -> float:
        return self._own[0]

    @property
    def _spread(self) -> float:
        return self._own[1]

    def _planes(
        self, positions: Float64[np.ndarray, "p 3"], near: Int64[np.ndarray, "p k"], stiffness: float
    ) -> _Planes:
        """The plane through the neighbours of each position, at it."""
        up = np.asarray(self.world_up)
        offset = self.positions[near] - positions[:, None]
        heights_m = self.positions[near] @ up
        plan = offset - (offset @ up)[:, :, None] * up
        middle, mean_m = plan.mean(axis=1), heights_m.mean(axis=1)
        plan = plan - middle[:, None]
        covariance = np.linalg.inv(np.einsum("pki,pkj->pij", plan, plan) + stiffness * np.eye(3))
        steepest = np.einsum("pki,pk->pi", plan, heights_m - mean_m[:, None])
        slope = np.einsum("pij,pj->pi", covariance, steepest)
        slope = slope - (slope @ up)[:, None] * up
        residual = heights_m - mean_m[:, None] - np.einsum("pki,pi->pk", plan, slope)
        leverage = 1.0 / near.shape[1] + np.einsum("pi,pij,pj->p", middle, covariance, middle)
        height_m = mean_m - np.einsum("pi,pi->p", middle, slope)
        return _Planes(height_m, slope, np.mean(np.square(residual), axis=1), leverage)


@dataclass(frozen=True)
class _Planes:
    """Height, slope, variance of the neighbours about it, and that of the height in units of theirs, (p,)."""

    height_m: Float64[np.ndarray, " p"]
    slope: Float64[np.ndarray, "p 3"]
    variance: Float64[np.ndarray, " p"]
    leverage: Float64[np.ndarray, " p"]


def world_up_of(poses: Poses) -> tuple[float, float, float]:
    """Up in the world, by cameras (n,) that somebody or something carried upright.

    It is the axis of the world that is up in most of them; another direction where they turn about one that is further
    than 3° from it, and than twice their tilt's standard deviation, and turn far more than they tilt.
    """
    axis = up_axis(poses)
    found = Planar.found_in(poses)
    if found is not None and found.turns_most:
        off_rad = np.arccos(np.clip(np.dot(found.vertical.world_up, axis), -1.0, 1.0))
        if off_rad > max(_OFF_AXIS_RAD, 2.0 * found.tilt_std_rad):
            return found.vertical.world_up
    x, y, z = (float(each) for each in axis)
    return x, y, z


@dataclass(frozen=True)
class Planar:
    """The tilt and height of a robot's camera, as its training poses show them.

    Attributes:
        vertical: Both, as a measurement of every image.
        tilt_std_rad: Spread of the tilt of the training poses, about each axis.
        turns_most: Whether the camera turned about one axis by five times as much as it tilted, so that the axis is
            known.
    """

    vertical: Vertical
    tilt_std_rad: float
    turns_most: bool

    @property
    def is_robot(self) -> bool:
        """Whether they are those of a robot: of one tilt within 1.5°, one standard deviation about each axis."""
        return self.turns_most and self.tilt_std_rad <= _MOST_TILT_RAD

    @staticmethod
    def found_in(poses: Poses, *, tilt_error_rad: float = 0.0, height_error_m: float = 0.0) -> Planar | None:
        """What training poses show; None where there are fewer than 20.

        The axis w of the world about which they turn, and its direction c in the camera, are those with Rᵢᵀ w ≈ c for
        all rotations Rᵢ: the first singular vectors of their sum.

        Args:
            poses: world_from_camera, batch (n,).
            tilt_error_rad: Standard deviation of errors of these poses themselves, where they are a network's.
            height_error_m: Likewise of their heights.
        """
        if len(poses) < _FEWEST:
            return None
        left, values, right = np.linalg.svd(poses.rotation.mean(axis=0))
        world_up, up = left[:, 0], right[0]
        if world_up @ up_axis(poses) < 0.0:
            world_up, up = -world_up, -up
        off = np.einsum("nji,j->ni", poses.rotation, world_up) - up
        spread = float(np.sqrt(np.mean(np.sum(np.square(off), axis=1)) / 2.0))
        turned = float(np.sqrt(max(1.0 - min(values[1], 1.0), 0.0)))
        tilt_std = max(float(np.hypot(spread, tilt_error_rad)), _LEAST_TILT_RAD)
        x, y, z = (float(each) for each in world_up)
        heights = HeightMap(poses.translation, (x, y, z), height_error_m)
        a, b, c = (float(each) for each in up)
        vertical = Vertical((a, b, c), tilt_std, heights, (x, y, z))
        return Planar(vertical, tilt_std, bool(turned > np.sqrt(_TURNS) * spread))


class VerticalWatch:
    """Watches whether images agree with verticals, and lets go of these while they do not.

    An image speaks by its heaviest place, one verified by landmarks before others: by how far its tilt and height are
    from the known ones, in standard deviations of both. The belief itself says nothing of it, as it was corrected.

    Attributes:
        is_let_go: Whether the latest images disagree: the median of the last 30 is above √3 standard deviations, or the
            mean error of the last 150 is above one along an axis, as of a camera at another height.
        num_let_go: Number of images for which it was so.
        num_images: Number of all.
        largest_tilt_rad: The largest of the median angles by which directions were off while it was so.
    """

    def __init__(self) -> None:
        """Before the first image."""
        self._squared: deque[float] = deque(maxlen=_WATCHED)
        self._angles: deque[float] = deque(maxlen=_WATCHED)
        self._signed: deque[Float64[np.ndarray, " k"]] = deque(maxlen=_LONG)
        self.is_let_go, self.num_let_go, self.num_images = False, 0, 0
        self.largest_tilt_rad = 0.0

    def step(self, posterior: PosePosterior, vertical: Vertical) -> Vertical | None:
        """The vertical, if it is to be used with its image, by this one and those before.

        None while it is let go, and before five images have spoken.
        """
        if not posterior.is_uninformative:
            self._squared.append(self._disagreement(posterior, vertical))
            self.is_let_go = len(self._squared) >= _FEWEST_WATCHED and (
                float(np.median(self._squared)) > _DISAGREES or self._is_off()
            )
        self.num_images += 1
        self.num_let_go += self.is_let_go
        if self.is_let_go:
            self.largest_tilt_rad = max(self.largest_tilt_rad, float(np.median(self._angles)))
        return None if self.is_let_go or len(self._squared) < _FEWEST_WATCHED else vertical

    def _is_off(self) -> bool:
        """Whether the images err to one side along an axis."""
        if len(self._signed) < _FEWEST_LONG:
            return False
        return bool(np.abs(np.mean(np.array(self._signed), axis=0)).max() > _OFF)

    def _disagreement(self, posterior: PosePosterior, vertical: Vertical) -> float:
        """Squared distance of the image's heaviest place from the vertical, per degree of freedom."""
        weights = posterior.weights
        if posterior.verified is not None and posterior.verified.any():
            weights = np.where(posterior.verified, weights, -1.0)
        heaviest = int(np.argmax(weights))
        found = vertical_errors(vertical, posterior.means[[heaviest]])
        jacobian, innovation = found.of_pose[0], found.innovation[0]
        self._angles.append(float(np.linalg.norm(innovation[:2])) if vertical.up is not None else 0.0)
        covariance = jacobian @ posterior.covariances[heaviest] @ jacobian.T + np.diag(found.variance[0])
        self._signed.append(innovation / np.sqrt(np.maximum(np.diagonal(covariance), 1e-30)))
        known = np.any(jacobian != 0.0, axis=1)
        innovation, covariance = innovation[known], covariance[np.ix_(known, known)]
        return float(innovation @ np.linalg.solve(covariance, innovation)) / max(len(innovation), 1)
