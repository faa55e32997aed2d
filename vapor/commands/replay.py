"""`vapor-track replay`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated

import tyro

from sequences.live.replay import Replayed, ReplayOptions, replay
from sequences.live.transport import DdsOptions, join
from vapor.commands.console import InputPath, parse, show
from vapor.storage import fetched


@dataclass(frozen=True)
class Options:
    """Publish a recording as ROS 2 topics, in real time."""

    sequence: Annotated[tyro.conf.Positional[InputPath], tyro.conf.arg(metavar="SEQUENCE")]
    """MCAP file, rosbag2 folder or ROS 1 bag."""
    system: Annotated[DdsOptions, tyro.conf.arg(name="")] = field(default_factory=DdsOptions)
    pace: Annotated[ReplayOptions, tyro.conf.arg(name="")] = field(default_factory=ReplayOptions)


def main(arguments: Sequence[str]) -> None:
    """Run the command with the words after `replay`."""
    options = parse("replay", Options, arguments)
    transport = join(options.system)
    done = Replayed(0, 0)
    try:
        for so_far in replay(fetched(options.sequence), transport, options.pace, notify=show):
            done = so_far
    finally:
        transport.close()
        if done.messages:
            show(f"{done.messages} messages published in {transport.name}")
