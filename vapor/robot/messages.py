"""What a robot gets told: its pose, tf, diagnostics."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float64

from filtering.estimate import Estimate, Status
from filtering.floors import Floors
from filtering.se3 import Poses
from sequences.recordings.estimate_messages import Message, pose_with_covariance
from sequences.recordings.mcap_writer import ros_header, ros_poses, ros_transform

_OK, _WARN, _ERROR, _STALE = 0, 1, 2, 3
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
