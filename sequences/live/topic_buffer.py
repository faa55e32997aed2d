"""The topics of a running system as a source of messages, like a recording that grows."""

from __future__ import annotations

import queue
from collections import Counter, deque
from collections.abc import Callable, Collection, Iterator
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import Any

from sequences.errors import NotFoundError, SequenceError
from sequences.live.transport import Offer, Transport
from sequences.options import ReadingOptions
from sequences.reading.rig import IMAGE_TYPES
from sequences.recordings.source import RawMessage, Topic, namespaced_tf, stands_for

_KEPT_IMAGES, _KEPT = 16, 2000  # messages of each topic, until the reading begins
_KEPT_ON = ("tf2_msgs/TFMessage", "sensor_msgs/Imu", "sensor_msgs/FluidPressure")  # of sensors that may come later


class TopicBuffer:
    """A `MessageSource` that grows: a topic is subscribed when it is first asked for.

    `topics` are published now, without Foxglove's transforms, which ROS's stand for. The number of messages is that of
    those heard until the reading begins, and 1 of topics that nobody asked for yet.
    """

    def __init__(self, transport: Transport, events: queue.SimpleQueue[Any], *, options: ReadingOptions) -> None:
        """Listen to a system, whose messages go to `events`."""
        self.path = Path(transport.name)
        self.topics: dict[str, Topic] = {}
        self._transport, self._events, self._options = transport, events, options
        self._tf: dict[str, str] = {}
        self._offered: dict[str, list[Offer]] = {}  # by their own names
        self._offers: dict[str, list[Offer]] = {}  # by the names that readers use
        self._heard_from: dict[str, Offer] = {}
        self._kept: dict[str, deque[tuple[int, RawMessage]]] = {}
        self._numbers = count()
        self._heard, self._is_reading = Counter[str](), False

    def refresh(self) -> bool:
        """Update the topics that are published; true where they have changed."""
        offered: dict[str, list[Offer]] = {}
        for offer in self._transport.offers():
            offered.setdefault(offer.topic, []).append(offer)
        if offered == self._offered:
            return False
        self._offered = offered
        topics = [Topic(name, same[0].type, 1, "cdr") for name, same in offered.items()]
        known = {t.name: t for t in topics if not t.is_misnamed and not t.is_foxglove_tf}
        try:
            self._tf = namespaced_tf(known, self._options.tf_topic, self.path)
        except NotFoundError:  # not yet
            self._tf = {}
        called = {each: name for name, topic in known.items() for each in stands_for(topic, self._tf)}
        self.topics = {each: replace(known[name], name=each) for each, name in called.items()}
        self._offers = {each: offered[name] for each, name in called.items()}
        for name, before in list(self._heard_from.items()):
            (now, *_) = self._offers.get(name, [before])
            if now.type == before.type and now != before:  # a publisher that came back with another QoS may not match
                self._hear(name, now)
        return True

    def __contains__(self, topic: str) -> bool:
        return topic in self.topics

    def messages(
        self, topics: Collection[str], *, until: Callable[[int], bool] = lambda log_time_ns: False
    ) -> Iterator[RawMessage]:
        """Messages of some topics so far, see `MessageSource`; subscribes them. Raises SequenceError as `hear`."""
        found: list[tuple[int, RawMessage]] = []
        for name in self.topics.keys() & set(topics):
            self.hear(name)
            found += self._kept.get(name, ())
        for _, raw in sorted(found, key=lambda numbered: numbered[0]):
            if not until(raw.log_time_ns):
                yield raw

    def hear(self, topic: str) -> None:
        """Subscribe a topic that is published. Raises SequenceError where it has several types."""
        if topic in self._heard_from:
            return
        offers = self._offers[topic]
        if len(offers) > 1:
            types = " and of ".join(offer.type for offer in offers)
            raise SequenceError(f"{self.path}: {topic} has messages of {types}, expected one type a topic")
        size = _KEPT_IMAGES if self.topics[topic].read_as in IMAGE_TYPES else _KEPT
        self._kept[topic] = deque(maxlen=size)
        self._hear(topic, offers[0])

    def _hear(self, topic: str, offer: Offer) -> None:
        self._heard_from[topic] = offer
        self._transport.subscribe(offer, self._events.put)

    def keep(self, raw: RawMessage) -> RawMessage:
        """Take a message, and keep it until `kept` is called; gives it with the name and the stamps of the options."""
        raw = self._stamped(raw)
        if (kept := self._kept.get(raw.topic)) is not None:
            kept.append((next(self._numbers), raw))
            if raw.topic in self.topics and not self._is_reading:
                self._heard[raw.topic] += 1
                self.topics[raw.topic] = replace(self.topics[raw.topic], num_messages=self._heard[raw.topic])
        return raw

    def kept(self) -> list[RawMessage]:
        """The kept messages, in the order in which they came. From now on only transforms and sensors are kept."""
        found = sorted((numbered for kept in self._kept.values() for numbered in kept), key=lambda each: each[0])
        self._is_reading = True
        self._kept = {
            name: kept
            for name, kept in self._kept.items()
            if name in self.topics and self.topics[name].read_as in _KEPT_ON
        }
        return [raw for _, raw in found]

    def _stamped(self, raw: RawMessage) -> RawMessage:
        return raw._replace(restamped=self._options.stamps == "log", topic=self._tf.get(raw.topic, raw.topic))

    def fixed_links(self) -> frozenset[tuple[str, str]]:
        """None, as Foxglove's transforms are not read."""
        return frozenset()
