"""How the camera moved between two images, and how uncertain that is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from filtering.errors import VaporTrackError, require_within
from filtering.se3 import Poses

_RIGID = 1e-6  # of RRᵀ − I: float32 passes. Particles compose every increment and are never made orthonormal again


@dataclass(frozen=True)
class Odometry:
    """Relative motion of the camera from one image to the next.

    Attributes:
        previous_from_current: One pose: the camera now, in the camera frame at the previous image.
        covariance: Covariance of ξ = (v, ω) in metres and radians, where the true motion is
            `previous_from_current @ Poses.exp(ξ)`; symmetric, positive semidefinite, in the current camera frame.
    """

    previous_from_current: Poses
    covariance: Float64[np.ndarray, "6 6"]


def require_odometry(odometry: Odometry) -> None:
    """Check that odometry is one rigid motion with a covariance. However far it goes is its covariance's affair.

    Raises:
        VaporTrackError: the motion is not one pose, not finite or not rigid, or as `covariance_factor`.
    """
    motion = odometry.previous_from_current
    if motion.batch_shape != ():
        raise VaporTrackError(f"odometry increment has batch shape {motion.batch_shape}, expected (): one pose")
    if not motion.is_finite():
        raise VaporTrackError(f"odometry increment is not finite: {motion.as_matrix()[:3].tolist()}")
    rotation = motion.rotation
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > _RIGID or np.linalg.det(rotation) < 0:
        raise VaporTrackError(
            f"odometry increment has {rotation.tolist()} for a rotation, expected orthonormal columns (to {_RIGID:g}) "
            "and determinant 1"
        )
    covariance_factor(odometry.covariance)


@dataclass(frozen=True)
class MotionNoise:
    """Stated noise of odometry whose messages carry no covariance (Thrun et al. 2005, §5.4, in three dimensions).

    Standard deviations of an increment grow in proportion to what it moved, above a floor that grows with the
    square root of time.
    """

    translation_per_m: float = 0.05
    """Metres of error per metre moved."""
    translation_per_rad: float = 0.02
    """Metres of error per radian turned."""
    rotation_per_m: float = 0.02
    """Radians of error per metre moved."""
    rotation_per_rad: float = 0.05
    """Radians of error per radian turned."""
    translation_per_sqrt_s: float = 0.01
    """Metres of error after one second at rest."""
    rotation_per_sqrt_s: float = 0.01
    """Radians of error after one second at rest."""

    def __post_init__(self) -> None:
        require_within(
            self,
            translation_per_m=(0.0, 1e3),
            translation_per_rad=(0.0, 1e3),
            rotation_per_m=(0.0, 1e3),
            rotation_per_rad=(0.0, 1e3),
            translation_per_sqrt_s=(0.0, 1e3),
            rotation_per_sqrt_s=(0.0, 1e3),
        )

    def covariance(self, previous_from_current: Poses, duration_s: float) -> Float64[np.ndarray, "6 6"]:
        """Covariance of one increment, in the tangent at the current frame.

        Args:
            previous_from_current: One pose, the increment.
            duration_s: Seconds it took.
        """
        tangent = previous_from_current.log()
        moved_m, turned_rad = float(np.linalg.norm(tangent[:3])), float(np.linalg.norm(tangent[3:]))
        variance_t = (
            (self.translation_per_m * moved_m) ** 2
            + (self.translation_per_rad * turned_rad) ** 2
            + self.translation_per_sqrt_s**2 * duration_s
        )
        variance_r = (
            (self.rotation_per_m * moved_m) ** 2
            + (self.rotation_per_rad * turned_rad) ** 2
            + self.rotation_per_sqrt_s**2 * duration_s
        )
        return np.diag([variance_t] * 3 + [variance_r] * 3)


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


def isotropic_std(covariance: Float64[np.ndarray, "6 6"], least_std: tuple[float, float]) -> tuple[float, float]:
    """Standard deviations (metres, radians) of the isotropic noise that covers a covariance and adds a least noise.

    Args:
        covariance: Of ξ = (v, ω).
        least_std: Noise added in quadrature, metres and radians.

    Raises:
        VaporTrackError: as `covariance_factor`.
    """
    factor = covariance_factor(covariance)
    translation_m = np.linalg.norm(factor[:3], 2)
    rotation_rad = np.linalg.norm(factor[3:], 2)
    return float(np.hypot(translation_m, least_std[0])), float(np.hypot(rotation_rad, least_std[1]))
