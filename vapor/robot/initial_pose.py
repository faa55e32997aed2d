"""/initialpose, as RViz sends it -> where the camera is said to be."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
from jaxtyping import Float64

from filtering.errors import VaporTrackError
from filtering.se3 import Poses
from sequences.recordings.messages import covariance_from_ros, pose_from_message

_LEAST_M, _LEAST_RAD = 0.02, 0.02  # nobody points more exactly
_LEVEL_RAD = 0.1  # of a robot on a floor that is not quite even
_OF_PRIOR_M = 0.5
_MOST_VARIANCE = 1e8


def camera_of_initial_pose(
    message: SimpleNamespace, base_from_camera: Poses, prior_poses: Poses
) -> tuple[Poses, Float64[np.ndarray, "6 6"]]:
    """Pose of the camera, one pose, and its covariance in the tangent at it.

    RViz's "2D Pose Estimate" states x, y and the heading; its height of zero, and its roll and pitch, have a variance
    of zero. Where the height has, any is possible at which the model's training images were taken; the robot is level.

    Args:
        message: Fields of geometry_msgs/PoseWithCovarianceStamped, of the base.
        base_from_camera: Extrinsics, one pose.
        prior_poses: Of training images, batch (n,), see `ModelDescription`.

    Raises:
        VaporTrackError: it has no pose, or its covariance is none.
    """
    base = pose_from_message(message.pose.pose)
    stated = np.array(message.pose.covariance, np.float64).reshape(6, 6)
    if not (np.abs(stated) <= _MOST_VARIANCE).all():  # NaN compares as false
        raise VaporTrackError(
            f"covariance is not finite or above {_MOST_VARIANCE:g}, expected one of metres and radians"
        )
    stated = (stated + stated.T) / 2
    if (lowest := float(np.linalg.eigvalsh(stated)[0])) < -1e-9 * np.abs(stated).max():
        raise VaporTrackError(f"covariance has the negative eigenvalue {lowest:.3g}")
    least = np.array([_LEAST_M, _LEAST_M, _LEAST_M, _LEVEL_RAD, _LEVEL_RAD, _LEAST_RAD])
    if stated[2, 2] == 0.0:
        heights_m = (prior_poses @ base_from_camera.inverse()).translation[:, 2]
        base = Poses(base.rotation, np.array([*base.translation[:2], float(heights_m.mean())]))
        least[2] = max(float(heights_m.std()), _OF_PRIOR_M)
    diagonal = np.arange(6)
    floor = np.where(stated[diagonal, diagonal] == 0.0, least, [_LEAST_M] * 3 + [_LEAST_RAD] * 3)
    stated[diagonal, diagonal] += floor**2  # which makes any covariance definite
    carry = base_from_camera.inverse().adjoint()
    covariance = carry @ covariance_from_ros(stated, base) @ carry.T
    return base @ base_from_camera, (covariance + covariance.T) / 2
