"""MCAP files with ROS 2 messages, complete or absent; poses and headers of ROS 2."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from types import TracebackType

import numpy as np
from jaxtyping import Float64
from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap.writer import Writer

from filtering.se3 import Poses
from sequences.atomic import atomic_output
from sequences.recordings.message_definitions import encoder, is_known, schema_name, schema_text
from sequences.recordings.source import RawMessage

MAP_FRAME, ODOM_FRAME, BASE_FRAME, CAMERA_FRAME = "map", "odom", "base_link", "camera_optical_frame"


class MessageChannels:
    """The topics and types of an MCAP file, each registered with its first message."""

    def __init__(self, writer: Writer) -> None:
        self._writer = writer
        self._schemas: dict[str, int] = {}
        self._channels: dict[tuple[str, str], int] = {}

    def write(self, raw: RawMessage) -> None:
        """Write a message unchanged; an unknown type is registered without a definition."""
        key = raw.topic, raw.type
        if key not in self._channels:
            if raw.type not in self._schemas:
                text = schema_text(raw.type) if is_known(raw.type) else ""
                schema = self._writer.register_schema(schema_name(raw.type), SchemaEncoding.ROS2, text.encode())
                self._schemas[raw.type] = schema
            channel = self._writer.register_channel(raw.topic, MessageEncoding.CDR, self._schemas[raw.type])
            self._channels[key] = channel
        self._writer.add_message(self._channels[key], raw.log_time_ns, raw.data, raw.log_time_ns)


class MessageWriter:
    """A context manager around an MCAP file that appears under its name only when it is complete."""

    def __init__(self, path: Path):
        self.path = Path(path)
        self._stack = ExitStack()

    def _open(self) -> None:
        with ExitStack() as stack:
            partial = stack.enter_context(atomic_output(self.path))
            file = stack.enter_context(open(partial, "wb"))
            self._writer = Writer(file)
            self._writer.start(profile="ros2")
            self._channels = MessageChannels(self._writer)
            self._stack = stack.pop_all()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if error is not None:
            self._stack.__exit__(kind, error, traceback)
            return
        with self._stack:  # after a full disk or an interruption, the partial file must go
            self._writer.finish()

    def _write(self, topic: str, message_type: str, message: dict, time_ns: int) -> None:
        data = encoder(message_type)(message)
        self._channels.write(RawMessage(topic, int(time_ns), data, message_type, MessageEncoding.CDR, b""))


def ros_header(time_ns: int, frame_id: str) -> dict:
    """std_msgs/Header."""
    sec, nanosec = divmod(int(time_ns), 1_000_000_000)
    return {"stamp": {"sec": sec, "nanosec": nanosec}, "frame_id": frame_id}


def ros_poses(poses: Poses, *, known_valid: bool = False) -> Float64[np.ndarray, "*batch 7"]:
    """The numbers of geometry_msgs/Pose, and of Transform; `known_valid` as of `Poses.as_quat_xyzw`."""
    return np.concatenate([poses.translation, poses.as_quat_xyzw(known_valid=known_valid)], axis=-1)


def ros_transform(time_ns: int, parent: str, child: str, parent_from_child: Float64[np.ndarray, " 7"]) -> dict:
    """geometry_msgs/TransformStamped of the numbers of one pose."""
    header = ros_header(time_ns, parent)
    return {"header": header, "child_frame_id": child, "transform": parent_from_child}
