"""Odometry: the motion of the camera between two images, its noise and its bias."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float64

from filtering.errors import VaporTrackError, require_within
from filtering.se3 import Poses, require_one_pose
from filtering.unchecked import unchecked_replace

_LEAST_SCALE = 0.1
_WALK_M_PER_S = 1.5  # along each axis, of a motion of which the rotation alone is known
_RIGID = 1e-6  # of RRᵀ − I: float32 passes
_LARGEST_VARIANCE, _LONGEST_M = 1e12, 1e9
_NODES, _NODE_WEIGHTS = np.polynomial.legendre.leggauss(10)  # 1e-14 of the integral for turns up to π
_REMAINING, _NODE_WEIGHTS = (1.0 - _NODES) / 2, _NODE_WEIGHTS / 2


@dataclass(frozen=True)
class Odometry:
    """Relative motion of the camera from one image to the next.

    Attributes:
        previous_from_current: One pose: the camera now, in the camera frame at the previous image.
        covariance: Covariance of ξ = (v, ω) in metres and radians, where the true motion is
            `previous_from_current @ Poses.exp(ξ)`; symmetric, positive semidefinite, in the current camera frame. Of
            white noise only: that of consecutive increments is independent.
        duration_s: Seconds it took, 0 or more.
        knows_translation: False of a motion of which the rotation alone was measured, see `turn`.

    Example:
        >>> import numpy as np
        >>> import vapor
        >>> ahead = vapor.Poses.exp(np.array([0, 0, 0.25, 0, 0.1, 0]))  # z is forward; turned about y
        >>> std = [0.01, 0.01, 0.02, 0.005, 0.005, 0.005]
        >>> odometry = vapor.Odometry(ahead, np.diag(np.square(std)), duration_s=0.5)
        >>> odometry.then(odometry).duration_s
        1.0
    """

    previous_from_current: Poses
    covariance: Float64[np.ndarray, "6 6"]
    duration_s: float
    knows_translation: bool = True

    @staticmethod
    def still(duration_s: float = 0.0) -> Odometry:
        """No motion, and no error."""
        still = Odometry(Poses.identity(), np.zeros((6, 6)), duration_s)
        vars(still).update(tangent=np.zeros(6), carry=np.eye(6), noise=np.zeros((6, 6)))
        return still

    @staticmethod
    def turn(rotation: Poses, covariance: Float64[np.ndarray, "3 3"], duration_s: float) -> Odometry:
        """A motion of which the rotation alone is known, as by a gyroscope.

        A filter moves by an unknown velocity meanwhile (`GapConfig`). To others the translation is 0, with the error of
        a brisk walk.

        Args:
            rotation: One pose, of which the rotation counts.
            covariance: Of the rotation, rad².
            duration_s: Seconds it took.
        """
        of_all = np.diag(np.repeat([(_WALK_M_PER_S * duration_s) ** 2, 0.0], 3))
        of_all[3:, 3:] = covariance
        return Odometry(Poses(rotation.rotation, np.zeros(3)), of_all, duration_s, knows_translation=False)

    @property
    def rotation_only(self) -> Odometry:
        """The same, of which the rotation alone is known."""
        return Odometry.turn(self.previous_from_current, self.covariance[3:, 3:], self.duration_s)

    @cached_property
    def tangent(self) -> Float64[np.ndarray, " 6"]:
        """ξ with `previous_from_current` = exp(ξ), metres and radians."""
        return self.previous_from_current.log()

    @cached_property
    def carry(self) -> Float64[np.ndarray, "6 6"]:
        """The matrix that maps the error of a pose before the motion to the one after it."""
        return self.previous_from_current.inverse().adjoint()

    @cached_property
    def noise(self) -> Float64[np.ndarray, "6 6"]:
        """The nearest covariance that is symmetric and has no negative eigenvalue.

        Raises:
            VaporTrackError: as `covariance_factor`.
        """
        factor = covariance_factor(self.covariance)
        return factor @ factor.T

    @cached_property
    def spread_noise(self) -> Float64[np.ndarray, "6 6"]:
        """Covariance of the noise that, spread evenly along the motion, adds up to its covariance (`accumulated`)."""
        return _spread_noise(self.tangent, self.covariance)

    @cached_property
    def is_motion(self) -> bool:
        """True; raises as `require_odometry`."""
        _require_motion(self)
        return True

    def of_another_frame(self, this_from_other: Poses) -> Odometry:
        """The motion of another frame that is fixed to this one (one pose)."""
        other_from_this = this_from_other.inverse()
        carry = other_from_this.adjoint()
        moved = self.previous_from_current
        other = Odometry(
            moved if moved.is_identity else other_from_this @ moved @ this_from_other,
            carry @ self.covariance @ carry.T,
            self.duration_s,
        )
        return other if self.knows_translation else other.rotation_only

    def then(self, later: Odometry) -> Odometry:
        """This motion and the one that follows it as one."""
        whole = Odometry(
            self.previous_from_current @ later.previous_from_current,
            later.carry @ self.covariance @ later.carry.T + later.covariance,
            self.duration_s + later.duration_s,
        )
        return whole if self.knows_translation and later.knows_translation else whole.rotation_only

    def in_unit(self, metres: float) -> Odometry:
        """The motion, whose lengths are in a unit of so many metres, in metres."""
        to_metres = np.repeat([metres, 1.0], 3)
        moved = Poses(self.previous_from_current.rotation, metres * self.previous_from_current.translation)
        return replace(self, previous_from_current=moved, covariance=to_metres[:, None] * self.covariance * to_metres)

    def rescaled(self, scale_error: float) -> Odometry:
        """The motion less an error of its scale (`OdometryBias`); a tenth of its length at least."""
        moved, factor = self.previous_from_current, max(1.0 - scale_error, _LEAST_SCALE)
        if scale_error == 0.0 or moved.is_identity:
            return self
        tangent = self.tangent.copy()
        tangent[:3] *= factor
        rescaled = unchecked_replace(self, previous_from_current=Poses.exp(tangent))
        vars(rescaled)["tangent"] = tangent
        return rescaled

    def part(self, fraction: float) -> Odometry:
        """The first part of this motion, a fraction of its duration, as if twist and noise were constant along it."""
        first = fraction * self.tangent
        covariance = accumulated(first, fraction * self.spread_noise)
        begun = Odometry(Poses.exp(first), covariance, fraction * self.duration_s)
        return begun if self.knows_translation else begun.rotation_only

    def after(self, first: Odometry) -> Odometry:
        """The rest of this motion after its first part: `first.then(rest)` is this motion.

        Where the first part is less certain than the whole, the covariance of the rest is the nearest one.
        """
        rest = first.previous_from_current.inverse() @ self.previous_from_current
        carry = rest.inverse().adjoint()
        covariance = _nearest_semidefinite(self.covariance - carry @ first.covariance @ carry.T)
        left = Odometry(rest, covariance, max(self.duration_s - first.duration_s, 0.0))
        return left if self.knows_translation and first.knows_translation else left.rotation_only


def require_odometry(odometry: Odometry) -> None:
    """Check that odometry is one rigid motion with a covariance.

    Raises:
        VaporTrackError: the motion is not one pose, not finite, not rigid or longer than 10⁹ m, its duration is
            invalid (`require_duration`), or as `covariance_factor`.
    """
    _ = odometry.is_motion


def _require_motion(odometry: Odometry) -> None:
    motion = odometry.previous_from_current
    require_one_pose("odometry increment", motion)
    rotation = motion.rotation
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > _RIGID or np.linalg.det(rotation) < 0:
        raise VaporTrackError(
            f"odometry increment has {rotation.tolist()} for a rotation, expected orthonormal columns (to {_RIGID:g}) "
            "and determinant 1"
        )
    if (distance_m := float(np.abs(motion.translation).max())) > _LONGEST_M:
        raise VaporTrackError(f"odometry increment goes {distance_m:.3g} m, expected at most {_LONGEST_M:g} m")
    require_duration(odometry.duration_s)
    _ = odometry.noise
    widest = float(np.diagonal(odometry.covariance).max())
    if widest > _LARGEST_VARIANCE:
        raise VaporTrackError(
            f"odometry covariance has the variance {widest:.3g}, expected at most {_LARGEST_VARIANCE:g} m² or rad²;"
            " where the motion is unknown, give no odometry"
        )


def require_duration(duration_s: float) -> None:
    """Check that a duration is finite and not negative.

    Raises:
        VaporTrackError: it is not.
    """
    if not 0.0 <= duration_s < np.inf:
        raise VaporTrackError(f"odometry increment took {duration_s} s, expected a finite duration of 0 s or more")


def accumulated(
    tangent: Float64[np.ndarray, "*batch 6"], noise: Float64[np.ndarray, "*batch 6 6"]
) -> Float64[np.ndarray, "*batch 6 6"]:
    """Covariance, at the end of motions of constant twist, of white noise spread evenly along them.

    Q = ∫₀¹ A(u) noise A(u)ᵀ du with A(u) = Ad(exp(−(1 − u) ξ)), by Gauss-Legendre quadrature (relative error below 1e-9
    for turns up to π). The parts of a motion accumulate the same covariance as the whole.

    Args:
        tangent: ξ = (v, ω) of whole motions, metres and radians.
        noise: Covariance of the noise along each, in the moving frame.
    """
    carry = Poses.exp(-_REMAINING[:, None] * tangent[..., None, :]).adjoint()
    weighted = carry * _NODE_WEIGHTS[:, None, None]
    covariance = (weighted @ noise[..., None, :, :] @ np.swapaxes(carry, -1, -2)).sum(axis=-3)
    return (covariance + np.swapaxes(covariance, -1, -2)) / 2


def _spread_noise(
    tangent: Float64[np.ndarray, " 6"], covariance: Float64[np.ndarray, "6 6"]
) -> Float64[np.ndarray, "6 6"]:
    """The noise that `accumulated` makes this covariance of."""
    carry = Poses.exp(-_REMAINING[:, None] * tangent).adjoint()
    accumulates = np.einsum("n,nij,nkl->ikjl", _NODE_WEIGHTS, carry, carry).reshape(36, 36)
    noise = np.linalg.lstsq(accumulates, covariance.ravel(), rcond=1e-9)[0].reshape(6, 6)
    return _nearest_semidefinite(noise)


def _nearest_semidefinite(matrix: Float64[np.ndarray, "6 6"]) -> Float64[np.ndarray, "6 6"]:
    symmetric = (matrix + matrix.T) / 2
    eigenvalues, eigenvectors = np.linalg.eigh(symmetric)
    return symmetric if eigenvalues[0] >= 0.0 else (eigenvectors * np.clip(eigenvalues, 0.0, None)) @ eigenvectors.T


@runtime_checkable
class WhiteNoise(Protocol):
    """A model of the white noise of odometry: `MotionNoise`, or a fitted one."""

    def along(
        self, tangent: Float64[np.ndarray, "*batch 6"], duration_s: Float64[np.ndarray, "*batch"]
    ) -> Float64[np.ndarray, "*batch 6"]:
        """Variances, m² and rad², along motions of constant twist, each axis of the moving frame.

        Args:
            tangent: ξ = (v, ω) of each motion.
            duration_s: Seconds it took.
        """
        ...


@dataclass(frozen=True)
class MotionNoise:
    """Stated white noise of odometry whose messages carry no covariance (Thrun et al. 2005, §5.4, in three dimensions).

    Variances grow in proportion to distance, angle and time along the path, so a motion's covariance does not depend on
    its increments. Jitter counts, too.
    """

    translation_per_sqrt_m: float = 0.02
    """Metres of error after one metre moved."""
    translation_per_sqrt_rad: float = 0.01
    """Metres of error after one radian turned."""
    rotation_per_sqrt_m: float = 0.01
    """Radians of error after one metre moved."""
    rotation_per_sqrt_rad: float = 0.02
    """Radians of error after one radian turned."""
    translation_per_sqrt_s: float = 0.01
    """Metres of error after one second at rest."""
    rotation_per_sqrt_s: float = 0.01
    """Radians of error after one second at rest."""

    def __post_init__(self) -> None:
        require_within(
            self,
            translation_per_sqrt_m=(0.0, 1e3),
            translation_per_sqrt_rad=(0.0, 1e3),
            rotation_per_sqrt_m=(0.0, 1e3),
            rotation_per_sqrt_rad=(0.0, 1e3),
            translation_per_sqrt_s=(0.0, 1e3),
            rotation_per_sqrt_s=(0.0, 1e3),
        )

    def along(
        self, tangent: Float64[np.ndarray, "*batch 6"], duration_s: Float64[np.ndarray, "*batch"]
    ) -> Float64[np.ndarray, "*batch 6"]:
        """See `WhiteNoise.along`."""
        moved_m, turned_rad = np.linalg.norm(tangent[..., :3], axis=-1), np.linalg.norm(tangent[..., 3:], axis=-1)
        variance_t = (
            self.translation_per_sqrt_m**2 * moved_m
            + self.translation_per_sqrt_rad**2 * turned_rad
            + self.translation_per_sqrt_s**2 * duration_s
        )
        variance_r = (
            self.rotation_per_sqrt_m**2 * moved_m
            + self.rotation_per_sqrt_rad**2 * turned_rad
            + self.rotation_per_sqrt_s**2 * duration_s
        )
        return np.repeat(np.stack([variance_t, variance_r], axis=-1), 3, axis=-1)

    def covariance(self, previous_from_current: Poses, duration_s: float) -> Float64[np.ndarray, "6 6"]:
        """Covariance of one increment of constant twist, in the tangent at the current frame.

        Args:
            previous_from_current: One pose, the increment.
            duration_s: Seconds it took; 0 for a motion whose error comes from its length alone.

        Raises:
            VaporTrackError: the duration is negative or not finite.
        """
        require_duration(duration_s)
        tangent = previous_from_current.log()
        return accumulated(tangent, np.diag(self.along(tangent, np.array(duration_s))))


def measured(odometry: Odometry | None) -> Odometry | None:
    """Odometry that knows the translation; None for another one."""
    return odometry if odometry is not None and odometry.knows_translation else None


def joined(motions: Iterable[Odometry | None]) -> Odometry | None:
    """Consecutive motions as one; None where one is unknown."""
    whole = Odometry.still()
    for motion in motions:
        if motion is None:
            return None
        whole = whole.then(motion)
    return whole


class GapMotion(NamedTuple):
    """What is known of a motion without odometry.

    Attributes:
        likely: Pose after it in the frame before it, by the velocity that the belief has found.
        unknown_m: Distance that the camera may have come beside it, metres.
        unknown_rad: Likewise an angle, radians.
    """

    likely: Poses
    unknown_m: float = 0.0
    unknown_rad: float = 0.0

    def of_another_frame(self, this_from_other: Poses) -> GapMotion:
        """The motion of another frame that is fixed to this one (one pose)."""
        if this_from_other.is_identity:
            return self
        return self._replace(likely=this_from_other.inverse() @ self.likely @ this_from_other)


@dataclass(frozen=True)
class OdometryBias:
    """Scale error and drift of odometry, beside the white noise of its covariance.

    An increment that is reported as (v, ω) in the camera frame errs by s·(v, 0) + b·duration, where the scale error s
    and the drift b = (b_v, b_ω) are Ornstein-Uhlenbeck processes. A positive s is a distance reported too long.
    """

    scale: float = 0.02
    """Standard deviation of the scale error, as a fraction of the distance."""
    drift: tuple[float, float, float, float, float, float] | None = None
    """Standard deviations of the drift, each axis of the camera: m/s, then rad/s. Default: by `relative_drift`."""
    relative_drift: float = 1.0
    """Standard deviation of the drift over the square root of the rate at which the stated variance grows, each axis,
    1/√s: with 1.0 drift and white noise are equal after one second."""
    time_s: float = 30.0
    """Time over which the drift changes, seconds."""
    scale_time_s: float = 1e9
    """Time over which the scale error changes, seconds."""

    def __post_init__(self) -> None:
        require_within(self, scale=(0.0, 10.0), relative_drift=(0.0, 1e3), time_s=(1e-3, 1e9), scale_time_s=(1e-3, 1e9))
        if self.drift is not None and not all(0.0 <= value <= 1e6 for value in self.drift):
            raise VaporTrackError(f"drift is {self.drift}, expected each axis between 0 and 10⁶")


def covariance_factor(covariance: Float64[np.ndarray, "6 6"]) -> Float64[np.ndarray, "6 6"]:
    """A matrix F with F Fᵀ = covariance; a singular covariance is fine.

    Raises:
        VaporTrackError: the covariance is not 6 × 6, not finite, not symmetric, or has a negative eigenvalue.
    """
    if covariance.shape != (6, 6):
        raise VaporTrackError(f"odometry covariance has shape {covariance.shape}, expected (6, 6)")
    if not np.isfinite(covariance).all():
        raise VaporTrackError(f"odometry covariance is not finite: {covariance.tolist()}")
    scale = max(float(np.abs(covariance).max()), 1e-300)
    if np.abs(covariance - covariance.T).max() > 1e-6 * scale:
        raise VaporTrackError(f"odometry covariance is not symmetric: {covariance.tolist()}")
    eigenvalues, eigenvectors = np.linalg.eigh((covariance + covariance.T) / 2)
    if eigenvalues[0] < -1e-9 * scale:
        raise VaporTrackError(
            f"odometry covariance has the negative eigenvalue {eigenvalues[0]:.3g}, expected positive semidefinite"
        )
    return eigenvectors * np.sqrt(np.clip(eigenvalues, 0.0, None))
