"""The messages of a running system, by any network; and joining that network."""

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
        topic: Its name in ROS, such as /camera/image.
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
    """Topics of a running system: offered, subscribed and published."""

    @property
    def name(self) -> str:
        """Its name, such as "ROS domain 0"."""
        ...

    def offers(self) -> list[Offer]:
        """The topics that others publish now, one of every topic and type, sorted by name."""
        ...

    def subscribe(self, offer: Offer, deliver: Callable[[RawMessage], None]) -> None:
        """Deliver all messages of a topic from now on, in their order; replaces an earlier subscription.

        `deliver` is called in a thread of the transport; it must not wait.
        """
        ...

    def advertise(self, topic: str, message_type: str, *, latched: bool = False) -> Publish:
        """Publish a topic, reliably; late subscribers of a latched one get the last message."""
        ...

    def close(self) -> None:
        """Leave the system; nothing is delivered after that."""
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
