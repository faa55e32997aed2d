"""What the filter believes -> an MCAP file that Foxglove and RViz show."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float64

from filtering.se3 import Poses
from sequences.recordings.mcap_writer import (
    MAP_FRAME,
    MessageWriter,
    ros_header,
    ros_poses,
    ros_transform,
)
from sequences.recordings.messages import covariance_to_ros

ESTIMATE_FRAME = "camera_estimate"
_MAX_PARTICLES = 500
_ARROW_M = 0.5  # length of the arrow of a mode, along its optical axis
_MARKER_ARROW, _MARKER_DELETE_ALL = 0, 3
_NO_TURN = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)  # an arrow's points are in the map


class EstimateWriter(MessageWriter):
    """Writes what the filter believes, in messages that Foxglove and RViz show; use it in a `with` statement.

    Topics: `/estimate/pose` (best mode, PoseWithCovarianceStamped), `/estimate/modes` (MarkerArray: an arrow along each
    mode's optical axis, its opacity the weight), `/estimate/particles` (PoseArray, thinned), `/tf` (map ->
    camera_estimate). Poses are of the camera's optical frame: z is where it looks.
    """

    def __enter__(self) -> EstimateWriter:
        self._open()
        return self

    def write(
        self,
        time_ns: int,
        modes: Sequence[tuple[Poses, Float64[np.ndarray, "6 6"], float]],
        particles: Poses,
    ) -> None:
        """Write the belief after one image.

        Args:
            time_ns: Stamp of the image.
            modes: world_from_camera, covariance in the tangent at it (camera frame) and weight in [0, 1], best first.
            particles: world_from_camera, batch (n,); thinned evenly to at most 500.
        """
        header = ros_header(time_ns, MAP_FRAME)
        if len(particles) > _MAX_PARTICLES:
            particles = particles[np.linspace(0, len(particles) - 1, _MAX_PARTICLES).astype(int)]
        best = Poses.stack([modes[0][0]]) if modes else Poses.identity(0)
        poses = ros_poses(Poses.concatenate([best, particles]), known_valid=True)
        if modes:
            pose, covariance, _ = modes[0]
            told = {"pose": poses[0], "covariance": covariance_to_ros(covariance, pose)}
            message = {"header": header, "pose": told}
            self._write("/estimate/pose", "geometry_msgs/PoseWithCovarianceStamped", message, time_ns)
            transform = ros_transform(time_ns, MAP_FRAME, ESTIMATE_FRAME, poses[0])
            self._write("/tf", "tf2_msgs/TFMessage", {"transforms": [transform]}, time_ns)
        markers = [{"header": header, "ns": "modes", "action": _MARKER_DELETE_ALL}]
        markers += [_arrow(header, rank, pose, weight) for rank, (pose, _, weight) in enumerate(modes)]
        self._write("/estimate/modes", "visualization_msgs/MarkerArray", {"markers": markers}, time_ns)
        cloud = {"header": header, "poses": poses[len(best) :]}
        self._write("/estimate/particles", "geometry_msgs/PoseArray", cloud, time_ns)


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
