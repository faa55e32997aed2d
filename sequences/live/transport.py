"""The messages of a running system, whatever network carries them; and joining that network."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from sequences.errors import SequenceError
from sequences.live.options import DdsOptions
from sequences.recordings.source import RawMessage


@dataclass(frozen=True)
class Offer:
    """A topic that somebody publishes.

    Attributes:
        topic: Its name as ROS has it, such as /camera/image.
        type: Its type, such as `sensor_msgs/Image`.
        reliable: Whether all its publishers send again what was lost.
        latched: Whether all its publishers keep the last messages for those who come later, as /tf_static does.
    """

    topic: str
    type: str
    reliable: bool
    latched: bool


Publish = Callable[[bytes], None]
"""Sends the CDR bytes of one message."""


@runtime_checkable
class Transport(Protocol):
    """Topics of a running system: offered, heard and published."""

    @property
    def name(self) -> str:
        """What a person calls it, such as "ROS domain 0"."""
        ...

    def offers(self) -> list[Offer]:
        """What others publish now, one of every topic and type, sorted by name."""
        ...

    def subscribe(self, offer: Offer, deliver: Callable[[RawMessage], None]) -> None:
        """Have all messages of a topic delivered from now on, whoever publishes them, from a thread of its own.

        A second subscription of a topic takes the place of the first.

        Args:
            offer: The topic, and how it is published.
            deliver: Called with every message, in the order in which they come; it must not wait.
        """
        ...

    def advertise(self, topic: str, message_type: str, *, latched: bool = False) -> Publish:
        """Begin to publish a topic, reliably; of a latched one late subscribers get the last message, too."""
        ...

    def close(self) -> None:
        """Leave the system: nothing is delivered any more."""
        ...


def join(options: DdsOptions | None = None) -> Transport:
    """Become a participant of a ROS 2 system.

    Raises:
        SequenceError: cyclonedds is not installed.
        VaporTrackError: the domain cannot be joined.
    """
    try:
        from sequences.live.dds import DdsTransport
    except ImportError as error:
        raise SequenceError(
            "live topics need cyclonedds, expected it installed: pip install vapor-track[live]"
        ) from error
    return DdsTransport(options)
