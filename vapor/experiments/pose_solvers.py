"""Robust solvers of camera poses that could take the place of PoseLib's."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

import cv2
import numpy as np
from jaxtyping import Float64

from filtering.se3 import Poses
from sequences.frame import Camera
from vapor.landmarks.pose_solver import INLIER_PX, LEAST_SUPPORT, MOST_TRIES, PoseSolver, lo_ransac

_CONFIDENCE = 0.9999  # PoseLib's


def _opencv(method: int) -> PoseSolver:
    """OpenCV's RANSAC by one of its methods, and the refinement of Levenberg and Marquardt by those that agree."""

    def solved(pixels: Float64[np.ndarray, "n 2"], points: Float64[np.ndarray, "n 3"], camera: Camera) -> Poses | None:
        intrinsics = np.array([[camera.fx, 0.0, camera.cx], [0.0, camera.fy, camera.cy], [0.0, 0.0, 1.0]])
        try:
            found, turned, moved, inliers = cv2.solvePnPRansac(
                points,
                pixels,
                intrinsics,
                None,
                iterationsCount=MOST_TRIES,
                reprojectionError=INLIER_PX,
                confidence=_CONFIDENCE,
                flags=method,
            )
            if not found or inliers is None or len(inliers) < LEAST_SUPPORT:
                return None
            agree = np.asarray(inliers, np.int64).ravel()
            turned, moved = cv2.solvePnPRefineLM(points[agree], pixels[agree], intrinsics, None, turned, moved)
        except cv2.error:  # it refuses what tells no pose
            return None
        pose = Poses(np.asarray(cv2.Rodrigues(turned)[0], np.float64), np.asarray(moved, np.float64).ravel())
        return pose.orthonormal() if np.isfinite(pose.translation).all() and np.isfinite(pose.rotation).all() else None

    return solved


POSELIB = "poselib"

SOLVERS: Mapping[str, PoseSolver] = MappingProxyType(
    {
        POSELIB: lo_ransac,
        "opencv-ap3p": _opencv(cv2.SOLVEPNP_AP3P),
        "opencv-magsac": _opencv(cv2.USAC_MAGSAC),
    }
)
"""By name."""
