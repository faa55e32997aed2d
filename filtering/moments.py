"""Mean and covariance of weighted poses, group by group."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64, Int64

from filtering.se3 import Poses, nearest_rotation


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
