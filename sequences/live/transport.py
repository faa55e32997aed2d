"""The messages of a running system, by any network; and joining that network."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from filtering.errors import VaporTrackError
from sequences.errors import SequenceError
from sequences.recordings.source import RawMessage

MAX_DOMAIN = 232  # above, DDS has no ports


@dataclass(frozen=True)
class DdsOptions:
    """Which ROS 2 system to join."""

    domain: int | None = None
    """ROS domain, 0 to 232. Default: ROS_DOMAIN_ID of the environment, else 0."""
    localhost: bool = False
    """Join nodes of this machine only."""
    peer: tuple[str, ...] = ()
    """Addresses of machines to look for nodes on, beside those that multicast finds."""
    reliable: bool = False
    """Ask for images that were lost to be sent again, where their publisher does that: for networks that lose some of
    the parts of large images. By default a lost image stays lost, and delays none of those after it."""

    def __post_init__(self) -> None:
        if not 0 <= self.number <= MAX_DOMAIN:
            raise VaporTrackError(f"ROS domain is {self.number}, expected 0 to {MAX_DOMAIN}")
        for address in self.peer:
            if not re.fullmatch(r"[\w.:\-\[\]%]+", address):
                raise VaporTrackError(f"peer is {address!r}, expected an address of a machine")

    @property
    def number(self) -> int:
        """The domain to join."""
        if self.domain is not None:
            return self.domain
        value = os.environ.get("ROS_DOMAIN_ID") or "0"
        if not value.isdecimal():
            raise VaporTrackError(f"ROS_DOMAIN_ID is {value!r}, expected a number from 0 to {MAX_DOMAIN}")
        return int(value)

    @property
    def xml(self) -> str:
        """The configuration for Cyclone DDS, behind that of CYCLONEDDS_URI."""
        interfaces, multicast, peers = "", "default", [*self.peer]
        if self.localhost:
            interfaces, multicast = '<Interfaces><NetworkInterface address="127.0.0.1"/></Interfaces>', "false"
            peers.append("127.0.0.1")
        # Without multicast nodes are found by their ports, which are numbered.
        index = "<ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>99</MaxAutoParticipantIndex>"
        listed = "".join(f'<Peer address="{address}"/>' for address in peers)
        return (
            '<CycloneDDS><Domain Id="any">'
            f"<General>{interfaces}<AllowMulticast>{multicast}</AllowMulticast></General>"
            f"<Discovery>{index if peers else ''}<Peers>{listed}</Peers></Discovery>"
            # From Kilted on, nodes describe their types in detail; types declared by name alone would not match.
            "<Compatibility><IgnoreTypeInformation>1.15</IgnoreTypeInformation></Compatibility>"
            # Large images come as many datagrams at once; the kernel may grant less.
            '<Internal><SocketReceiveBufferSize min="default" max="16MB"/></Internal>'
            "</Domain></CycloneDDS>"
        )


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
