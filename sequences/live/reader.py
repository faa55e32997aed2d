"""A running system -> frames: the newest image with the odometry since the one before, as soon as both are there."""

from __future__ import annotations

import math
import queue
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from filtering.motion import Odometry
from filtering.se3 import Poses
from sequences.errors import NotFoundError, SequenceError
from sequences.frame import Frame
from sequences.live.heard import Heard
from sequences.live.transport import Transport
from sequences.options import ReadingOptions, SequenceOptions
from sequences.reading.camera_info import ImageCamera
from sequences.reading.clock_steps import ClockOfStream, Told
from sequences.reading.counts import ImageCounts
from sequences.reading.frame_pairing import FramePairing
from sequences.reading.roles import IMAGE_TYPES, Roles
from sequences.recordings.messages import stamp_ns
from sequences.recordings.source import RawMessage
from sequences.recordings.topics import choose, decode, first

_MOST_WAITING = 16  # images, still encoded, for odometry to come as far
_HEARD_EARLY = ("nav_msgs/Odometry", "sensor_msgs/CameraInfo", "tf2_msgs/TFMessage")  # some are told only once
_SETTLED_S = 1.0  # since the last topic appeared: which are there by themselves is not known before
_ASK_AGAIN_S = 0.2
_SAY_AGAIN_S = 5.0


class LiveReader:
    """Takes the messages of a running system as they come, and gives frames; used by one thread.

    A clock that is set begins a new reading: what leads from the frame before it to the one after it is not known.

    Attributes:
        path: What messages of errors call the system.
        heard: The system's topics.
        roles: Which topic is what.
        streamed: Names of the topics that it takes messages of.
        camera: Of the images.
        readings: How many readings there were so far: frames of different ones have no odometry between them.
    """

    def __init__(self, heard: Heard, options: ReadingOptions) -> None:
        """Find topics, intrinsics and extrinsics among what was heard so far.

        Raises:
            NotFoundError: something is not there yet.
            SequenceError: what is there cannot be used, or there is a choice to make.
        """
        self.path: Path = heard.path
        self.heard = heard
        shared = {name: getattr(options, name) for name in ReadingOptions.__dataclass_fields__}
        self._options = SequenceOptions(**shared, ground_truth_topic="")
        image = choose(heard, "image", IMAGE_TYPES, options.image_topic, required=True)
        assert image is not None
        for topic in heard.topics.values():
            if topic.read_as in _HEARD_EARLY:
                heard.hear(topic.name)
        first(heard, image)  # whose header names the frame of the camera
        self.roles = Roles(heard, self._options, "required", "optional")
        self.camera = ImageCamera(heard, self.roles.camera_info, self.roles.image, undistort=options.undistort)
        self.streamed = list(self.roles.watched)
        for name in self.streamed:
            heard.hear(name)
        self._arrived_ns: dict[int, int] = {}  # by stamp, of the latest images
        self.readings = 0
        self._past_counts, self._past_messages = ImageCounts(0), Counter[str]()
        self._clocks: dict[str, ClockOfStream] = {}
        self._odd: dict[str, list[tuple[RawMessage, SimpleNamespace]]] = {}
        self._links = self.roles.tree_odometry.open() if self.roles.tree_odometry is not None else None
        self._pairing = self._begin()

    def _begin(self) -> FramePairing:
        self.readings += 1
        self._fed: set[str] = set()  # topics that this reading has messages of
        return FramePairing(
            self.path,
            self.roles,
            self._options,
            self.camera,
            0,
            most_waiting=_MOST_WAITING,
            over_gaps=False,
        )

    @property
    def base_from_camera(self) -> Poses:
        """Extrinsics, one pose."""
        assert self.roles.extrinsics is not None
        return self.roles.extrinsics.body_from_camera

    @property
    def counts(self) -> ImageCounts:
        """What became of the images so far."""
        now = self._past_counts + self._pairing.left_out.counts
        return ImageCounts(now.read, now.read, now.used, now.skipped)

    @property
    def problems(self) -> dict[str, str]:
        """Of each reason for which this reading left something out: when that was first, to end a sentence."""
        return self._pairing.left_out.problems

    @property
    def apart(self) -> str | None:
        """What to say where odometry is of another time than all images; None elsewhere."""
        return self._pairing.odometry_apart()

    @property
    def messages_left_out(self) -> Counter[str]:
        """How many messages that are no images were left out so far, by reason."""
        return self._past_messages + self._pairing.left_out.messages

    def take(self, raw: RawMessage) -> bool:
        """Take a message, of whichever topic; what is damaged is counted. Says whether it brought later odometry."""
        before_ns, reading = self.odometry_ns, self.readings
        self._take(raw)
        return self.odometry_ns != before_ns or self.readings != reading

    def _take(self, raw: RawMessage) -> None:
        raw = self.heard.stamped(raw)
        if raw.topic not in self.streamed:
            return
        message = decode(self.heard, raw, tolerate=True)
        is_image = raw.topic == self.roles.image.name
        if message is not None and (time_ns := self._stamp(raw, message)) is not None:
            told = self._clocks.setdefault(raw.topic, ClockOfStream()).take(time_ns, raw.log_time_ns)
            if is_image:
                self._arrived_ns[time_ns] = raw.log_time_ns
            if not self._goes_on(told, raw, message):
                return
        self._feed(raw, message)

    def _goes_on(self, told: Told, raw: RawMessage, message: SimpleNamespace) -> bool:
        """Whether a message belongs to the reading; an odd one waits until it is known whether the clock was set."""
        waiting = self._odd.setdefault(raw.topic, [])
        if told == "odd":
            waiting.append((raw, message))
            if len(waiting) > 2:
                self._pairing.leave_out_odd(waiting.pop(0)[0])
            return False
        if told == "stepped":
            if raw.topic in self._fed:  # else another stream told the same of this clock before
                self._end()
            for each in waiting:
                self._feed(*each)
        else:
            for each in waiting:
                self._pairing.leave_out_odd(each[0])
        waiting.clear()
        return True

    def _end(self) -> None:
        """End this reading, and begin the next."""
        self._past_counts, self._past_messages = self.counts, self.messages_left_out
        self._past_counts.skipped["clock was set"] += self._pairing.num_waiting
        self._pairing = self._begin()

    def _feed(self, raw: RawMessage, message: SimpleNamespace | None) -> None:
        if message is not None:
            self._fed.add(raw.topic)
        try:
            self._pairing.take(raw, message)
            self._pairing.drop_overtaken()
        except SequenceError as error:  # damage that a recording would be refused for
            self._pairing.left_out.message(f"unusable message on {raw.topic}", raw.log_time_ns, str(error))

    def _stamp(self, raw: RawMessage, message: SimpleNamespace) -> int | None:
        """The stamp by which the clock of a stream is watched; None where a message has none that counts."""
        if hasattr(message, "header"):
            return stamp_ns(message.header)
        if self._links is None or raw.topic != self._links.topic:
            return None
        return max((sample.time_ns for sample in self._links.samples(message)[0]), default=None)

    def newest_frame(self) -> Frame | None:
        """The newest image that odometry has come to and that was not given before; None where there is none."""
        while len(self._arrived_ns) > 2 * _MOST_WAITING:
            del self._arrived_ns[next(iter(self._arrived_ns))]
        return self._pairing.newest_frame()

    def arrived_ns(self, time_ns: int) -> int | None:
        """When the image of a stamp came, one of the latest; by the clock that messages are logged by."""
        return self._arrived_ns.get(time_ns)

    @property
    def frame_ns(self) -> int | None:
        """Stamp that the next motion begins at: of the last frame, or a later one that was settled."""
        return self._pairing.previous_ns

    @property
    def odometry_ns(self) -> int | None:
        """Stamp of the latest odometry of this reading; None before any came."""
        span = self._pairing.motion.odometry_span_ns
        return None if span is None else span[1]

    def odom_from_base(self, time_ns: int) -> Poses | None:
        """Pose of the base in the frame of the odometry, one pose; None where it is not known."""
        return self._pairing.motion.odom_from_base(time_ns)

    def moved_until(self, time_ns: int) -> Odometry | None:
        """Motion of the camera since the last frame, see `FramePairing.moved_until`."""
        return self._pairing.moved_until(time_ns)

    def settle(self, time_ns: int) -> None:
        """Have the next motion begin there, see `FramePairing.settle`."""
        self._pairing.settle(time_ns)


def open_live(
    transport: Transport,
    events: queue.SimpleQueue[Any],
    options: ReadingOptions,
    *,
    admit: Callable[[Any], RawMessage | None],
    waiting: Callable[[str], None],
) -> LiveReader:
    """Wait until everything that a reading needs is there.

    Args:
        transport: The system.
        events: Where its messages are put, and whatever else may happen.
        options: What to read.
        admit: Called with every event; gives those that are messages to keep. It may raise to wait no longer.
        waiting: Told what is not there yet: once that is known, and again every five seconds.

    Returns:
        The reader, which was given all that was heard meanwhile.

    Raises:
        SequenceError: what is there cannot be used, or there is a choice to make.
    """
    heard = Heard(transport, events, options=options)
    changed_s, said_s = time.monotonic(), -math.inf
    while True:
        if heard.refresh():
            changed_s = time.monotonic()
        problem = None  # not known before topics have settled
        if time.monotonic() - changed_s >= _SETTLED_S:
            try:
                reader = LiveReader(heard, options)
            except NotFoundError as error:
                problem = str(error).removeprefix(f"{heard.path}: ")
            else:
                for raw in heard.kept():
                    reader.take(raw)
                return reader
        if problem is not None and time.monotonic() - said_s >= _SAY_AGAIN_S:
            said_s = time.monotonic()
            waiting(problem)
        again_s = time.monotonic() + _ASK_AGAIN_S
        while (left_s := again_s - time.monotonic()) > 0:
            try:
                event = events.get(timeout=left_s)
            except queue.Empty:
                break
            if (raw := admit(event)) is not None:
                heard.keep(raw)
