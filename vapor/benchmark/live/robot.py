"""A robot in a process of its own, that can be killed: it plays a walk, and does on request what robots should not.

It reads requests from standard input, a line each: `drop TOPIC`, `resume`, `clock SECONDS`.
"""

from __future__ import annotations

import json
import sys
import threading
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from filtering.se3 import Poses
from sequences.live.transport import DdsOptions, join
from sequences.recordings.mcap_writer import ros_poses
from sequences.recordings.message_definitions import decoder, encoder
from sequences.recordings.messages import pose_from_message
from vapor.benchmark.live.traffic import ODOMETRY, Altered, Outgoing, Traffic, play, read_walk

_FOUND_S = 1.0


@dataclass(frozen=True)
class RobotConfig:
    """The traffic of a robot.

    Attributes:
        recording: The walk.
        domain: ROS domain.
        rate: Images a second.
        odometry_hz: Messages of odometry a second.
        begin_ns: When the walk began, by the clock of this machine; 0 for now.
        restarted: Whether its odometry begins at the identity wherever it is.
    """

    recording: str
    domain: int
    rate: float
    odometry_hz: float
    begin_ns: int = 0
    restarted: bool = False

    @property
    def word(self) -> str:
        """All of it, as the argument of the process."""
        return json.dumps(asdict(self))


class Robot:
    """What becomes of messages; requests come from another thread."""

    def __init__(self, *, restarted: bool) -> None:
        self._dropped: frozenset[str] = frozenset()
        self._shift_ns = 0
        self._restarted = restarted
        self._now_from_before: Poses | None = None

    def request(self, line: str) -> None:
        """Obey a line from now on."""
        words = line.split()
        if words[:1] == ["drop"]:
            self._dropped = frozenset(words[1:])
        elif words == ["resume"]:
            self._dropped = frozenset()
        elif words[:1] == ["clock"]:
            self._shift_ns = round(float(words[1]) * 1e9)

    def alter(self, outgoing: Outgoing) -> Altered:
        """See `play`."""
        if outgoing.topic in self._dropped:
            return None
        data = (
            self._restarted_odometry(outgoing.data) if self._restarted and outgoing.topic == ODOMETRY else outgoing.data
        )
        return data, self._shift_ns

    def _restarted_odometry(self, data: bytes) -> bytes:
        """Odometry that began at the identity with the first message."""
        message = decoder("nav_msgs/Odometry")(data)
        pose = pose_from_message(message.pose.pose)
        if self._now_from_before is None:
            self._now_from_before = pose.inverse()
        fields: dict[str, Any] = {
            "header": {"frame_id": message.header.frame_id},
            "child_frame_id": message.child_frame_id,
            "pose": {"pose": ros_poses(self._now_from_before @ pose)},
            "twist": {"covariance": message.twist.covariance},
        }
        return encoder("nav_msgs/Odometry")(fields)


def main(word: str) -> None:
    """Play without end; prints when the walk began, in nanoseconds, once others had time to find it."""
    config = RobotConfig(**json.loads(word))
    traffic = Traffic(read_walk(Path(config.recording)), config.rate, odometry_hz=config.odometry_hz)
    robot = Robot(restarted=config.restarted)

    def listen() -> None:
        for line in sys.stdin:
            robot.request(line)

    threading.Thread(target=listen, daemon=True).start()
    transport = join(DdsOptions(domain=config.domain, localhost=True))
    from_s = (time.time_ns() - config.begin_ns) * 1e-9 if config.begin_ns else 0.0
    begun = False
    for sent in play(transport, traffic, from_s=from_s, alter=robot.alter):
        if not begun:
            begun = True
            sys.stdout.write(f"{time.time_ns() - round(from_s * 1e9)}\n")
            sys.stdout.flush()
        del sent


if __name__ == "__main__":
    main(sys.argv[1])
