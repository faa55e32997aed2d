"""MCAP files with ROS 2 messages, complete or not there at all; poses and headers as those have them."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from types import TracebackType

import numpy as np
from mcap_ros2.writer import Writer

from filtering.se3 import Poses
from sequences.atomic import atomic_output
from sequences.recordings.message_definitions import schema_name, schema_text

MAP_FRAME, ODOM_FRAME, BASE_FRAME, CAMERA_FRAME = "map", "odom", "base_link", "camera_optical_frame"


class MessageWriter:
    """A context manager around an MCAP file that appears under its name only when it is complete."""

    def __init__(self, path: Path):
        self.path = Path(path)
        self._stack = ExitStack()
        self._schemas: dict[str, object] = {}

    def _open(self) -> None:
        with ExitStack() as stack:
            partial = stack.enter_context(atomic_output(self.path))
            file = stack.enter_context(open(partial, "wb"))
            self._writer = Writer(file)
            self._stack = stack.pop_all()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if error is None:
            try:
                self._writer.finish()
            except BaseException as failure:  # a full disk, an interruption: the partial file must go
                if not self._stack.__exit__(type(failure), failure, failure.__traceback__):
                    raise
        self._stack.__exit__(kind, error, traceback)

    def _write(self, topic: str, message_type: str, message: dict, time_ns: int) -> None:
        if message_type not in self._schemas:
            text = schema_text(message_type)
            self._schemas[message_type] = self._writer.register_msgdef(schema_name(message_type), text)
        self._writer.write_message(topic, self._schemas[message_type], message, log_time=int(time_ns))  # pyright: ignore[reportArgumentType]


def ros_header(time_ns: int, frame_id: str) -> dict:
    """std_msgs/Header."""
    sec, nanosec = divmod(int(time_ns), 1_000_000_000)
    return {"stamp": {"sec": sec, "nanosec": nanosec}, "frame_id": frame_id}


def ros_xyz(v: np.ndarray) -> dict:
    """geometry_msgs/Vector3 or Point of three numbers."""
    return {"x": v[0], "y": v[1], "z": v[2]}


def ros_pose(pose: Poses) -> dict:
    """geometry_msgs/Pose of one pose."""
    return ros_poses(Poses(pose.rotation[None], pose.translation[None]))[0]


def ros_poses(poses: Poses) -> list[dict]:
    """geometry_msgs/Pose of each of a batch (n,)."""
    rows = zip(poses.translation.tolist(), poses.as_quat_xyzw().tolist(), strict=True)
    return [
        {
            "position": {"x": t[0], "y": t[1], "z": t[2]},
            "orientation": {"x": q[0], "y": q[1], "z": q[2], "w": q[3]},
        }
        for t, q in rows
    ]


def ros_transform(time_ns: int, parent: str, child: str, parent_from_child: Poses) -> dict:
    """geometry_msgs/TransformStamped."""
    pose = ros_pose(parent_from_child)
    return {
        "header": ros_header(time_ns, parent),
        "child_frame_id": child,
        "transform": {"translation": pose["position"], "rotation": pose["orientation"]},
    }
