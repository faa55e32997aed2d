"""What the filter believes -> an MCAP file that Foxglove and RViz show."""

from __future__ import annotations

from collections.abc import Sequence

from filtering.se3 import Poses
from sequences.recordings.estimate_messages import Believed, estimate_messages
from sequences.recordings.mcap_writer import MAP_FRAME, MessageWriter, ros_poses, ros_transform

ESTIMATE_FRAME = "camera_estimate"


class EstimateWriter(MessageWriter):
    """Writes what the filter believes, in messages that Foxglove and RViz show; use it in a `with` statement.

    Topics: those of `estimate_messages` under `/estimate`, and `/tf` (map -> camera_estimate).
    """

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
