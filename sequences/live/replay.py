"""A recording, published as the topics of a running system, in real time."""

from __future__ import annotations

import heapq
import struct
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from filtering.errors import VaporTrackError, require_within
from sequences.errors import SequenceError
from sequences.live.transport import Publish, Transport
from sequences.recordings.bag import Bag
from sequences.recordings.message_definitions import begins_with_stamp, decoder, encoder
from sequences.recordings.source import TF_STATIC, RawMessage

_CLOCK, _CLOCK_TYPE = "/clock", "rosgraph_msgs/Clock"
_TFS = "tf2_msgs/TFMessage"
_CLOCK_EVERY_NS = 5_000_000
_LONGEST_SLEEP_S = 0.1
_CDR_HEADER = 4  # bytes
_STAMP = struct.Struct("<iI")  # a header begins with it


@dataclass(frozen=True)
class ReplayOptions:
    """How to publish a recording."""

    rate: float = 1.0
    """How many seconds of the recording pass in one second."""
    loop: bool = False
    """Start over at the end, again and again."""
    clock: bool = False
    """Publish the time of the recording on /clock, too, for nodes with use_sim_time."""
    restamp: bool = False
    """Shift stamps to now, by as much as the times at which messages were logged: those of the headers that messages
    begin with, and of transforms."""
    delay_s: float = 1.0
    """Seconds to wait before the first message, so that subscribers find the topics."""

    def __post_init__(self) -> None:
        require_within(self, rate=(1e-3, 1e3), delay_s=(0.0, 3600.0))


class Replayed(NamedTuple):
    """How many messages were published so far, and how many times the recording came to its end."""

    messages: int
    rounds: int


def replay(
    path: Path,
    transport: Transport,
    options: ReplayOptions | None = None,
    *,
    notify: Callable[[str], None] = lambda _: None,
) -> Iterator[Replayed]:
    """Publish all messages of a recording at the pace of their log times; yields the progress after each.

    `notify` is called with the topics that are not published (not of ROS 2's encoding, Foxglove's transforms, a second
    clock), and once for every topic with messages that cannot be published. Raises SequenceError where the recording
    cannot be read, or nothing in it can be published.
    """
    options = options or ReplayOptions()
    bag = Bag(path)
    topics = {
        name: topic
        for name, topic in bag.topics.items()
        if topic.encoding == "cdr" and topic.num_messages and not topic.is_foxglove_tf
        if not (options.clock and name == _CLOCK)
    }
    if not topics:
        raise SequenceError(f"{path}: no topic of ROS 2 (CDR), expected messages that can be published")
    if others := [name for name in bag.topics if name not in topics]:
        notify(f"not published: {', '.join(others)}")
    publish: dict[str, Publish] = {
        name: transport.advertise(name, topic.type, latched=name == TF_STATIC) for name, topic in topics.items()
    }
    tick = transport.advertise(_CLOCK, _CLOCK_TYPE) if options.clock else None
    latched = [raw.data for raw in bag.messages([TF_STATIC])] if TF_STATIC in topics else []
    if latched:  # late subscribers get the last message only: it must have all transforms
        publish[TF_STATIC](_merged(latched))
    time.sleep(options.delay_s)
    messages = rounds = 0
    damaged: set[str] = set()
    while True:
        pace = _Pace(options.rate, tick)
        streams = [bag.messages([name]) for name in topics if name != TF_STATIC]  # a file may have one after the other
        for raw in heapq.merge(*streams, key=lambda raw: raw.log_time_ns):
            if raw.type != topics[raw.topic].type:  # Foxglove's transforms, renamed to /tf
                continue
            shift_ns = pace.wait_for(raw.log_time_ns) - raw.log_time_ns
            try:
                publish[raw.topic](_as_published(raw, shift_ns if options.restamp else 0))
            except VaporTrackError as error:
                if raw.topic not in damaged:
                    damaged.add(raw.topic)
                    notify(f"{raw.topic}: message logged at {raw.log_time_ns} ns is not published: {error}")
                continue
            messages += 1
            yield Replayed(messages, rounds)
        rounds += 1
        if not options.loop:
            return
        yield Replayed(messages, rounds)


class _Pace:
    """Waits until messages are due, by the log time since the first one."""

    def __init__(self, rate: float, tick: Publish | None) -> None:
        self._rate, self._tick = rate, tick
        self._first_ns: int | None = None
        self._begin_s, self._begin_ns = time.monotonic(), time.time_ns()
        self._ticked_ns = 0

    def wait_for(self, log_time_ns: int) -> int:
        """Wait until a message is due; returns its due time by the clock of this machine."""
        if self._first_ns is None:
            self._first_ns = log_time_ns
        due_s = (log_time_ns - self._first_ns) * 1e-9 / self._rate
        while (left_s := self._begin_s + due_s - time.monotonic()) > 0:
            self._publish_time()
            most_s = _CLOCK_EVERY_NS * 1e-9 if self._tick is not None else _LONGEST_SLEEP_S
            time.sleep(min(left_s, most_s))
        self._publish_time()
        return self._begin_ns + round(due_s * 1e9)

    def _publish_time(self) -> None:
        if self._tick is None or self._first_ns is None:
            return
        now_ns = self._first_ns + round((time.monotonic() - self._begin_s) * self._rate * 1e9)
        if now_ns - self._ticked_ns >= _CLOCK_EVERY_NS:
            self._ticked_ns = now_ns
            sec, nanosec = divmod(now_ns, 1_000_000_000)
            self._tick(encoder(_CLOCK_TYPE)({"clock": {"sec": sec, "nanosec": nanosec}}))


def _merged(latched: list[bytes]) -> bytes:
    """All transforms of several messages in one, the latest of each child; damaged messages are left out."""
    found: dict[str, Any] = {}
    for data in latched:
        with suppress(Exception):  # damaged bytes raise any
            found |= {t.child_frame_id: t for t in decoder(_TFS)(data).transforms}
    return encoder(_TFS)({"transforms": [*found.values()]})


def _as_published(raw: RawMessage, shift_ns: int) -> bytes:
    """The bytes of a message, with later stamps in its header or transforms. Raises SequenceError for damaged bytes."""
    if len(raw.data) <= _CDR_HEADER or not raw.data[1] & 1:
        raise SequenceError(f"{len(raw.data)} bytes, expected little-endian CDR")
    if not shift_ns:
        return raw.data
    if raw.type == _TFS:
        try:
            transforms = decoder(_TFS)(raw.data).transforms
        except Exception as error:  # damaged bytes raise any
            raise SequenceError(f"no {_TFS}: {type(error).__name__}: {error}") from error
        for transform in transforms:
            stamp = transform.header.stamp
            stamp.sec, stamp.nanosec = _shifted(stamp.sec, stamp.nanosec, shift_ns)
        return encoder(_TFS)({"transforms": transforms})
    end = _CDR_HEADER + _STAMP.size
    if len(raw.data) < end or not begins_with_stamp(raw.type, raw.definition):
        return raw.data
    sec, nanosec = _STAMP.unpack_from(raw.data, _CDR_HEADER)
    stamp = _shifted(sec, nanosec, shift_ns)
    return raw.data[:_CDR_HEADER] + _STAMP.pack(*stamp) + raw.data[end:]


def _shifted(sec: int, nanosec: int, shift_ns: int) -> tuple[int, int]:
    return divmod(sec * 1_000_000_000 + nanosec + shift_ns, 1_000_000_000)
