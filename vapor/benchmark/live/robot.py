"""A robot in a process of its own, that can be killed: it plays a walk, and does on request what robots should not."""

from __future__ import annotations

import multiprocessing
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path

from filtering.errors import VaporTrackError
from sequences.live.replay import replay
from sequences.live.transport import DdsOptions, join
from vapor.benchmark.live.traffic import REPLAYED, AlteringTransport, read_walk, stamp_of, with_stamp, write_walk

_LOSSY = (
    "<CycloneDDS><Domain><Internal><Test><XmitLossiness>200</XmitLossiness></Test></Internal></Domain></CycloneDDS>"
)


@dataclass(frozen=True)
class RobotConfig:
    """The traffic of a robot.

    Attributes:
        recording: The walk.
        folder: For what it plays.
        domain: ROS domain.
        rate: Images a second.
        odometry_hz: Messages of odometry a second.
        lossy: Whether a fifth of its datagrams is lost.
        begin_ns: When the walk began, by the clock of this machine; 0 for now. Odometry begins at the identity now.
    """

    recording: Path
    folder: Path
    domain: int
    rate: float
    odometry_hz: float
    lossy: bool = False
    begin_ns: int = 0


@dataclass(frozen=True)
class Order:
    """What a robot does from now on: it leaves out a topic, and its clock is wrong by some seconds."""

    dropped: str = ""
    clock_s: float = 0.0

    def altered(self, topic: str, data: bytes) -> bytes | None:
        """The message that it publishes in place of one; None for none."""
        if topic == self.dropped:
            return None
        return with_stamp(data, stamp_of(data) + round(self.clock_s * 1e9)) if self.clock_s else data


NO_ORDER = Order()
"""A robot that does as robots should."""


class RobotProcess:
    """A robot that plays in a process of its own.

    Attributes:
        begin_ns: When its walk began, by the clock of this machine.
    """

    def __init__(self, config: RobotConfig) -> None:
        spawning = multiprocessing.get_context("spawn")
        self._orders, its_end = spawning.Pipe()
        self._process = spawning.Process(target=_play, args=(config, its_end), daemon=True)
        self._process.start()
        its_end.close()
        try:
            self.begin_ns = int(self._orders.recv())
        except EOFError:
            self._process.join()
            raise VaporTrackError(f"the robot ended with status {self._process.exitcode}") from None

    def obey(self, order: Order) -> None:
        """Let it follow an order from now on."""
        self._orders.send(order)

    def kill(self) -> None:
        """End it at once."""
        self._process.kill()
        self._process.join()


@contextmanager
def robot_process(config: RobotConfig) -> Iterator[RobotProcess]:
    """A robot, which is killed at the end."""
    robot = RobotProcess(config)
    try:
        yield robot
    finally:
        robot.kill()


def _play(config: RobotConfig, orders: Connection) -> None:
    """Play without end; sends when the walk began, once the first message is due."""
    if config.lossy:
        os.environ["CYCLONEDDS_URI"] = _LOSSY
    from_s = (time.time_ns() - config.begin_ns) * 1e-9 if config.begin_ns else 0.0
    order, begun = NO_ORDER, False

    def alter(topic: str, data: bytes) -> bytes | None:
        nonlocal order, begun
        if not begun:
            begun = True
            orders.send(stamp_of(data) - round(from_s * 1e9))
        if orders.poll():
            order = orders.recv()
        return order.altered(topic, data)

    path = config.folder / f"walk-{os.getpid()}.mcap"
    write_walk(path, read_walk(config.recording), config.rate, odometry_hz=config.odometry_hz, from_s=from_s)
    transport = join(DdsOptions(domain=config.domain, localhost=True))
    for _ in replay(path, AlteringTransport(transport, alter), REPLAYED):
        pass
