"""The stamps of a recording by one steady clock: where clocks were set, which stamps are odd, how late messages lie.

Clocks are set in the field: all of them when a robot without a battery finds a time server, a camera's when it locks to
PTP. So a recording is surveyed once, before its frames are read, and stamps on one side of a step are corrected.
"""

from __future__ import annotations

import struct
from array import array
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Int64

from sequences.errors import SequenceError
from sequences.reading.clock_steps import SET_AHEAD_S, ClockOfStream
from sequences.reading.requested_segment import LoggedSegment
from sequences.recordings.message_definitions import begins_with_stamp
from sequences.recordings.messages import stamp_ns
from sequences.recordings.source import TF_STATIC, MessageSource, RawMessage, link_of
from sequences.recordings.topics import decode

Key = tuple[str, str]
"""What has a clock of its own: parent and child of a link of tf, or '' and a topic."""

_SET_BACK_S = 1.0  # threads of a recorder that write one topic disagree by less
SAME_STEP_NS = 10**9
"""Steps of two streams are of one clock where they are no further apart, in when and in how far."""
_LATEST_NS = 1 << 62  # log times are any 64 bits
_NEAR = 50  # messages on either side of a step, by which it is measured
_STAMP = struct.Struct(">iI"), struct.Struct("<iI")


class Dated(NamedTuple):
    """A message by the steady clock.

    Attributes:
        raw: As it lies in the recording.
        message: Its fields, with stamps by the steady clock; None for bytes that are no message.
        num_odd: How many of its stamps are unlike those around them. Such transforms of tf are taken out of it.
        stamps_ns: Those of its stamps that are watched and not odd, and what has them.
        keys: What has those of its stamps that are watched.
    """

    raw: RawMessage
    message: SimpleNamespace | None
    num_odd: int
    stamps_ns: tuple[tuple[Key, int], ...]
    keys: tuple[Key, ...]


@dataclass
class StreamTimes:
    """The stamps of one stream, by the steady clock.

    Attributes:
        times_ns: Of its messages in the order of the recording, (n,), n ≥ 1.
        odd: Which of them are unlike those around them, (n,).
        steps_ns: Stamp of the first message behind each step of its clock, and by how much it was set.
        begin_ns: The earliest that is not odd.
        end_ns: The latest one.
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
        order = np.argsort(np.where(self.odd, np.iinfo(np.int64).max, self.times_ns), kind="stable")
        self._sorted_ns = self.times_ns[order[: len(usual)]]
        self._num_until = np.maximum.accumulate(order[: len(usual)]) + 1

    def num_until(self, time_ns: int) -> int:
        """How many messages have to be read to have all up to a time, and the one after it."""
        return int(self._num_until[min(int(np.searchsorted(self._sorted_ns, time_ns)), len(self._sorted_ns) - 1)])


class Timeline:
    """The messages of a recording by one steady clock: that of its log, as it was at the end.

    Attributes:
        streams: The streams that are watched and have messages.
    """

    def __init__(
        self,
        bag: MessageSource,
        watched: Mapping[str, Collection[Key] | None],
        *,
        segment: LoggedSegment | None = None,
    ) -> None:
        """Survey a recording.

        Args:
            bag: The recording.
            watched: Names of topics: with the links that count of tf, None of a topic whose messages have one stamp.
            segment: What is asked for of it; None for all.

        Raises:
            SequenceError: the recording is damaged.
        """
        self._bag, self._watched = bag, watched
        stamps: dict[Key, array[int]] = {}
        logged: dict[Key, array[int]] = {}
        for raw in bag.messages(watched, until=lambda _: segment is not None and segment.is_over):
            if segment is not None:
                segment.take(raw)
            peeked = _peeked(raw)
            told = (
                [(key, stamp_ns(header)) for key, header in self._headers(raw.topic, self._decoded(raw))]
                if peeked is None
                else [(("", raw.topic), peeked)]
            )
            for key, time_ns in told:
                stamps.setdefault(key, array("q")).append(time_ns)
                logged.setdefault(key, array("q")).append(min(raw.log_time_ns, _LATEST_NS))
        self._log_times_differ = any(min(log) < max(log) for log in logged.values())
        arrays = {key: (np.array(stamps[key], np.int64), np.array(logged[key], np.int64)) for key in stamps}
        timeless = set(watched.get(TF_STATIC) or ())
        self.streams = _by_steady_clock({key: told for key, told in arrays.items() if key not in timeless})
        self.streams |= {key: StreamTimes(arrays[key][0]) for key in timeless & arrays.keys()}

    def messages(self, topic: str, *, until: Callable[[int], bool] = lambda log_time_ns: False) -> Iterator[Dated]:
        """Messages of one topic in the order of the recording.

        Raises:
            SequenceError: the recording is damaged.
        """
        seen = Counter[Key]()
        for raw in self._bag.messages([topic], until=until):
            message = self._decoded(raw)
            headers = self._headers(topic, message)
            keys = [key for key, _ in headers]
            if message is None and _peeked(raw) is not None:
                keys = [("", topic)]
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
            if odd and self._watched[topic] is not None and message is not None:
                message.transforms = [t for t in message.transforms if not any(t.header is each for each in odd)]
            yield Dated(raw, message, len(odd), tuple(stamps), tuple(keys))

    @property
    def notices(self) -> list[str]:
        """What a person should know of the clocks, a step of several of them once."""
        steps: list[tuple[int, int, list[Key]]] = []
        for key, times in self.streams.items():
            for time_ns, by_ns in times.steps_ns:
                same = (s for s in steps if max(abs(s[0] - time_ns), abs(s[1] - by_ns)) < SAME_STEP_NS)
                found = next(same, None) or (time_ns, by_ns, [])
                if not found[2]:
                    steps.append(found)
                found[2].append(key)
        return [
            f"the clock of {_name(keys[0])}{f' and {len(keys) - 1} more' if len(keys) > 1 else ''} was set by"
            f" {by_ns * 1e-9:+.3f} s at {time_ns * 1e-9:.3f} s: all stamps are given by one clock"
            for time_ns, by_ns, keys in sorted(steps, key=lambda step: step[0])
        ]

    def span_ns(self, keys: Collection[Key]) -> tuple[int, int] | None:
        """From when to when all of some streams have messages; None where one of them has none."""
        streams = [self.streams[key] for key in keys if key in self.streams]
        if not streams or len(streams) < len(keys):
            return None
        return max(times.begin_ns for times in streams), min(times.end_ns for times in streams)

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
        said = "zero" if times.begin_ns == 0 else f"{times.begin_ns} ns"
        raise SequenceError(
            f"{self._bag.path}: the time stamps in the headers of all {len(times.times_ns)} {what} are {said}, expected"
            f" increasing ones{helps}"
        )

    def _decoded(self, raw: RawMessage) -> SimpleNamespace | None:
        return decode(self._bag, raw, tolerate=True)

    def _headers(self, topic: str, message: SimpleNamespace | None) -> list[tuple[Key, SimpleNamespace]]:
        """The headers that count, and what has a clock of its own."""
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


def _name(key: Key) -> str:
    return f"{key[0]} -> {key[1]}" if key[0] else key[1]


# --- clocks ---------------------------------------------------------------------------------------


def _by_steady_clock(
    streams: Mapping[Key, tuple[Int64[np.ndarray, " n"], Int64[np.ndarray, " n"]]],
) -> dict[Key, StreamTimes]:
    """Stamps and log times of streams -> their stamps by the clock of the log as it was at the end.

    Log times are made steady first: where they jump, a median period has passed. By that clock each stream's own clock
    is watched. Of the parts between its steps the one that agrees best with the log is right, and the others follow it.
    """
    logs = {key: log if _says_when(stamps, log) else stamps for key, (stamps, log) in streams.items()}
    jumps = {key: _jumps(log) for key, log in logs.items()}
    by_period = sorted((jump for found in jumps.values() for jump in found), key=lambda jump: jump.period_ns)
    dated = {}
    for key, (stamps, _) in streams.items():
        steady = logs[key].copy()
        for jump in jumps[key]:
            same = next(each for each in by_period if abs(each.by_ns - jump.by_ns) < _SET_BACK_S * 1e9)
            steady[: jump.at] += same.by_ns  # that of the densest stream is the most exact
        dated[key] = _dated(stamps, steady)
    return dated


def _says_when(stamps: Int64[np.ndarray, " n"], log: Int64[np.ndarray, " n"]) -> bool:
    """Whether log times are times: converters write zeros, or count messages."""
    return bool(float(np.ptp(log)) * 100 >= min(float(np.ptp(stamps)), 1e9 * len(stamps)))


class _Jump(NamedTuple):
    at: int
    by_ns: int
    period_ns: int


def _jumps(log: Int64[np.ndarray, " n"]) -> list[_Jump]:
    """Where log times jump back, or ahead by more than a day."""
    apart = np.diff(log)
    at = np.flatnonzero((apart < -_SET_BACK_S * 1e9) | (apart > SET_AHEAD_S * 1e9))
    if not len(at):
        return []
    period_ns = int(np.median(np.delete(apart, at))) if len(at) < len(apart) else 0
    return [_Jump(int(i) + 1, int(apart[i]) - period_ns, period_ns) for i in at]


def _dated(stamps: Int64[np.ndarray, " n"], steady: Int64[np.ndarray, " n"]) -> StreamTimes:
    """Stamps of one stream by the steady clock of their log times."""
    clock, odd, begins = ClockOfStream(), np.zeros(len(stamps), bool), [0]
    for index, (time_ns, logged_ns) in enumerate(zip(stamps.tolist(), steady.tolist(), strict=True)):
        told = clock.take(time_ns, logged_ns)
        odd[index] = told == "odd"
        if told == "stepped":
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
