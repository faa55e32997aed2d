"""What was heard of a running system so far, read as a recording is: by whoever finds out which topic is what."""

from __future__ import annotations

import queue
from collections import deque
from collections.abc import Callable, Collection, Iterator
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import Any

from sequences.errors import NotFoundError, SequenceError
from sequences.live.transport import Offer, Transport
from sequences.options import ReadingOptions
from sequences.reading.roles import IMAGE_TYPES
from sequences.recordings.source import RawMessage, Topic, namespaced_tf, stands_for

_KEPT_IMAGES, _KEPT = 16, 2000  # of every topic


class Heard:
    """A `MessageSource` that grows: topics are heard from when they are first asked for.

    Attributes:
        path: What messages of errors call it: the name of the system.
        topics: Topics that are published now, by name; without Foxglove's transforms, which ROS's stand for.
    """

    def __init__(self, transport: Transport, events: queue.SimpleQueue[Any], *, options: ReadingOptions) -> None:
        """Begin to listen.

        Args:
            transport: The system.
            events: Where messages are put as they come, for `take`.
            options: Whether messages keep the stamps of their headers, or get the times at which they came, and which
                topic is tf.
        """
        self.path = Path(transport.name)
        self.topics: dict[str, Topic] = {}
        self._transport, self._events, self._options = transport, events, options
        self._tf: dict[str, str] = {}
        self._offered: dict[str, list[Offer]] = {}  # as they are called
        self._offers: dict[str, list[Offer]] = {}  # by the names that they are asked for by
        self._heard_from: dict[str, Offer] = {}
        self._kept: dict[str, deque[tuple[int, RawMessage]]] = {}
        self._numbers = count()

    def refresh(self) -> bool:
        """Look which topics are published now; says whether that has changed."""
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
            if now.type == before.type and now != before:  # a publisher that came back otherwise may not fit any more
                self._hear(name, now)
        return True

    def __contains__(self, topic: str) -> bool:
        return topic in self.topics

    def messages(
        self, topics: Collection[str], *, until: Callable[[int], bool] = lambda log_time_ns: False
    ) -> Iterator[RawMessage]:
        """What was heard of some topics so far, as `MessageSource` has it; from now on they are heard from.

        Raises:
            SequenceError: a topic is published with several types.
        """
        found: list[tuple[int, RawMessage]] = []
        for name in self.topics.keys() & set(topics):
            self.hear(name)
            found += self._kept[name]
        for _, raw in sorted(found, key=lambda numbered: numbered[0]):
            if not until(raw.log_time_ns):
                yield raw

    def hear(self, topic: str) -> None:
        """Hear from a topic that is published, from now on. Raises SequenceError where it has several types."""
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

    def keep(self, raw: RawMessage) -> None:
        """Take a message in, until `kept` was asked for."""
        raw = self.stamped(raw)
        if (kept := self._kept.get(raw.topic)) is not None:
            kept.append((next(self._numbers), raw))

    def kept(self) -> list[RawMessage]:
        """What was kept, in the order in which it came; nothing is kept any more."""
        found = sorted((numbered for kept in self._kept.values() for numbered in kept), key=lambda each: each[0])
        self._kept = {}
        return [raw for _, raw in found]

    def stamped(self, raw: RawMessage) -> RawMessage:
        """A message with the name and the stamps that were asked for."""
        return raw._replace(restamped=self._options.stamps == "log", topic=self._tf.get(raw.topic, raw.topic))

    def fixed_links(self) -> frozenset[tuple[str, str]]:
        """None, as Foxglove's transforms are not heard."""
        return frozenset()

    @property
    def is_running(self) -> bool:
        """It goes on."""
        return True
