"""A recording, published as the topics of a running system, in real time."""

from __future__ import annotations

import struct
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

from filtering.errors import require_within
from sequences.errors import SequenceError
from sequences.live.transport import Publish, Transport
from sequences.recordings.bag import Bag
from sequences.recordings.message_definitions import DEFINITIONS, decoder, encoder
from sequences.recordings.source import TF_STATIC, RawMessage

_CLOCK, _CLOCK_TYPE = "/clock", "rosgraph_msgs/Clock"
_TFS = "tf2_msgs/TFMessage"
_CLOCK_EVERY_NS = 5_000_000
_LONGEST_SLEEP_S = 0.1


@dataclass(frozen=True)
class ReplayOptions:
    """How to publish a recording."""

    rate: float = 1.0
    """How many seconds of the recording pass in one second."""
    loop: bool = False
    """Begin anew at the end, again and again."""
    clock: bool = False
    """Publish the time of the recording on /clock as well, for nodes with use_sim_time."""
    restamp: bool = False
    """Shift the stamps of headers to now, by as much as the times at which messages were logged."""
    delay_s: float = 1.0
    """Seconds to wait before the first message, so that subscribers find the topics."""

    def __post_init__(self) -> None:
        require_within(self, rate=(1e-3, 1e3), delay_s=(0.0, 3600.0))


class Replayed(NamedTuple):
    """What was published so far.

    Attributes:
        messages: How many messages.
        rounds: How often the recording came to its end.
    """

    messages: int
    rounds: int


def replay(
    path: Path,
    transport: Transport,
    options: ReplayOptions | None = None,
    *,
    tell: Callable[[str], None] = lambda _: None,
) -> Iterator[Replayed]:
    """Publish all messages of a recording when they were logged; gives what was published so far, after each.

    Args:
        path: MCAP file or rosbag2 folder.
        transport: The system to publish in.
        options: How.
        tell: Told which topics cannot be published, as they are not of ROS 2's encoding.

    Raises:
        SequenceError: the recording cannot be read, or nothing in it can be published.
    """
    options = options or ReplayOptions()
    bag = Bag(path)
    topics = {name: topic for name, topic in bag.topics.items() if topic.encoding == "cdr" and topic.num_messages}
    if not topics:
        raise SequenceError(f"{path}: no topic of ROS 2 (CDR), expected messages that can be published")
    if others := [name for name in bag.topics if name not in topics]:
        tell(f"not published, as not encoded as ROS 2 does: {', '.join(others)}")
    publish: dict[str, Publish] = {
        name: transport.advertise(name, topic.type, latched=name == TF_STATIC) for name, topic in topics.items()
    }
    tick = transport.advertise(_CLOCK, _CLOCK_TYPE) if options.clock else None
    latched = [raw.data for raw in bag.messages([TF_STATIC])] if TF_STATIC in topics else []
    if latched:  # the last message is kept for those who come late: it must have all transforms
        static = _merged(latched)
        publish[TF_STATIC](static)
    time.sleep(options.delay_s)
    messages = rounds = 0
    while True:
        pace = _Pace(options.rate, tick)
        for raw in bag.messages([name for name in topics if name != TF_STATIC]):
            published_ns = pace.wait_for(raw.log_time_ns)
            shift_ns = published_ns - raw.log_time_ns
            publish[raw.topic](_restamped(raw, shift_ns) if options.restamp else raw.data)
            messages += 1
            yield Replayed(messages, rounds)
        rounds += 1
        if not options.loop:
            return
        yield Replayed(messages, rounds)


class _Pace:
    """When messages are due: by the time since the first one."""

    def __init__(self, rate: float, tick: Publish | None) -> None:
        self._rate, self._tick = rate, tick
        self._first_ns: int | None = None
        self._begin_s, self._begin_ns = time.monotonic(), time.time_ns()
        self._ticked_ns = 0

    def wait_for(self, log_time_ns: int) -> int:
        """Wait until a message is due; gives the time at which it is, by the clock of this machine."""
        if self._first_ns is None:
            self._first_ns = log_time_ns
        due_s = (log_time_ns - self._first_ns) * 1e-9 / self._rate
        while (left_s := self._begin_s + due_s - time.monotonic()) > 0:
            self._tell_time()
            most_s = _CLOCK_EVERY_NS * 1e-9 if self._tick is not None else _LONGEST_SLEEP_S
            time.sleep(min(left_s, most_s))
        self._tell_time()
        return self._begin_ns + round(due_s * 1e9)

    def _tell_time(self) -> None:
        if self._tick is None or self._first_ns is None:
            return
        now_ns = self._first_ns + round((time.monotonic() - self._begin_s) * self._rate * 1e9)
        if now_ns - self._ticked_ns >= _CLOCK_EVERY_NS:
            self._ticked_ns = now_ns
            self._tick(encoder(_CLOCK_TYPE)({"clock": _stamp(now_ns)}))


def _merged(latched: list[bytes]) -> bytes:
    """All transforms of several messages in one, the latest of each child."""
    found = {t.child_frame_id: t for data in latched for t in decoder(_TFS)(data).transforms}
    return encoder(_TFS)({"transforms": [_as_fields(t) for t in found.values()]})


def _restamped(raw: RawMessage, shift_ns: int) -> bytes:
    """A message with a later stamp in its header, or in those of its transforms; any other as it is."""
    if raw.type == _TFS:
        transforms = [_as_fields(t) for t in decoder(_TFS)(raw.data).transforms]
        for transform in transforms:
            transform["header"]["stamp"] = _stamp(_ns(**transform["header"]["stamp"]) + shift_ns)
        return encoder(_TFS)({"transforms": transforms})
    if not DEFINITIONS.get(raw.type, "").startswith(("std_msgs/Header", "builtin_interfaces/Time")):
        return raw.data
    begin = struct.Struct("<iI" if raw.data[1] & 1 else ">iI")  # a header begins with its stamp
    stamp = _stamp(_ns(*begin.unpack_from(raw.data, 4)) + shift_ns)
    return raw.data[:4] + begin.pack(*stamp.values()) + raw.data[12:]


def _stamp(time_ns: int) -> dict[str, int]:
    sec, nanosec = divmod(time_ns, 1_000_000_000)
    return {"sec": sec, "nanosec": nanosec}


def _ns(sec: int, nanosec: int) -> int:
    return sec * 1_000_000_000 + nanosec


def _as_fields(value: Any) -> Any:
    """Fields of a message that was read, as they are written."""
    if isinstance(value, SimpleNamespace) or hasattr(value, "__slots__"):
        names = getattr(value, "__slots__", None) or vars(value)
        return {name: _as_fields(getattr(value, name)) for name in names}
    return [_as_fields(each) for each in value] if isinstance(value, list) else value
