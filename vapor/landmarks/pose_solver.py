"""Matches of pixels and points, many of them wrong -> the pose of the camera.

Source: Larsson et al., PoseLib (P3P in locally optimised RANSAC).
"""

from __future__ import annotations

import numpy as np
import poselib
from jaxtyping import Float64

from filtering.se3 import Poses
from sequences.frame import Camera

INLIER_PX = 3.0
"""Matches whose point is seen within so many pixels agree with a pose."""
ROBUST_PX = 1.0
"""Scale of the robust (Cauchy) cost of refinements, pixels."""
_LEAST_SUPPORT = 8  # matches that must agree with a pose
_TRIES = {"max_reproj_error": INLIER_PX, "max_iterations": 1000, "min_iterations": 50, "seed": 0}
_LOSS = {"loss_type": "CAUCHY", "loss_scale": ROBUST_PX}


def lo_ransac(pixels: Float64[np.ndarray, "n 2"], points: Float64[np.ndarray, "n 3"], camera: Camera) -> Poses | None:
    """The pose that most matches agree with, by PoseLib; None where hardly any do.

    Args:
        pixels: Where an image shows something, undistorted.
        points: What each is matched with, metres.
        camera: That took the image, without distortion.

    Returns:
        camera_from_world.
    """
    pinhole = {
        "model": "PINHOLE",
        "width": camera.width,
        "height": camera.height,
        "params": [camera.fx, camera.fy, camera.cx, camera.cy],
    }
    pose, said = poselib.estimate_absolute_pose(pixels, points, pinhole, _TRIES, _LOSS)
    if said["num_inliers"] < _LEAST_SUPPORT:
        return None
    return Poses(np.asarray(pose.R, np.float64), np.asarray(pose.t, np.float64)).orthonormal()
