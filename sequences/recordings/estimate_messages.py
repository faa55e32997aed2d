"""The filter's belief -> messages for Foxglove and RViz, and an MCAP file of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float64, Int64

from filtering.moments import require_sound, settle
from filtering.se3 import Poses
from sequences.recordings.mcap_writer import MAP_FRAME, MessageWriter, ros_header, ros_poses, ros_transform
from sequences.recordings.messages import covariance_to_ros

_ARROW_M = 0.5  # length of the arrow of a mode, along its optical axis
_MARKER_ARROW, _MARKER_DELETE_ALL = 0, 3
_LEAST_EIGENVALUE = 1e-14  # of the largest: the resolution of double precision
_NO_TURN = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)  # an arrow's points are in the map

Believed = tuple[Poses, Float64[np.ndarray, "6 6"], float]
"""A mode: world_from_camera, covariance in the tangent at it (camera frame), and weight in [0, 1]."""


class Message(NamedTuple):
    """A message to write or to send: topic, type and fields, as `message_definitions.encoder` takes them."""

    topic: str
    type: str
    fields: dict[str, Any]


def estimate_messages(
    time_ns: int, modes: Sequence[Believed], particles: Poses, *, under: str = "/estimate", frame: str = MAP_FRAME
) -> list[Message]:
    """The belief after one image, as messages in the map or another frame; poses are of the optical frame.

    Topics: `pose` (best mode, PoseWithCovarianceStamped; none without modes), `modes` (MarkerArray: an arrow along each
    mode's optical axis, its opacity the weight), `particles` (PoseArray). Modes come best first; particles are
    world_from_camera, (n,). Raises VaporTrackError where a pose or covariance is not sound.
    """
    header = ros_header(time_ns, frame)
    require_sound(Poses.concatenate([particles, *(Poses.stack([pose]) for pose, _, _ in modes)]))
    poses = ros_poses(particles, known_valid=True)  # the check takes nine times as long
    markers = [{"header": header, "ns": "modes", "action": _MARKER_DELETE_ALL}]
    markers += [_arrow(header, rank, pose, weight) for rank, (pose, _, weight) in enumerate(modes)]
    messages = [
        Message(f"{under}/modes", "visualization_msgs/MarkerArray", {"markers": markers}),
        Message(f"{under}/particles", "geometry_msgs/PoseArray", {"header": header, "poses": poses}),
    ]
    if modes:
        pose = {"header": header, "pose": pose_with_covariance(modes[0][0], modes[0][1])}
        messages.insert(0, Message(f"{under}/pose", "geometry_msgs/PoseWithCovarianceStamped", pose))
    return messages


def pose_with_covariance(pose: Poses, covariance: Float64[np.ndarray, "6 6"]) -> dict[str, Any]:
    """geometry_msgs/PoseWithCovariance of one pose, with the covariance in the tangent at it.

    A covariance whose eigenvalues differ by more than double precision resolves is widened until they do not. Raises
    VaporTrackError where either is not finite, or the covariance not positive definite.
    """
    with np.errstate(invalid="ignore"):  # require_sound reports it
        ros_covariance = covariance_to_ros(covariance, pose)
    settle(ros_covariance)
    ros_covariance += _LEAST_EIGENVALUE * np.trace(ros_covariance) * np.eye(6)
    require_sound(pose, ros_covariance)
    return {"pose": ros_poses(pose, known_valid=True), "covariance": ros_covariance}


def _arrow(header: dict, rank: int, world_from_camera: Poses, weight: float) -> dict:
    tip = world_from_camera.apply(np.array([0.0, 0.0, _ARROW_M]))
    return {
        "header": header,
        "ns": "modes",
        "id": rank,
        "type": _MARKER_ARROW,
        "pose": _NO_TURN,
        "points": np.stack([world_from_camera.translation, tip]),
        "scale": (0.1 * _ARROW_M, 0.2 * _ARROW_M, 0.3 * _ARROW_M),
        "color": (1.0, 0.4, 0.0, min(max(weight, 0.0), 1.0)),
        "text": f"{weight:.6g}",
    }


ESTIMATE_FRAME = "camera_estimate"


class EstimateWriter(MessageWriter):
    """Writes `estimate_messages` under `/estimate`, and `/tf` (map -> camera_estimate); used in a `with` statement."""

    def __enter__(self) -> EstimateWriter:
        self._open()
        return self

    def write(self, time_ns: int, modes: Sequence[Believed], particles: Poses) -> None:
        """Write the belief after one image, see `estimate_messages`."""
        for message in estimate_messages(time_ns, modes, particles):
            self._write(*message, time_ns)
        if modes:
            transform = ros_transform(time_ns, MAP_FRAME, ESTIMATE_FRAME, ros_poses(modes[0][0], known_valid=True))
            self._write("/tf", "tf2_msgs/TFMessage", {"transforms": [transform]}, time_ns)

    def write_trajectory(
        self,
        name: str,
        times_ns: Int64[np.ndarray, " n"],
        poses: Poses,
        covariance: Float64[np.ndarray, "n 6 6"],
    ) -> None:
        """Write poses (n,) that were found later, as PoseWithCovarianceStamped under `/estimate/NAME`."""
        for i, time_ns in enumerate(times_ns.tolist()):
            pose = {"header": ros_header(time_ns, MAP_FRAME), "pose": pose_with_covariance(poses[i], covariance[i])}
            self._write(f"/estimate/{name}", "geometry_msgs/PoseWithCovarianceStamped", pose, time_ns)
