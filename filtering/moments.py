"""Mean and covariance of weighted poses and of mixtures of Gaussians, and covariances despite rounding."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64, Int64

from filtering.errors import VaporTrackError
from filtering.se3 import Poses
from filtering.so3 import nearest_rotation

_ROUNDING = 1e-12  # of a variance: a thousand times the error of double precision in a product


def settle(covariance: Float64[np.ndarray, "*n d d"], before: Float64[np.ndarray, "*n d"] | None = None) -> None:
    """Make covariances, in place, symmetric and positive definite despite rounding.

    Each variance grows by the most that rounding may have taken. Otherwise rounding errors of a large variance, after a
    leap of the odometry or a long gap, make small ones negative.

    Args:
        covariance: As computed, positive semidefinite but for rounding.
        before: Variances before a correction whose rounding is of the second order in them (Joseph's form).
    """
    covariance += np.swapaxes(covariance, -1, -2)
    covariance *= 0.5
    variances = np.einsum("...ii->...i", covariance)  # a view
    variances *= 1.0 + _ROUNDING
    if before is not None:
        variances += _ROUNDING**2 * before


def require_sound(poses: Poses, covariances: Float64[np.ndarray, "*n 6 6"] | None = None) -> None:
    """Check poses and covariances before they are written or published.

    Args:
        poses: Any batch.
        covariances: Of the poses; None for poses alone.

    Raises:
        VaporTrackError: a pose or covariance is not finite, or a covariance not positive definite.
    """
    if not poses.is_finite().all():
        number = int((~poses.is_finite()).sum())
        raise VaporTrackError(f"{number} of {poses.is_finite().size} poses to write are not finite, expected none")
    if covariances is None:
        return
    if not np.isfinite(covariances).all():
        raise VaporTrackError(f"covariance to write is not finite: {covariances.tolist()}")
    least = float(np.linalg.eigvalsh(covariances).min())
    if least <= 0.0:
        raise VaporTrackError(f"covariance to write has the eigenvalue {least:.3g}, expected positive ones")


def group_moments(
    poses: Poses, weights: Float64[np.ndarray, " n"], label: Int64[np.ndarray, " n"], num_groups: int
) -> tuple[Poses, Float64[np.ndarray, "k 6 6"], Float64[np.ndarray, "n 6"]]:
    """Means and covariances of groups of poses on SE(3).

    Args:
        poses: Batch (n,).
        weights: At least 0, (n,). A group whose weights are all 0 counts its poses equally.
        label: Group of every pose, 0 to k − 1, (n,).
        num_groups: k; every group has at least one pose.

    Returns:
        The mean of every group (k,), arithmetic in translation and chordal in rotation; the covariance of every group
        in the tangent at its mean, of ξ = (v, ω), metres and radians; and the tangent of every pose at its
        group's mean.
    """
    fractions = np.zeros((num_groups, len(label)))
    fractions[label, np.arange(len(label))] = weights
    weightless = fractions.sum(axis=1) <= 0.0
    if weightless.any():
        fractions[weightless] = label == np.flatnonzero(weightless)[:, None]
    fractions /= fractions.sum(axis=1, keepdims=True)
    mean_matrix = (fractions @ poses.rotation.reshape(-1, 9)).reshape(-1, 3, 3)
    means = Poses(nearest_rotation(mean_matrix), fractions @ poses.translation)
    tangent = means[label].between(poses).log()
    covariances = (fractions[:, None, :] * tangent.T) @ tangent
    return means, covariances, tangent


def mixture_moments(
    weights: Float64[np.ndarray, " n"],
    means: Float64[np.ndarray, "n d"],
    covariances: Float64[np.ndarray, "n d d"],
    starts: Int64[np.ndarray, " k"],
) -> tuple[Float64[np.ndarray, " k"], Float64[np.ndarray, "k d"], Float64[np.ndarray, "k d d"]]:
    """Weights, means and covariances of mixtures of Gaussians, the components of each one after the other.

    Args:
        weights: At least 0, (n,). A mixture whose weights are all 0 counts its components equally.
        means: Of the components, (n, d).
        covariances: Of the components, (n, d, d).
        starts: First component of every mixture, increasing from 0, (k,).
    """
    count = len(weights)
    mixture = np.bincount(starts, minlength=count).cumsum() - 1  # of each component
    totals = np.add.reduceat(weights, starts)
    none = totals <= 0.0
    weights = np.where(none[mixture], 1.0, weights)
    fractions = (weights / np.add.reduceat(weights, starts)[mixture])[:, None]
    middle = np.add.reduceat(fractions * means, starts)
    residual = means - middle[mixture]
    spread = residual[:, :, None] * residual[:, None, :]
    spread += covariances
    spread *= fractions[:, :, None]
    return totals, middle, np.add.reduceat(spread, starts)
