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
    """A topic that somebody publishes, by its name in ROS, such as /camera/image, and its type.

    It is `reliable` where all its publishers resend lost messages, and `latched` where all keep the last messages for
    late subscribers, as of /tf_static.
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
    """Become a participant of a ROS 2 system. Raises VaporTrackError where that is impossible."""
    try:
        from sequences.live.dds import DdsTransport
    except ImportError as error:
        raise SequenceError(
            "live topics need cyclonedds, expected it installed: pip install vapor-track[live]"
        ) from error
    return DdsTransport(options)
