"""The stamps of a recording by one steady clock: where clocks were set, which stamps are odd, how late messages lie.

Clocks are set in the field: all when a robot without a battery finds a time server, a camera's when it locks to PTP.
"""

from __future__ import annotations

import struct
from array import array
from collections import Counter, deque
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from types import SimpleNamespace
from typing import Any, Literal, NamedTuple

import numpy as np
from jaxtyping import Bool, Int64

from filtering.errors import listed
from sequences.errors import SequenceError
from sequences.recordings.message_definitions import begins_with_stamp
from sequences.recordings.messages import stamp_ns
from sequences.recordings.source import TF_STATIC, MessageSource, RawMessage, decode, link_of

Key = tuple[str, str]
"""A stream with a clock of its own: parent and child of a link of tf, or '' and a topic."""
StampKind = Literal["usual", "odd", "stepped"]
MAX_LATENESS_S = 10.0  # how long poses are remembered for late images, where nothing else limits that

_STEP_S = 1.0  # by which stamps differ from those before where their clock was set
_SET_AHEAD_S = 86_400.0  # a log that jumps ahead by less may have been paused
_AGREE_S, _AGREE = 0.5, 3  # so many messages in a row show the same step
_REMEMBERED_NS = 30 * 10**9  # clocks drift apart slowly
_SET_BACK_S = 1.0  # threads of a recorder that write one topic disagree by less
_SAME_STEP_NS = 10**9  # within which steps of two streams are of one clock, in time and in size
_LATEST_NS = 1 << 62  # log times are any 64 bits
_NEAR = 50  # messages on either side of a step, by which it is measured
_STAMP = struct.Struct(">iI"), struct.Struct("<iI")


@dataclass
class ClockOfStream:
    """The clock behind the stamps of one topic.

    A stamp is odd that is more than a second before the latest one, or as much behind it while it also runs as much
    further ahead of its arrival than any of the last half minute. Three odd ones in a row that agree show that the
    clock was set. Delayed messages are late, but not odd: each follows the one before.
    """

    _end_ns: int | None = None
    _ahead_ns: deque[tuple[int, int]] = field(default_factory=deque)  # arrival and offset, the largest offset first
    _odd: list[tuple[int, int]] = field(default_factory=list)  # stamp and offset

    def take(self, time_ns: int, arrived_ns: int) -> StampKind:
        """Take a stamp; an odd one may turn out to be the first of a clock that was set."""
        offset_ns = time_ns - arrived_ns
        if not self._is_odd(time_ns, offset_ns):
            self._odd.clear()
            self._end_ns = time_ns if self._end_ns is None else max(self._end_ns, time_ns)
            self._remember(arrived_ns, offset_ns)
            return "usual"
        self._odd.append((time_ns, offset_ns))
        del self._odd[:-_AGREE]
        times, offsets = zip(*self._odd, strict=True)
        agree = len(times) == _AGREE and list(times) == sorted(set(times))
        if not agree or max(offsets) - min(offsets) > _AGREE_S * 1e9:
            return "odd"
        self._odd.clear()
        self._ahead_ns.clear()
        self._end_ns = time_ns
        self._remember(arrived_ns, offset_ns)
        return "stepped"

    def _is_odd(self, time_ns: int, offset_ns: int) -> bool:
        if self._end_ns is None:
            return False
        since_ns, further_ahead_ns = time_ns - self._end_ns, offset_ns - self._ahead_ns[0][1]
        return since_ns < -_STEP_S * 1e9 or min(since_ns, further_ahead_ns) > _STEP_S * 1e9

    def _remember(self, arrived_ns: int, offset_ns: int) -> None:
        """Keep the largest offset of the last half minute at hand: a queue that falls."""
        while self._ahead_ns and self._ahead_ns[-1][1] <= offset_ns:
            self._ahead_ns.pop()
        self._ahead_ns.append((arrived_ns, offset_ns))
        while len(self._ahead_ns) > 1 and arrived_ns - self._ahead_ns[0][0] > _REMEMBERED_NS:
            self._ahead_ns.popleft()


class LoggedSegment:
    """The segment of a recording that is asked for, by the times at which its images were logged.

    Attributes:
        is_over: Whether everything that comes lies too far behind it.
    """

    def __init__(self, image_topics: Collection[str], duration_s: float) -> None:
        """Set up a segment that lasts so long from the first image on."""
        self.is_over = False
        self._topics, self._until_ns = image_topics, round((duration_s + MAX_LATENESS_S) * 1e9)
        self._last_ns: int | None = None
        self._passed_ns = 0

    def take(self, raw: RawMessage) -> None:
        """Take the next message."""
        if raw.topic not in self._topics:
            return
        since_ns = 0 if self._last_ns is None else raw.log_time_ns - self._last_ns
        self._last_ns = raw.log_time_ns
        if 0 <= since_ns <= _SET_AHEAD_S * 1e9:  # else the clock of the log was set
            self._passed_ns += since_ns
        self.is_over = self._passed_ns > self._until_ns


class Dated(NamedTuple):
    """A message by the steady clock.

    Attributes:
        raw: The message as recorded.
        message: Its fields, with stamps by the steady clock; None for undecodable bytes.
        num_odd: How many of its stamps are unlike those around them; such transforms of tf are removed.
        stamps_ns: Its watched stamps that are not odd, with their streams.
    """

    raw: RawMessage
    message: Any
    num_odd: int
    stamps_ns: tuple[tuple[Key, int], ...]


@dataclass
class StreamTimes:
    """The n ≥ 1 stamps of one stream, by the steady clock, in the order of the recording.

    Attributes:
        odd: Which are unlike those around them, (n,).
        steps_ns: Stamp of the first message behind each step of the clock, and size of the step.
        begin_ns: The earliest that is not odd.
        end_ns: The latest that is not odd.
        lateness_ns: How much earlier a stamp may be than the latest one before it.
    """

    times_ns: Int64[np.ndarray, " n"]
    odd: Bool[np.ndarray, " n"] = field(default_factory=lambda: np.zeros(0, bool))
    steps_ns: list[tuple[int, int]] = field(default_factory=list)
    begin_ns: int = field(init=False)
    end_ns: int = field(init=False)
    lateness_ns: int = field(init=False)

    def __post_init__(self) -> None:
        if not len(self.odd):
            self.odd = np.zeros(len(self.times_ns), bool)
        usual = self.times_ns if self.odd.all() else self.times_ns[~self.odd]
        self.begin_ns, self.end_ns = int(usual.min()), int(usual.max())
        self.lateness_ns = int((np.maximum.accumulate(usual) - usual).max())


class Timeline:
    """The messages of a recording by one steady clock: that of its log, as it was at the end."""

    def __init__(
        self, bag: MessageSource, watched: Mapping[str, Collection[Key] | None], *, segment: LoggedSegment | None = None
    ) -> None:
        """Survey a recording, or a segment of it. Raises SequenceError where it is damaged.

        `watched` are names of topics, with the links of tf that count, or None where messages have one stamp each.
        """
        self._bag, self._watched = bag, watched
        stamps: dict[Key, array[int]] = {}
        logged: dict[Key, array[int]] = {}
        for raw in bag.messages(watched, until=lambda _: segment is not None and segment.is_over):
            if segment is not None:
                segment.take(raw)
            if (peeked := _peeked(raw)) is not None:
                found = [(("", raw.topic), peeked)]
            else:
                headers = self._headers(raw.topic, decode(bag, raw, tolerate=True))
                found = [(key, stamp_ns(header)) for key, header in headers]
            for key, time_ns in found:
                stamps.setdefault(key, array("q")).append(time_ns)
                logged.setdefault(key, array("q")).append(min(raw.log_time_ns, _LATEST_NS))
        self._log_times_differ = any(min(log) < max(log) for log in logged.values())
        arrays = {key: (np.array(stamps[key], np.int64), np.array(logged[key], np.int64)) for key in stamps}
        self._logged = {key: log for key, (_, log) in arrays.items() if key[0] == ""}
        timeless = set(watched.get(TF_STATIC) or ())
        self.streams = _by_steady_clock({key: both for key, both in arrays.items() if key not in timeless})
        self.streams |= {key: StreamTimes(arrays[key][0]) for key in timeless & arrays.keys()}

    def messages(
        self, topics: Collection[str], *, until: Callable[[int], bool] = lambda log_time_ns: False
    ) -> Iterator[Dated]:
        """Messages of some topics in the order of the recording. Raises SequenceError where it is damaged."""
        seen = Counter[Key]()
        for raw in self._bag.messages(topics, until=until):
            message = decode(self._bag, raw, tolerate=True)
            headers = self._headers(raw.topic, message)
            stamps, odd = [], []
            for key, header in headers:
                times, time_ns = self.streams.get(key), stamp_ns(header)
                if times is not None and seen[key] < len(times.times_ns):  # else behind what was surveyed
                    if times.odd[seen[key]]:
                        odd.append(header)
                    elif time_ns != times.times_ns[seen[key]]:
                        time_ns = int(times.times_ns[seen[key]])
                        sec, nanosec = divmod(time_ns, 1_000_000_000)
                        header.stamp = SimpleNamespace(sec=sec, nanosec=nanosec)
                if not any(header is each for each in odd):
                    stamps.append((key, time_ns))
                seen[key] += 1
            if odd and self._watched[raw.topic] is not None and message is not None:
                message.transforms = [t for t in message.transforms if not any(t.header is each for each in odd)]
            yield Dated(raw, message, len(odd), tuple(stamps))

    @property
    def notices(self) -> list[str]:
        """Each step of the clocks, once where several share it."""
        steps: list[tuple[int, int, list[Key]]] = []
        for key, times in self.streams.items():
            for time_ns, by_ns in times.steps_ns:
                same = (s for s in steps if max(abs(s[0] - time_ns), abs(s[1] - by_ns)) < _SAME_STEP_NS)
                found = next(same, None) or (time_ns, by_ns, [])
                if not found[2]:
                    steps.append(found)
                found[2].append(key)
        return [
            f"the clock of {listed((' -> '.join(filter(None, key)) for key in keys), 1)} was set by"
            f" {by_ns * 1e-9:+.3f} s at {time_ns * 1e-9:.3f} s: all stamps are given by one clock"
            for time_ns, by_ns, keys in sorted(steps, key=lambda step: step[0])
        ]

    def span_ns(self, keys: Collection[Key]) -> tuple[int, int] | None:
        """The span in which all of some streams have messages; None where one has none."""
        streams = [self.streams[key] for key in keys if key in self.streams]
        if not streams or len(streams) < len(keys):
            return None
        return max(times.begin_ns for times in streams), min(times.end_ns for times in streams)

    def lateness_ns(self, topics: Collection[str]) -> int:
        """How much earlier a stamp of some topics may be than the latest one before it of any of them."""
        keys = [("", topic) for topic in topics if ("", topic) in self.streams]
        if len(keys) < 2:
            return max((self.streams[key].lateness_ns for key in keys), default=0)
        usual = [~self.streams[key].odd for key in keys]
        logged = np.concatenate([self._logged[key][use] for key, use in zip(keys, usual, strict=True)])
        stamps = np.concatenate([self.streams[key].times_ns[use] for key, use in zip(keys, usual, strict=True)])
        stamps = stamps[np.argsort(logged, kind="stable")]
        return int((np.maximum.accumulate(stamps) - stamps).max(initial=0))

    def ahead_s(self, topic: str) -> float:
        """How far the stamps of a topic are ahead of the times at which they were logged, median; 0 without any."""
        times = self.streams.get(("", topic))
        return 0.0 if times is None else float(np.median(times.times_ns - self._logged["", topic])) * 1e-9

    def spacing_s(self, keys: Collection[Key]) -> float:
        """Median time between two messages of the sparsest of some streams; 0 where there are none."""
        times = [np.unique(self.streams[key].times_ns) for key in keys if key in self.streams]
        return max((float(np.median(np.diff(each))) * 1e-9 for each in times if len(each) > 1), default=0.0)

    def require_differing(self, key: Key, what: str) -> None:
        """Raise SequenceError where a stream has several messages, all with one and the same stamp."""
        times = self.streams.get(key)
        if times is None or len(times.times_ns) < 2 or (times.times_ns != times.times_ns[0]).any():
            return
        helps = "; --stamps log takes the times at which they were logged" if self._log_times_differ else ""
        stamp = "zero" if times.begin_ns == 0 else f"{times.begin_ns} ns"
        raise SequenceError(
            f"{self._bag.path}: the time stamps in the headers of all {len(times.times_ns)} {what} are {stamp},"
            f" expected increasing ones{helps}"
        )

    def _headers(self, topic: str, message: Any) -> list[tuple[Key, Any]]:
        links = self._watched[topic]
        if message is None:
            return []
        if links is None:
            return [(("", topic), message.header)]
        return [(link, t.header) for t in message.transforms if (link := link_of(t)) in links]


def _peeked(raw: RawMessage) -> int | None:
    """The stamp of a message whose bytes begin with it, without decoding it; None for another one."""
    if raw.problem or raw.restamped or raw.encoding != "cdr" or len(raw.data) < 12 or not begins_with_stamp(raw.type):
        return None
    sec, nanosec = _STAMP[raw.data[1] & 1].unpack_from(raw.data, 4)
    return sec * 1_000_000_000 + nanosec


def _by_steady_clock(
    streams: Mapping[Key, tuple[Int64[np.ndarray, " n"], Int64[np.ndarray, " n"]]],
) -> dict[Key, StreamTimes]:
    """Stamps and log times of streams -> their stamps by the clock of the log as it was at the end.

    Log times are made steady first: where they jump, a median period has passed. By that clock each stream's own clock
    is watched. Of the parts between its steps the one that agrees best with the log is right; the others follow it.
    """
    logs = {}
    for key, (stamps, log) in streams.items():
        # Converters write zeros, or count messages.
        are_times = float(np.ptp(log)) * 100 >= min(float(np.ptp(stamps)), 1e9 * len(stamps))
        logs[key] = log if are_times else stamps
    jumps = {key: _jumps(log) for key, log in logs.items()}
    by_period = sorted((jump for found in jumps.values() for jump in found), key=lambda jump: jump.period_ns)
    dated = {}
    for key, (stamps, _) in streams.items():
        steady = logs[key].copy()
        for jump in jumps[key]:
            same = next(each for each in by_period if abs(each.by_ns - jump.by_ns) < _SET_BACK_S * 1e9)
            steady[: jump.at] += same.by_ns  # the densest stream measured it most exactly
        dated[key] = _dated(stamps, steady)
    return dated


class _Jump(NamedTuple):
    at: int
    by_ns: int
    period_ns: int


def _jumps(log: Int64[np.ndarray, " n"]) -> list[_Jump]:
    """Where log times jump back, or ahead by more than a day."""
    apart = np.diff(log)
    at = np.flatnonzero((apart < -_SET_BACK_S * 1e9) | (apart > _SET_AHEAD_S * 1e9))
    if not len(at):
        return []
    period_ns = int(np.median(np.delete(apart, at))) if len(at) < len(apart) else 0
    return [_Jump(int(i) + 1, int(apart[i]) - period_ns, period_ns) for i in at]


def _dated(stamps: Int64[np.ndarray, " n"], steady: Int64[np.ndarray, " n"]) -> StreamTimes:
    """Stamps of one stream by the steady clock of their log times."""
    clock, odd, begins = ClockOfStream(), np.zeros(len(stamps), bool), [0]
    for index, (time_ns, logged_ns) in enumerate(zip(stamps.tolist(), steady.tolist(), strict=True)):
        kind = clock.take(time_ns, logged_ns)
        odd[index] = kind == "odd"
        if kind == "stepped":
            odd[index - 2 : index] = False  # they were the first of the clock that was set
            begins.append(index - 2)
    ahead = stamps - steady
    parts = [slice(*ends) for ends in pairwise([*begins, len(stamps)])]
    by_ns = [
        _median(_usual(ahead, odd, after)[:_NEAR]) - _median(_usual(ahead, odd, before)[-_NEAR:])
        for before, after in pairwise(parts)
    ]
    set_ns = np.concatenate([[0], np.cumsum(np.array(by_ns, np.int64))])
    off_ns = [abs(_median(_usual(ahead, odd, part))) for part in parts]
    set_ns -= set_ns[int(np.argmin(off_ns))]
    times = stamps.copy()
    for part, part_set_ns in zip(parts, set_ns.tolist(), strict=True):
        times[part] -= part_set_ns
    steps = [(int(times[part.start]), by) for part, by in zip(parts[1:], by_ns, strict=True)]
    return StreamTimes(times, odd, steps)


def _median(values: Int64[np.ndarray, " n"]) -> int:
    """One of the values: nanoseconds since 1970 are no float64."""
    return int(np.sort(values)[len(values) // 2])


def _usual(values: Int64[np.ndarray, " n"], odd: Bool[np.ndarray, " n"], part: slice) -> Int64[np.ndarray, " m"]:
    return values[part][~odd[part]]
