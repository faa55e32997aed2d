"""The vertical: the direction of gravity in the frame that is localized, and its height, as measurements of the state.

Gravity is two degrees of freedom of the rotation, a height is one of the position. Their errors last (the bias and the
mount of an accelerometer, a floor that is not where it was taken for), so most of such an error is part of the state,
like that of a source of places: it fades along the path (`Vertical.lengths`), and no repetition averages it out.

Source: Solà, Deray and Atchuthan, "A micro Lie theory for state estimation in robotics", 2018 (Jacobians on SE(3)).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float64

from filtering.errors import VaporTrackError, require_within
from filtering.hypotheses import POSE, Hypotheses, correlated_error
from filtering.measurement import Measurement, kalman_update, predict_measurement
from filtering.measurement_noise import PLACE
from filtering.se3 import Poses
from filtering.so3 import skew
from filtering.unchecked import unchecked_replace

LASTING = 0.9
"""Fraction of the error's variance that lasts; the rest is independent from step to step."""
_DEGREES_OF_FREEDOM = 5.0  # of the Student t distribution of the error
_UNUSUAL = 1.25  # factor of the variance from which on an error is taken as one of its own
_OUTLIER = 0.05  # probability that a measurement says nothing of where the frame is
_UNIT = 1e-6  # of the length of a direction
_HEIGHT, _TILT = 0, slice(3, 6)  # parts of the lasting error that are used


class HeightsAt(NamedTuple):
    """Known heights at n positions, along the world's up.

    Attributes:
        height_m: Of the frame that is localized, if it is there in plan, (n,).
        slope: Change of the height with the position, a vector of the world across its up, (n, 3).
        std_m: Standard deviation of the error, (n,); infinite where nothing is known.
    """

    height_m: Float64[np.ndarray, " n"]
    slope: Float64[np.ndarray, "n 3"]
    std_m: Float64[np.ndarray, " n"]


@runtime_checkable
class Heights(Protocol):
    """Which height the frame has, by where it is: `KnownHeight`, or a `HeightMap` of floors."""

    def at(self, positions: Float64[np.ndarray, "n 3"]) -> HeightsAt:
        """Heights at positions in the world."""
        ...


@dataclass(frozen=True)
class KnownHeight:
    """A height that was measured, wherever the frame is.

    Raises:
        VaporTrackError: it is not finite, or its standard deviation not positive.

    Example:
        >>> import vapor
        >>> of_a_floor = vapor.KnownHeight(height_m=3.0, std_m=0.2)
        >>> vapor.Vertical(heights=of_a_floor).degrees_of_freedom
        1
    """

    height_m: float
    std_m: float

    def __post_init__(self) -> None:
        require_within(self, height_m=(-1e9, 1e9), std_m=(1e-6, 1e9))

    def at(self, positions: Float64[np.ndarray, "n 3"]) -> HeightsAt:
        """See `Heights`."""
        count = len(positions)
        return HeightsAt(np.full(count, self.height_m), np.zeros((count, 3)), np.full(count, self.std_m))


@dataclass(frozen=True)
class Vertical:
    """What is known of the vertical at one moment.

    Attributes:
        up: Unit vector: the world's up in the frame that is localized, against gravity; None where it is unknown.
        tilt_std_rad: Standard deviation of its error, about each axis across it.
        heights: Height of the frame; None where it is unknown.
        world_up: Unit vector: up in the world.
        lengths: Normalized distance over which its errors last; infinite for a bias that never fades.

    Raises:
        VaporTrackError: a direction is not a unit vector, or a number is out of range.

    Example:
        >>> import vapor
        >>> level = vapor.Vertical(up=(0.0, -1.0, 0.0), tilt_std_rad=0.02)  # of a camera whose y is down
        >>> level.degrees_of_freedom
        2
    """

    up: tuple[float, float, float] | None = None
    tilt_std_rad: float = 0.02
    heights: Heights | None = None
    world_up: tuple[float, float, float] = (0.0, 0.0, 1.0)
    lengths: float = 1.0

    def __post_init__(self) -> None:
        require_within(self, tilt_std_rad=(1e-5, 4.0))
        if not self.lengths > 0.0:  # NaN compares as false
            raise VaporTrackError(f"lengths is {self.lengths}, expected a positive number, or infinity")
        for name in ("up", "world_up"):
            value = getattr(self, name)
            if value is not None and not (len(value) == 3 and abs(float(np.linalg.norm(value)) - 1.0) <= _UNIT):
                raise VaporTrackError(f"{name} is {value}, expected a unit vector")

    @property
    def degrees_of_freedom(self) -> int:
        """How many numbers it measures: two of gravity, one of the height."""
        return 2 * (self.up is not None) + (self.heights is not None)


class VerticalErrors(NamedTuple):
    """A vertical as k measurements of each of n states, y = J ξ + F u + e.

    Attributes:
        innovation: Measured less expected, for an error of 0: y, (n, k), radians of gravity, then metres of height.
        of_pose: J, of the error of the pose, (n, k, 6).
        of_lasting: F, of the lasting error, whose parts have the variance 1, (n, k, 6).
        variance: Of the whole error of each, (n, k); `LASTING` of it is that of F u.
    """

    innovation: Float64[np.ndarray, "n k"]
    of_pose: Float64[np.ndarray, "n k 6"]
    of_lasting: Float64[np.ndarray, "n k 6"]
    variance: Float64[np.ndarray, "n k"]


def vertical_errors(vertical: Vertical, poses: Poses) -> VerticalErrors:
    """A vertical as measurements of poses.

    The true rotation is R exp(ω), which sees up at exp(−ω) Rᵀ w. If a turn by θ carries Rᵀ w to the measured
    direction, ω = −θ across it. The true height is w·(t + R v).

    Args:
        vertical: What is known.
        poses: world_from_frame, batch (n,).
    """
    count, root = len(poses), np.sqrt(LASTING)
    world_up = np.asarray(vertical.world_up)
    expected = np.einsum("nji,j->ni", poses.rotation, world_up)
    parts: list[VerticalErrors] = []
    if vertical.up is not None:
        across = _across(expected)
        of_pose, of_lasting = np.zeros((count, 2, 6)), np.zeros((count, 2, 6))
        of_pose[:, :, 3:] = across
        of_lasting[:, :, _TILT] = root * vertical.tilt_std_rad * across
        turn = np.einsum("nki,ni->nk", across, _turn(expected, np.asarray(vertical.up), across))
        parts.append(VerticalErrors(-turn, of_pose, of_lasting, np.full((count, 2), vertical.tilt_std_rad**2)))
    if vertical.heights is not None:
        height_m, slope, std_m = vertical.heights.at(poses.translation)
        known = np.isfinite(std_m)
        of_pose, of_lasting = np.zeros((count, 1, 6)), np.zeros((count, 1, 6))
        rises = np.einsum("nji,nj->ni", poses.rotation, world_up - slope)
        of_pose[:, 0, :3] = np.where(known[:, None], rises, 0.0)
        of_lasting[:, 0, _HEIGHT] = np.where(known, root * std_m, 0.0)
        above_m = np.where(known, height_m - poses.translation @ world_up, 0.0)
        parts.append(
            VerticalErrors(above_m[:, None], of_pose, of_lasting, np.where(known, np.square(std_m), 1.0)[:, None])
        )
    return VerticalErrors(*(np.concatenate(each, axis=1) for each in zip(*parts, strict=True)))


def _across(directions: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "n 2 3"]:
    """Two unit vectors across each of n directions, and across each other."""
    cross = skew(directions)
    least = np.abs(directions).argmin(axis=1)
    one = cross[np.arange(len(cross)), :, least]
    one /= np.sqrt(np.vecdot(one, one))[:, None]
    return np.stack([one, (cross @ one[:, :, None])[:, :, 0]], axis=1)


def _turn(
    begin: Float64[np.ndarray, "n 3"], end: Float64[np.ndarray, "3"], across: Float64[np.ndarray, "n 2 3"]
) -> Float64[np.ndarray, "n 3"]:
    """Rotation vectors of the shortest turns that carry directions to another one; about any axis if it is opposite."""
    axis, cosine = skew(begin) @ end, begin @ end
    sine = np.sqrt(np.vecdot(axis, axis))
    axis = np.where((sine < 1e-12)[:, None], across[:, 0], axis / np.maximum(sine, 1e-12)[:, None])
    return np.arctan2(sine, cosine)[:, None] * axis


@dataclass(frozen=True)
class VerticalMemory:
    """What the filter remembers of the verticals that it was given.

    Attributes:
        number: Of their lasting error in the state, see `correlated_error`.
        lengths: Of the latest one, see `Vertical`.
        since: Lengths since it; 1 before the first.
    """

    number: int
    lengths: float
    since: float = 1.0

    def predict(self, normalized_distance: float) -> tuple[VerticalMemory, float]:
        """After a motion; and that in lengths of this error."""
        moved = normalized_distance / self.lengths
        return unchecked_replace(self, since=self.since + moved), moved

    def observe(self, vertical: Vertical) -> VerticalMemory:
        """After a vertical."""
        return unchecked_replace(self, lengths=vertical.lengths, since=0.0)


def corrected_by(vertical: Vertical, belief: Hypotheses, memory: VerticalMemory) -> Hypotheses:
    """Hypotheses corrected by a vertical, and weighed by how well they fit it.

    One that is upside down, or at a height where nobody can be, is not possible. The evidence saturates like that of an
    image, counts once a length, and is among the hypotheses only: a wrong measurement changes none of their sum. A
    measurement that differs by more than usual has an error of its own, which is taken to be that large.

    Args:
        vertical: What is known; at least gravity or a height.
        belief: n hypotheses, with the lasting error in their states.
        memory: Of earlier verticals.
    """
    own, every = correlated_error(memory.number), np.arange(len(belief))
    found = vertical_errors(vertical, belief.poses)
    lasting = belief.mean[:, own.start - 6 : own.stop - 6]
    innovation = found.innovation - np.einsum("nki,ni->nk", found.of_lasting, lasting)
    jacobian = ((POSE, found.of_pose), (own, found.of_lasting.copy()))
    noise = _diagonal((1.0 - LASTING) * found.variance)
    predicted = predict_measurement(belief.covariance, every, jacobian, noise)
    squared = np.einsum("nk,nkl,nl->n", innovation, predicted.innovation_precision, innovation)
    larger = _enlarged(squared, vertical.degrees_of_freedom)
    lasts = _lasts(memory.since)
    far = (larger > _UNUSUAL).nonzero()[0]
    if len(far):
        innovation[far], jacobian[1][1][far] = found.innovation[far], 0.0
        noise[far] = _diagonal(lasts * larger[far, None] * found.variance[far])
        predicted = predict_measurement(belief.covariance, every, jacobian, noise)
    change, covariance = kalman_update(belief.covariance, every, Measurement(innovation, jacobian, noise), predicted)
    log_fit = min(memory.since, 1.0) * np.log(_OUTLIER + (1.0 - _OUTLIER) * np.exp(-0.5 * squared / PLACE**2))
    return Hypotheses(
        (belief.poses @ Poses.exp(change[:, POSE])).orthonormal(),
        belief.mean + change[:, 6:],
        covariance,
        belief.log_weights + log_fit,
        belief.regime,
    ).normalized()


def _enlarged(squared: Float64[np.ndarray, " n"], degrees_of_freedom: int) -> Float64[np.ndarray, " n"]:
    """Factor of the variance of an error with this squared distance."""
    return (_DEGREES_OF_FREEDOM + squared) / (_DEGREES_OF_FREEDOM + degrees_of_freedom)


def _lasts(since: float) -> float:
    """How many times an error counts that lasts as long as an Ornstein-Uhlenbeck process: one image in two lengths."""
    return max(1.0, 2.0 / max(since, 1e-6))


def _diagonal(variances: Float64[np.ndarray, "n k"]) -> Float64[np.ndarray, "n k k"]:
    return variances[:, :, None] * np.eye(variances.shape[1])


def whitened(
    vertical: Vertical, pose: Poses, mean: Float64[np.ndarray, " m"], memory: VerticalMemory
) -> tuple[Float64[np.ndarray, "k d"], Float64[np.ndarray, " k"]]:
    """Jacobian and value of a vertical as a measurement of the change of a state, in units of its error.

    Args:
        vertical: What is known.
        pose: world_from_frame, one pose, from which the error ξ is 0.
        mean: The other parts of the state, (d − 6,).
        memory: Of earlier verticals.
    """
    own = correlated_error(memory.number)
    found = vertical_errors(vertical, Poses.stack([pose]))
    known = found.of_lasting[0] @ mean[own.start - 6 : own.stop - 6]
    innovation = found.innovation[0] - known
    squared = np.sum(np.square(innovation) / found.variance[0], keepdims=True)
    larger = float(_enlarged(squared, vertical.degrees_of_freedom)[0])
    jacobian = np.zeros((len(innovation), 6 + len(mean)))
    jacobian[:, POSE] = found.of_pose[0]
    if larger > _UNUSUAL:
        innovation, variance = found.innovation[0], _lasts(memory.since) * larger * found.variance[0]
    else:
        jacobian[:, own], variance = found.of_lasting[0], (1.0 - LASTING) * found.variance[0]
    std = np.sqrt(variance)
    return jacobian / std[:, None], innovation / std
