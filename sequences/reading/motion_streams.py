"""Messages beside the images, each topic read as far as an image needs it, however late it was logged."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping

from sequences.reading.timeline import Dated, Key, Timeline

_HORIZON_NS = 10 * 10**9  # ahead of an image, within which the poses of its time are expected
_FORGET_EVERY = 500  # messages


class MotionStreams:
    """Topics with odometry, true poses, transforms and intrinsics, each with a place of its own in the recording."""

    def __init__(
        self,
        timeline: Timeline,
        watched: Mapping[str, Collection[Key] | None],
        take: Callable[[Dated], None],
        *,
        reaches: Callable[[int], bool],
        forget_before: Callable[[int], None],
    ) -> None:
        """Set up streams of the `watched` topics, see `Timeline`, which were not read yet.

        `take` gets every message, in the order of its topic. `reaches` is whether the messages so far determine the
        motion at a time. `forget_before` is called with times before which nothing will be asked for.
        """
        self._topics = [_TopicCursor(timeline, topic, links) for topic, links in watched.items()]
        self._take, self._reaches, self._forget_before = take, reaches, forget_before
        self._num_read = 0

    def read_until(self, time_ns: int) -> bool:
        """Read all that determines the motion at a time; true, as nothing more need be waited for."""
        for topic in self._topics:
            while topic.is_behind(time_ns) and self._read(topic, time_ns):
                pass
        while not self._reaches(time_ns):
            behind = [topic for topic in self._topics if topic.latest_ns < time_ns + _HORIZON_NS]
            came = [self._read(topic, time_ns) for topic in behind]
            if not any(came):
                break
        return True

    def finish(self) -> None:
        """Count the rest undecoded. Raises SequenceError where a topic lacks messages that its file states."""
        for topic in self._topics:
            topic.is_over = True
            for _ in topic.messages:
                pass

    def _read(self, topic: _TopicCursor, time_ns: int) -> bool:
        dated = next(topic.messages, None)
        if dated is None:
            topic.is_over = True
            return False
        topic.note(dated)
        self._take(dated)
        self._num_read += 1
        if self._num_read % _FORGET_EVERY == 0:
            self._forget_before(min(time_ns, *(each.settled_ns for each in self._topics)))
        return True


class _TopicCursor:
    """How far one topic was read; `is_over` where no more is wanted."""

    def __init__(self, timeline: Timeline, topic: str, links: Collection[Key] | None) -> None:
        keys = [("", topic)] if links is None else links
        self._streams = {key: timeline.streams[key] for key in keys if key in timeline.streams}
        self._num_read = Counter[Key]()
        self._latest_ns: dict[Key, int] = {}
        self.latest_ns = -(1 << 63)
        self.is_over = False
        self.messages: Iterator[Dated] = timeline.messages(topic, until=lambda _: self.is_over)

    def is_behind(self, time_ns: int) -> bool:
        """Whether more must be read to know the motion at a time."""
        if self.is_over or self.latest_ns >= time_ns + _HORIZON_NS:
            return False
        return any(self._num_read[key] < times.num_until(time_ns) for key, times in self._streams.items())

    @property
    def settled_ns(self) -> int:
        """Before this time no message is left to read."""
        if self.is_over or not self._streams:
            return 1 << 63
        return min(self._latest_ns.get(key, -(1 << 63)) - times.lateness_ns for key, times in self._streams.items())

    def note(self, dated: Dated) -> None:
        """Count a message that was read."""
        self._num_read.update(dated.keys)
        for key, time_ns in dated.stamps_ns:
            self._latest_ns[key] = max(time_ns, self._latest_ns.get(key, time_ns))
            self.latest_ns = max(self.latest_ns, time_ns)
