"""A ROS system without a network: tests offer and send messages, and read those published."""

from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from sequences.live.transport import Offer, Publish
from sequences.recordings.bag import Bag
from sequences.recordings.source import TF_STATIC, RawMessage


@dataclass
class FakeTransport:
    """A `Transport` without threads: subscribers are called by `say`, in the thread of the test.

    `advertised` has the type of each topic and whether it is latched; `in_order` the topics of all published messages.
    """

    name: str = "a made-up system"
    subscribed: list[Offer] = field(default_factory=list)
    advertised: dict[str, tuple[str, bool]] = field(default_factory=dict)
    published: defaultdict[str, list[bytes]] = field(default_factory=lambda: defaultdict(list))
    in_order: list[str] = field(default_factory=list)
    is_closed: bool = False
    _offers: dict[tuple[str, str], Offer] = field(default_factory=dict)
    _heard_by: dict[str, tuple[Offer, Callable[[RawMessage], None]]] = field(default_factory=dict)
    _latched: dict[str, list[RawMessage]] = field(default_factory=dict)

    # --- what it is for those who use it ----------------------------------------------------------

    def offers(self) -> list[Offer]:
        return [offer for _, offer in sorted(self._offers.items())]

    def subscribe(self, offer: Offer, deliver: Callable[[RawMessage], None]) -> None:
        """See `Transport.subscribe`; earlier messages of latched topics are delivered at once."""
        self.subscribed.append(offer)
        self._heard_by[offer.topic] = offer, deliver
        for raw in self._latched.get(offer.topic, []):
            deliver(raw)

    def advertise(self, topic: str, message_type: str, *, latched: bool = False) -> Publish:
        self.advertised[topic] = message_type, latched

        def publish(data: bytes) -> None:
            self.published[topic].append(data)
            self.in_order.append(topic)

        return publish

    def close(self) -> None:
        self.is_closed = True
        self._heard_by.clear()

    # --- what a test does -------------------------------------------------------------------------

    def offer(self, topic: str, message_type: str, *, reliable: bool = True, latched: bool = False) -> None:
        self._offers[topic, message_type] = Offer(topic, message_type, reliable, latched)

    def withdraw(self, topic: str) -> None:
        self._offers = {names: offer for names, offer in self._offers.items() if names[0] != topic}

    def say(self, raw: RawMessage) -> bool:
        """Send one message, which arrives when it was logged; whether it has a subscriber."""
        is_latched = any(offer.latched for (topic, _), offer in self._offers.items() if topic == raw.topic)
        if is_latched:
            self._latched.setdefault(raw.topic, []).append(raw)
        if raw.topic not in self._heard_by:
            return False
        offer, deliver = self._heard_by[raw.topic]
        assert raw.type == offer.type, f"{raw.topic} is {raw.type}, expected the {offer.type} that was subscribed"
        deliver(raw)
        return True


def messages_of(path: Path) -> list[RawMessage]:
    """All messages of a recording as a transport delivers them: without definitions of their types."""
    bag = Bag(path)
    return [raw._replace(definition=b"") for raw in bag.messages([*bag.topics])]


def offering(raws: list[RawMessage]) -> FakeTransport:
    """A system that offers the topics of messages, of which only /tf_static is latched; none is sent yet."""
    transport = FakeTransport()
    for raw in raws:
        transport.offer(raw.topic, raw.type, latched=raw.topic == TF_STATIC)
    return transport
