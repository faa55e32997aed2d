"""Recordings of the short walk with the messages of an inertial unit on the robot's base."""

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
from mcap.reader import make_reader
from mcap.writer import Writer

from sequences.recordings.mcap_writer import MessageChannels, ros_header
from sequences.recordings.message_definitions import encoder
from sequences.recordings.source import RawMessage
from tests.helpers.sequence_files import BEGIN_NS, Walk, world_from_base

IMU, GRAVITY = "/imu/data", 9.80665
_STEP_NS = 1_000_000
Message = dict[str, Any]


def with_messages(
    source: Path, target: Path, topic: str, message_type: str, messages: Iterable[tuple[int, Message]]
) -> Path:
    """A copy of an MCAP file with further messages, in order of time."""
    with open(source, "rb") as stream, open(target, "wb") as out:
        writer = Writer(out)
        writer.start(profile="ros2")
        channels = MessageChannels(writer)
        events = [
            RawMessage(channel.topic, message.log_time, message.data, schema.name.replace("/msg/", "/"), "cdr", b"")
            for schema, channel, message in make_reader(stream).iter_messages()
            if schema is not None
        ]
        encode = encoder(message_type)
        events += [RawMessage(topic, t, encode(fields), message_type, "cdr", b"") for t, fields in messages]
        for raw in sorted(events, key=lambda raw: raw.log_time_ns):
            channels.write(raw)
        writer.finish()
    return target


def inertial_messages(
    *,
    seconds: float = 1.3,
    hz: float = 100.0,
    frame: str = "base_link",
    change: Callable[[int, Message], Any] | None = None,
) -> list[tuple[int, Message]]:
    """What a perfect unit on the base would measure along the walk; `change` alters a message, or drops it: False."""
    messages = []
    for number in range(round(seconds * hz)):
        time_ns = BEGIN_NS - 50_000_000 + round(number * 1e9 / hz)
        poses = world_from_base(np.array([time_ns - _STEP_NS, time_ns, time_ns + _STEP_NS]))
        step_s = _STEP_NS * 1e-9
        acceleration = (poses.translation[2] - 2 * poses.translation[1] + poses.translation[0]) / step_s**2
        force = poses.rotation[1].T @ (acceleration + np.array([0, 0, GRAVITY]))
        turn = (poses[0].inverse() @ poses[2]).log()[3:] / (2 * step_s)
        message: Message = {
            "header": ros_header(time_ns, frame),
            "orientation": poses[1].as_quat_xyzw(),
            "orientation_covariance": [1e-4, 0, 0, 0, 1e-4, 0, 0, 0, 1.0],
            "angular_velocity": turn,
            "linear_acceleration": force,
        }
        if change is None or change(number, message) is not False:
            messages.append((time_ns, message))
    return messages


def without_orientation(number: int, message: Message) -> None:
    message["orientation"], message["orientation_covariance"] = np.zeros(4), [-1.0, *[0.0] * 8]


def standing_with_unit(folder: Path, *, seconds: float, hz: float = 100.0) -> Path:
    """A recording of a robot that stands, ten images a second, with a unit that measures just that."""
    walk = Walk(num_images=round(10 * seconds))
    there = world_from_base(np.array(BEGIN_NS))
    walk.odometry = [(time_ns, there) for time_ns, _ in walk.odometry]

    def stands(number: int, message: Message) -> None:
        message["orientation"] = there.as_quat_xyzw()
        message["angular_velocity"] = np.zeros(3)
        message["linear_acceleration"] = GRAVITY * there.rotation.T @ [0, 0, 1.0]

    messages = inertial_messages(seconds=seconds + 0.1, hz=hz, change=stands)
    return with_messages(walk.write(folder / "plain.mcap"), folder / "imu.mcap", IMU, "sensor_msgs/Imu", messages)
