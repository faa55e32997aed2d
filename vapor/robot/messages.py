"""ROS messages of live localization: pose, tf and diagnostics, which it publishes, and /initialpose, which it hears."""

from __future__ import annotations

from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any

import numpy as np
from jaxtyping import Float64

from filtering.errors import VaporTrackError
from filtering.estimate import Estimate, Status
from filtering.floors import Floors
from filtering.se3 import Poses
from sequences.recordings.estimate_messages import Message, pose_with_covariance
from sequences.recordings.mcap_writer import ros_header, ros_poses, ros_transform
from sequences.recordings.messages import covariance_from_ros, pose_from_message

_OK, _WARN, _ERROR, _STALE = 0, 1, 2, 3
_LEAST_M, _LEAST_RAD = 0.02, 0.02  # nobody points more exactly
_LEVEL_RAD = 0.1  # of a robot on a floor that is not quite even
_OF_PRIOR_M = 0.5
_MOST_VARIANCE = 1e8
_LEVELS: Mapping[Status, int] = {"converged": _OK, "ambiguous": _WARN, "lost": _ERROR}


def pose_message(topic: str, frame: str, time_ns: int, pose: Poses, covariance: Float64[np.ndarray, "6 6"]) -> Message:
    """geometry_msgs/PoseWithCovarianceStamped of one pose, and its covariance in the tangent at it."""
    fields = {"header": ros_header(time_ns, frame), "pose": pose_with_covariance(pose, covariance)}
    return Message(topic, "geometry_msgs/PoseWithCovarianceStamped", fields)


def tf_message(time_ns: int, parent: str, child: str, parent_from_child: Poses) -> Message:
    """tf2_msgs/TFMessage of one pose."""
    transform = ros_transform(time_ns, parent, child, ros_poses(parent_from_child))
    return Message("/tf", "tf2_msgs/TFMessage", {"transforms": [transform]})


def diagnostics_message(
    time_ns: int,
    *,
    hardware: str,
    estimate: Estimate | None,
    silent: str | None,
    values: Mapping[str, object],
    floors: Floors | None = None,
) -> Message:
    """diagnostic_msgs/DiagnosticArray: level OK for converged, WARN for ambiguous, ERROR for lost, STALE for silence.

    Args:
        time_ns: Its stamp.
        hardware: What is diagnosed.
        estimate: The belief of now; None before the first.
        silent: What does not come, in words; None where everything does.
        values: What else to say, by name.
        floors: Of the building, where there are several: which one the belief is on, and how much of it on each.
    """
    if estimate is None:
        level, said, about = _STALE, silent or "no image was localized yet", {}
    else:
        best = estimate.modes[0]
        level = _LEVELS[estimate.status] if silent is None else max(_LEVELS[estimate.status], _WARN)
        said = estimate.status if silent is None else f"{estimate.status}; {silent}"
        about: dict[str, Any] = {
            "status": estimate.status,
            "weight of the best mode": f"{best.weight:.4f}",
            "modes": len(estimate.modes),
            "standard deviation, m": f"{best.widest_std_m:.4f}",
            "agreement of the images": f"{estimate.agreement:.4f}",
            "unfamiliarity of the image": f"{estimate.unfamiliarity:.4f}",
        }
        if floors is not None:
            on_floors = floors.belief(estimate)
            about["floor"] = int(on_floors.argmax())
            about |= {f"weight of floor {number}": f"{weight:.4f}" for number, weight in enumerate(on_floors)}
    told = {
        "level": level,
        "name": "vapor-track: localization",
        "message": said,
        "hardware_id": hardware,
        "values": [{"key": key, "value": str(value)} for key, value in {**about, **values}.items()],
    }
    fields = {"header": ros_header(time_ns, ""), "status": [told]}
    return Message("/diagnostics", "diagnostic_msgs/DiagnosticArray", fields)


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
