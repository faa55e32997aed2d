"""Options: which running system to join."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass

from filtering.errors import VaporTrackError

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
