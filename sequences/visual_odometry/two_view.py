"""The first two key frames: the motion between them, and depths of their features, in a unit of its own."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import poselib
from jaxtyping import Bool, Float64, Int64

from filtering.se3 import Poses
from sequences.visual_odometry.tracks import KeyFrame, Tracks

_LEAST_FEATURES, _LEAST_INLIERS, _LEAST_IN_FRONT = 30, 0.7, 0.6
_LEAST_PARALLAX = 0.5  # of the pixels after which there is a key frame
_RANSAC = {"max_epipolar_error": 1.0, "max_iterations": 1000, "min_iterations": 100, "seed": 0}
_REFINEMENT = {"loss_type": "CAUCHY", "loss_scale": 0.5}
_PIXEL = 0.5  # standard deviation
_UNKNOWN = 0.7  # standard deviation of an unknown inverse depth, over its mean


@dataclass(frozen=True)
class TwoViews:
    """What two images say.

    Attributes:
        tracks: Those of the first key frame that fit, with their depths.
        pose: camera_from_map of the second image, one pose.
    """

    tracks: Tracks
    pose: Poses


def initialize(
    tracks: Tracks,
    first: KeyFrame,
    focal: Float64[np.ndarray, " 2"],
    centre: Float64[np.ndarray, " 2"],
    usual_inverse_depth: float,
    parallax_px: float,
) -> TwoViews | None:
    """The second pose and the depths of features by the essential matrix; None where the images do not determine them.

    The unit is that in which the median feature has the usual depth.

    Args:
        tracks: Features of the latest image.
        first: The only key frame.
        focal: Focal lengths, pixels.
        centre: Principal point, pixels.
        usual_inverse_depth: Of the median feature.
        parallax_px: Motion of features after which there is a key frame, pixels.

    Source: Nister, "An efficient solution to the five-point relative pose problem", PAMI 2004 (PoseLib's).
    """
    _, of_first, of_tracks = np.intersect1d(first.ids, tracks.ids, return_indices=True)
    if len(of_first) < _LEAST_FEATURES:
        return None
    before, after = first.pixels[of_first].astype(np.float64), tracks.pixels[of_tracks].astype(np.float64)
    camera = {"model": "PINHOLE", "width": 1, "height": 1, "params": [*focal, *centre]}
    found, details = poselib.estimate_relative_pose(before, after, camera, camera, _RANSAC, _REFINEMENT)
    fits = np.array(details["inliers"], bool)
    direction = np.asarray(found.t) / max(float(np.linalg.norm(found.t)), 1e-300)
    rays = [np.column_stack([(pixels - centre) / focal, np.ones(len(pixels))]) for pixels in (before, after)]
    turned = rays[0] @ np.asarray(found.R).T
    if not fits.any() or fits.mean() < _LEAST_INLIERS:
        return None
    flow = np.linalg.norm((turned[:, :2] / turned[:, 2:] - rays[1][:, :2]) * focal, axis=1)
    if np.median(flow[fits]) < _LEAST_PARALLAX * parallax_px:
        return None
    return _with_depths(
        tracks,
        of_tracks,
        Poses(np.asarray(found.R), direction),
        first,
        rays[1],
        turned,
        fits,
        focal,
        usual_inverse_depth,
    )


def _with_depths(
    tracks: Tracks,
    which: Int64[np.ndarray, " n"],
    motion: Poses,
    first: KeyFrame,
    rays: Float64[np.ndarray, "n 3"],
    turned: Float64[np.ndarray, "n 3"],
    fits: Bool[np.ndarray, " n"],
    focal: Float64[np.ndarray, " 2"],
    usual: float,
) -> TwoViews | None:
    """Triangulate: rays × (turned + ρ t) = 0."""
    across, along = np.cross(rays, motion.translation), np.cross(rays, turned)
    lever = np.maximum(np.vecdot(across, across), 1e-12)
    inverse_depth = -np.vecdot(across, along) / lever
    good = fits & (inverse_depth > 0.0)
    if good.mean() < _LEAST_IN_FRONT:
        return None
    unit = float(np.median(inverse_depth[good])) / usual
    std = _PIXEL / (focal[0] * np.sqrt(lever) * unit)
    unknown = (_UNKNOWN * usual) ** 2
    depths, variances = tracks.inverse_depth.copy(), tracks.variance.copy()
    depths[which] = np.where(good, inverse_depth / unit, usual)
    variances[which] = np.where(good, std**2, unknown)
    kept = np.zeros(len(tracks), bool)
    kept[which[good]] = True
    pose = Poses(motion.rotation, unit * motion.translation) @ first.pose
    return TwoViews(replace(tracks, inverse_depth=depths, variance=variances)[kept], pose)
