"""The pose of a camera by its features, whose depths are uncertain: robust least squares, and its covariance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int64

from filtering.se3 import Poses
from filtering.so3 import skew
from sequences.visual_odometry.tracks import LEAST_DEPTH, KeyFrame, Tracks, pixel_jacobian, project

_ITERATIONS, _AT_LEAST, _CONVERGED = 10, 3, 1e-4
_FIRST_SCALE, _SCALE_FALLS, _SCALE = 5.0, 0.7, 2.0  # of the robust weights, standard deviations
_MEDIAN = 1.39  # of a squared distance with two degrees of freedom
_FITS, _CUT = 2.0, 9.0  # times the usual mean of squared distances, each cut there: no other start is tried
_OUTLIER = 25.0  # squared distance, over that of the median feature
_CELLS = (4, 3)  # of the image, whose features are left out in turn
_LEFT_OUT = 0.9  # of their information


@dataclass(frozen=True)
class MotionPrior:
    """Gaussian over the pose.

    Attributes:
        pose: Its mean, camera_from_map, one pose.
        std: Standard deviation of ξ = (v, ω) where the true pose is exp(ξ) times the mean, (6,).
    """

    pose: Poses
    std: Float64[np.ndarray, " 6"]


@dataclass(frozen=True)
class Alignment:
    """The pose of a camera, n features.

    Attributes:
        pose: camera_from_map, one pose.
        covariance: Of ξ where the true pose is exp(ξ) times it, (6, 6).
        fits: Whether each feature is where it should be, (n,).
        cost: Mean of the squared distances of the features from where they should be, each 9 at most.
    """

    pose: Poses
    covariance: Float64[np.ndarray, "6 6"]
    fits: Bool[np.ndarray, " n"]
    cost: float


@dataclass(frozen=True)
class _Fit:
    pose: Poses
    squared: Float64[np.ndarray, " n"]
    information: Float64[np.ndarray, "n 6 6"]
    gradient: Float64[np.ndarray, "n 6"]

    @property
    def cost(self) -> float:
        return float(np.minimum(self.squared, _CUT).mean())


def align(
    tracks: Tracks,
    key_frames: Sequence[KeyFrame],
    starts: Sequence[Poses],
    prior: MotionPrior,
    focal: Float64[np.ndarray, " 2"],
    centre: Float64[np.ndarray, " 2"],
    size: Int64[np.ndarray, " 2"],
    usual_cost: float,
) -> Alignment:
    """Find the pose at which the features are where they were tracked to.

    A feature's depth is uncertain, which spreads its prediction along its epipolar line: so one whose depth is unknown
    still says how the camera turned, and in which direction it moved.

    Args:
        tracks: The features.
        key_frames: Their anchors.
        starts: Poses from which the search starts, the second one where the first does not lead to a fit.
        prior: Of the pose.
        focal: Focal lengths, pixels.
        centre: Principal point, pixels.
        size: Of the image, width and height, pixels.
        usual_cost: Of the images before.
    """
    fits = []
    for start in starts:
        fits.append(_fit(tracks, key_frames, start, prior, focal, centre))
        if fits[-1].cost < _FITS * usual_cost:
            break
    fit = min(fits, key=lambda each: each.cost)
    usual = max(float(np.median(fit.squared)) / _MEDIAN, 1.0)
    information = fit.information.sum(axis=0) + np.diag(1.0 / np.square(prior.std))
    covariance = usual * np.linalg.inv(information) + _left_out(fit, information, tracks, size)
    return Alignment(fit.pose, covariance, fit.squared < _OUTLIER * usual, fit.cost)


def _fit(
    tracks: Tracks,
    key_frames: Sequence[KeyFrame],
    pose: Poses,
    prior: MotionPrior,
    focal: Float64[np.ndarray, " 2"],
    centre: Float64[np.ndarray, " 2"],
) -> _Fit:
    """Gauss and Newton from a pose, with weights that grow strict."""
    robust, expected = _FIRST_SCALE, np.diag(1.0 / np.square(prior.std))
    fit = _linearized(tracks, key_frames, pose, robust, focal, centre)
    for iteration in range(_ITERATIONS):
        information, off = fit.information.sum(axis=0) + expected, (fit.pose @ prior.pose.inverse()).log()
        change = -np.linalg.solve(information, fit.gradient.sum(axis=0) + expected @ off)
        robust = max(_SCALE, _SCALE_FALLS * robust)
        moved = (Poses.exp(change) @ fit.pose).orthonormal()
        fit = _linearized(tracks, key_frames, moved, robust, focal, centre)
        if iteration > _AT_LEAST and np.abs(change).max() < _CONVERGED:
            break
    return fit


def _linearized(
    tracks: Tracks,
    key_frames: Sequence[KeyFrame],
    pose: Poses,
    robust: float,
    focal: Float64[np.ndarray, " 2"],
    centre: Float64[np.ndarray, " 2"],
) -> _Fit:
    """How far the features are from where they should be at a pose, and what that says of the pose."""
    seen = project(tracks, pose, key_frames)
    projects = pixel_jacobian(seen.points, focal)
    depth = np.maximum(seen.points[:, 2], LEAST_DEPTH)
    residual = seen.points[:, :2] / depth[:, None] * focal + centre - tracks.pixels
    by_depth = (projects @ seen.translation[:, :, None])[:, :, 0]
    spread = tracks.variance[:, None, None] * by_depth[:, :, None] * by_depth[:, None, :]
    weight = np.linalg.inv(tracks.covariance + spread)
    squared = np.einsum("ni,nij,nj->n", residual, weight, residual)
    trust = 1.0 / np.square(1.0 + squared / robust**2)
    trust[seen.points[:, 2] < LEAST_DEPTH] = 0.0
    jacobian = np.concatenate([projects * tracks.inverse_depth[:, None, None], -projects @ skew(seen.points)], axis=2)
    weighted = (trust[:, None, None] * weight) @ jacobian
    information = np.swapaxes(jacobian, 1, 2) @ weighted
    gradient = (np.swapaxes(weighted, 1, 2) @ residual[:, :, None])[:, :, 0]
    return _Fit(pose, squared, information, gradient)


def _left_out(
    fit: _Fit, information: Float64[np.ndarray, "6 6"], tracks: Tracks, size: Int64[np.ndarray, " 2"]
) -> Float64[np.ndarray, "6 6"]:
    """Jackknife covariance: how the pose changes where the features of a part of the image are left out.

    Features of one part err together, as on something that moves, which their own covariances do not say.

    Source: Efron and Tibshirani, "An introduction to the bootstrap", 1993, chapter 11.
    """
    columns, rows = _CELLS
    column, row = np.clip(tracks.pixels / size * _CELLS, 0, (columns - 1, rows - 1)).astype(int).T
    cell, count = column + columns * row, columns * rows
    of_cell, gradient = np.zeros((count, 6, 6)), np.zeros((count, 6))
    np.add.at(of_cell, cell, fit.information)
    np.add.at(gradient, cell, fit.gradient)
    used = np.bincount(cell, minlength=count) > 0
    rest = information - _LEFT_OUT * of_cell[used]
    change = np.linalg.solve(rest, _LEFT_OUT * gradient[used][:, :, None])[:, :, 0]
    change -= change.mean(axis=0)
    return (len(change) - 1) / len(change) * change.T @ change
