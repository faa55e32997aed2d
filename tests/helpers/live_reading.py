"""Who reads a running system, message by message, and messages of walks to say."""

import queue
import struct
from collections.abc import Callable, Iterable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from sequences.errors import NotFoundError
from sequences.frame import Frame
from sequences.live.frames import LiveFrames
from sequences.live.reader import LiveReader
from sequences.live.topic_buffer import TopicBuffer
from sequences.options import OdometryUse, ReadingOptions
from sequences.recordings.source import RawMessage
from tests.helpers import tf_files
from tests.helpers.fake_transport import FakeTransport, offering
from tests.helpers.sequence_files import BEGIN_NS, MS

SECOND = 10**9


class Robot:
    """A running system, and who reads it: opens it as soon as everything is there, and asks for the frames."""

    def __init__(
        self,
        transport: FakeTransport,
        options: ReadingOptions | None = None,
        *,
        late_window_s: float = 0.0,
        odometry: OdometryUse = "required",
        made: Callable[[LiveReader], LiveFrames] | None = None,
    ) -> None:
        """Of a system; frames are those of the reader, or those that are `made` of them."""
        self.transport, self.options, self.late_window_s = transport, options or ReadingOptions(), late_window_s
        self.odometry, self._made = odometry, made
        self.maker: Any = None
        self.events: queue.SimpleQueue[RawMessage] = queue.SimpleQueue()
        self.heard = TopicBuffer(transport, self.events, options=self.options)
        self.opened: LiveReader | None = None
        self.frames: list[tuple[int, Frame]] = []  # with the number of the reading
        self.wanting: list[str] = []  # what was not there yet

    @property
    def reader(self) -> LiveReader:
        assert self.opened is not None, self.wanting
        return self.opened

    def try_to_open(self) -> None:
        self.heard.refresh()
        if self.opened is not None:
            return
        try:
            self.opened = LiveReader(self.heard, self.options, late_window_s=self.late_window_s, odometry=self.odometry)
        except NotFoundError as error:
            self.wanting.append(str(error))
            return
        self.maker = None if self._made is None else self._made(self.opened)
        for raw in self.heard.kept():
            self._take(raw, ask=True)

    def live_through(self, raws: Iterable[RawMessage], *, ask: bool = True) -> None:
        """Have messages said, one by one; frames are asked for after each, or not at all."""
        for raw in raws:
            self.try_to_open()
            self.transport.say(raw)
            while not self.events.empty():
                heard = self.events.get()
                if self.opened is None:
                    self.heard.keep(heard)
                else:
                    self._take(heard, ask=ask)
        self.try_to_open()

    def _take(self, raw: RawMessage, *, ask: bool) -> None:
        self.reader.take(raw)
        if self.maker is not None:
            self.maker.advance()
        frame = (self.maker or SimpleNamespace(newest=self.reader.newest_frame)).newest() if ask else None
        if frame is not None:
            self.frames.append((self.reader.readings, frame))

    @property
    def times_ms(self) -> list[float]:
        """Stamps of the frames, after the first image of a walk."""
        return [(frame.time_ns - BEGIN_NS) / MS for _, frame in self.frames]


def lived(raws: list[RawMessage], options: ReadingOptions | None = None) -> Robot:
    """A system that has said all of the messages."""
    robot = Robot(offering(raws), options)
    robot.live_through(raws)
    return robot


def stamp_of(raw: RawMessage) -> int:
    sec, nanosec = struct.unpack_from("<iI", raw.data, 4)
    return sec * SECOND + nanosec


def stamped(raw: RawMessage, time_ns: int) -> RawMessage:
    """A message whose header has another stamp; it arrives when it did."""
    return raw._replace(data=raw.data[:4] + struct.pack("<iI", *divmod(time_ns, SECOND)) + raw.data[12:])


def at_ms(raw: RawMessage) -> float:
    """When a message arrives, after the first image of a walk."""
    return (raw.log_time_ns - BEGIN_NS) / MS


def require_same(frames: Iterable[Frame], expected: Iterable[Frame]) -> None:
    """Fail where frames differ in anything but the true poses, which a running system does not have."""
    for frame, other in zip(frames, expected, strict=True):
        assert frame.time_ns == other.time_ns
        assert frame.camera == other.camera
        np.testing.assert_array_equal(frame.image, other.image)
        assert (frame.odometry is None) == (other.odometry is None)
        if frame.odometry is not None and other.odometry is not None:
            moved, expected_moved = frame.odometry.previous_from_current, other.odometry.previous_from_current
            np.testing.assert_array_equal(moved.as_matrix(), expected_moved.as_matrix())
            np.testing.assert_array_equal(frame.odometry.covariance, other.odometry.covariance)
            assert frame.odometry.duration_s == other.odometry.duration_s


def tf_record(path: Path, *, num_images: int = 12, tf_topics: Iterable[str] = ("/tf",)) -> Path:
    """A walk whose odometry is on tf only: of one robot or several."""
    parts = [tf_files.images(num_images)]
    for topic in tf_topics:
        parts.append(tf_files.mounted(topic=f"{topic}_static"))
        parts.append(tf_files.tf("odom", "base_link", tf_files.stamps(num_images), tf_files.body, topic))
    return tf_files.record(path, *parts)
