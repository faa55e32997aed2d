"""A running system -> frames: the newest image with the odometry since the one before, as soon as both are there."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import fields
from pathlib import Path
from typing import Any

from filtering.motion import Odometry
from filtering.se3 import Poses
from sequences.errors import NotFoundError, SequenceError
from sequences.frame import Camera, Frame
from sequences.live.sensors import LiveSensors
from sequences.live.topic_buffer import TopicBuffer
from sequences.options import OdometryUse, ReadingOptions, SequenceOptions, pose_of_numbers
from sequences.reading.camera_info import ImageCamera
from sequences.reading.counts import ImageCounts
from sequences.reading.extrinsics import BASES, find_extrinsics
from sequences.reading.frame_pairing import FramePairing
from sequences.reading.rig import IMAGE_TYPES, find_cameras
from sequences.reading.roles import Roles
from sequences.reading.timeline import ClockOfStream, StampKind
from sequences.recordings.messages import stamp_ns
from sequences.recordings.source import TF_STATIC, RawMessage, choose, decode, first

_MOST_WAITING = 16  # images, still encoded, for odometry to come as far
_IN_ORDER_NS = 100_000_000  # that the image of a camera waits for those of others, where their order counts
_HEARD_EARLY = ("nav_msgs/Odometry", "sensor_msgs/CameraInfo", "tf2_msgs/TFMessage")  # some come only once


class LiveReader:
    """Messages of a running system in, frames out; used by one thread.

    A clock that is set begins a new reading: the motion between frames of different readings is unknown.

    Attributes:
        streamed: Names of the topics whose messages it takes.
        readings: Number of readings so far.
        lenses: Of the cameras by name, that of the localized one first.
        base_from_camera: Extrinsics of the camera that is localized, one pose.
        sensors: The inertial unit and the barometer.
    """

    def __init__(
        self,
        heard: TopicBuffer,
        options: ReadingOptions,
        *,
        late_window_s: float = 0.0,
        usual_cameras: Sequence[str] = (),
        odometry: OdometryUse = "required",
    ) -> None:
        """Find topics, intrinsics and extrinsics in the messages so far.

        Args:
            heard: The messages.
            options: What to read.
            late_window_s: An image that is older than the latest frame by at most so much still becomes a frame.
            usual_cameras: Topics that are read where several have images and none is named.
            odometry: Whether it is "required", or "ignored".

        Raises:
            NotFoundError: something is not there yet.
            SequenceError: something cannot be used, or there is a choice to make.
        """
        self.path: Path = heard.path
        self._late_ns, self._in_order_ns = round(late_window_s * 1e9), 0
        self.heard = heard
        shared = {field.name: getattr(options, field.name) for field in fields(ReadingOptions)}
        usual = tuple(name for name in usual_cameras if name in heard.topics)
        if not options.image_topics and not usual:  # all would be heard to choose among them
            choose(heard, "image", IMAGE_TYPES, None, required=True)
        for topic in heard.topics.values():
            if topic.read_as in _HEARD_EARLY:
                heard.hear(topic.name)
        LiveSensors.hear(heard, options)
        for name in options.image_topics or usual:
            if name in heard.topics and heard.topics[name].read_as in IMAGE_TYPES:
                heard.hear(name)
        reading = SequenceOptions(**shared, ground_truth_topic="")
        cameras, _ = find_cameras(heard, reading, usual)
        for camera in cameras:
            first(heard, camera.image)  # whose header names the frame of the camera
        self.roles = Roles(heard, reading, odometry, "optional", usual_cameras=usual)
        self.base_from_camera = self._find_base(options)
        self.sensors = LiveSensors(heard, options, self.roles)
        self.lenses = {
            camera.name: ImageCamera(heard, camera.info, camera.image, undistort=options.undistort)
            for camera in self.roles.cameras
        }
        self.streamed = list(self.roles.watched)
        for name in self.streamed:
            heard.hear(name)
        self._odometry_at_first = set(self._odometry_topics)
        self._arrived_ns: dict[int, int] = {}  # by stamp, of the latest images
        self.readings = 0
        self._past_counts, self._past_messages = ImageCounts(0), Counter[str]()
        self._clocks: dict[str, ClockOfStream] = {}
        self._odd: dict[str, list[tuple[RawMessage, Any]]] = {}
        self._tree = self.roles.tree_odometry.open() if self.roles.tree_odometry is not None else None
        self._pairing = self._begin()

    def _begin(self) -> FramePairing:
        self.readings += 1
        self._fed: set[str] = set()  # topics that this reading has messages of
        pairing = FramePairing(
            self.roles, self.lenses, 0, most_waiting=_MOST_WAITING, over_gaps=False, late_ns=self._late_ns
        )
        pairing.in_order_ns = self._in_order_ns
        return pairing

    @property
    def camera(self) -> Camera | None:
        """Intrinsics of the camera that is localized, undistorted; None where unknown."""
        return next(iter(self.lenses.values())).camera

    @property
    def has_odometry(self) -> bool:
        """Whether it reads odometry."""
        return self.roles.extrinsics is not None

    @property
    def _odometry_topics(self) -> list[str]:
        return [topic.name for topic in self.heard.topics.values() if topic.read_as == "nav_msgs/Odometry"]

    @property
    def notices(self) -> list[str]:
        """Sentences for users: odometry that came too late, where it reads none."""
        late = [] if self.has_odometry else [n for n in self._odometry_topics if n not in self._odometry_at_first]
        return [f"{name} came after the start, and is not used: it is after a restart (--odometry)" for name in late]

    def _find_base(self, options: ReadingOptions) -> Poses:
        """The camera on the robot; without odometry on base_link, or else the robot is the camera."""
        if self.roles.extrinsics is not None:
            return self.roles.extrinsics.body_from_camera
        if options.base_from_camera is not None:
            return pose_of_numbers(options.base_from_camera)
        if TF_STATIC in self.heard:
            first(self.heard, self.heard.topics[TF_STATIC])  # which comes as soon as it is subscribed
        for base in BASES:
            with suppress(NotFoundError):
                return find_extrinsics(self.heard, base, self.roles.camera_frame).body_from_camera
        return Poses.identity()

    @property
    def counts(self) -> ImageCounts:
        """Counts of all images so far."""
        now = self._past_counts + self._pairing.skipped.counts
        return ImageCounts(now.read, now.read, now.used, now.skipped)

    @property
    def problems(self) -> dict[str, str]:
        """Time and problem of the first thing that this reading left out for each reason, to end a sentence."""
        return self._pairing.skipped.problems

    @property
    def apart(self) -> str | None:
        """See `odometry_apart`."""
        return self._pairing.odometry_apart()

    @property
    def skipped_messages(self) -> Counter[str]:
        """How many messages other than images were left out so far, by reason."""
        return self._past_messages + self._pairing.skipped.messages

    def take(self, raw: RawMessage) -> bool:
        """Take a message; a damaged one is counted. Returns whether it brought later odometry."""
        before_ns, reading = self.odometry_ns, self.readings
        self._take(raw)
        return self.odometry_ns != before_ns or self.readings != reading

    def _take(self, raw: RawMessage) -> None:
        raw = self.heard.keep(raw)
        self.sensors.take(raw)
        if raw.topic not in self.streamed:
            return
        message = decode(self.heard, raw, tolerate=True)
        is_image = raw.topic in self.lenses
        if message is not None and (time_ns := self._stamp(raw, message)) is not None:
            kind = self._clocks.setdefault(raw.topic, ClockOfStream()).take(time_ns, raw.log_time_ns)
            if is_image:
                self._arrived_ns[time_ns] = raw.log_time_ns
            if not self._goes_on(kind, raw, message):
                return
        self._feed(raw, message)

    def _goes_on(self, kind: StampKind, raw: RawMessage, message: Any) -> bool:
        """Whether a message belongs to the reading; an odd one waits until it is known whether the clock was set."""
        waiting = self._odd.setdefault(raw.topic, [])
        if kind == "odd":
            waiting.append((raw, message))
            if len(waiting) > 2:
                self._pairing.leave_out_odd(waiting.pop(0)[0])
            return False
        if kind == "stepped":
            if raw.topic in self._fed:  # else another stream showed the same step before
                self._end()
            for each in waiting:
                self._feed(*each)
        else:
            for each in waiting:
                self._pairing.leave_out_odd(each[0])
        waiting.clear()
        return True

    def _end(self) -> None:
        self._past_counts, self._past_messages = self.counts, self.skipped_messages
        self._past_counts.skipped["clock was set"] += self._pairing.num_waiting
        self._pairing = self._begin()

    def _feed(self, raw: RawMessage, message: Any) -> None:
        if message is not None:
            self._fed.add(raw.topic)
        try:
            self._pairing.take(raw, message)
            self._pairing.drop_overtaken()
        except SequenceError as error:  # for which a recording would be refused
            self._pairing.skipped.message(f"unusable message on {raw.topic}", raw.log_time_ns, str(error))

    def _stamp(self, raw: RawMessage, message: Any) -> int | None:
        """The stamp by which the clock of a stream is watched; None where a message has none that counts."""
        if hasattr(message, "header"):
            return stamp_ns(message.header)
        if self._tree is None or raw.topic != self._tree.topic:
            return None
        return max((sample.time_ns for sample in self._tree.samples(message)[0]), default=None)

    def newest_frame(self) -> Frame | None:
        """The newest image that odometry has reached and that was not returned before; None where there is none.

        It may be older than the last frame; its odometry then leads from the frame before it in time.
        """
        self._forget_arrivals()
        return self._pairing.newest_frame()

    def take_in_order(self) -> None:
        """Take no image from now on that is older than the latest frame; cameras wait a little for each other."""
        self._late_ns = self._pairing.frames.late_ns = 0
        self._in_order_ns = self._pairing.in_order_ns = _IN_ORDER_NS

    def ready_frames(self) -> Iterator[Frame]:
        """All images that odometry has reached and that were not returned before, in order of time."""
        self._forget_arrivals()
        return self._pairing.ready_frames()

    def give_up(self, reason: str) -> None:
        """Count a frame of this reading as skipped after all."""
        counts = self._pairing.skipped.counts
        counts.used -= 1
        counts.skipped[reason] += 1

    def _forget_arrivals(self) -> None:
        while len(self._arrived_ns) > 2 * _MOST_WAITING:
            del self._arrived_ns[next(iter(self._arrived_ns))]

    def arrived_ns(self, time_ns: int) -> int | None:
        """Log time of one of the latest images, by its stamp; None of others."""
        near = (self._arrived_ns.get(time_ns - late_ns) for late_ns in range(len(self.lenses)))  # see FramePairing
        return next((arrived_ns for arrived_ns in near if arrived_ns is not None), None)

    @property
    def frame_ns(self) -> int | None:
        """Stamp at which the next motion begins: the latest of a frame, or a later one given to `settle`."""
        return self._pairing.frames.latest_ns

    @property
    def odometry_ns(self) -> int | None:
        """Stamp of the latest odometry of this reading; None before any came."""
        span = self._pairing.motion.odometry_span_ns
        return None if span is None else span[1]

    @property
    def latest_ns(self) -> int | None:
        """The same; without odometry the stamp of the latest frame."""
        return self.odometry_ns if self.has_odometry else self.frame_ns

    def odom_from_base(self, time_ns: int) -> Poses | None:
        """Pose of the base in the frame of the odometry, one pose; None where it is not known."""
        motion = self._pairing.motion
        # A frame of the same time as another camera's is some nanoseconds later than its image.
        pose = motion.odom_from_base(time_ns)
        return motion.odom_from_base(time_ns - len(self.lenses)) if pose is None and len(self.lenses) > 1 else pose

    def moved_until(self, time_ns: int) -> Odometry | None:
        """See `FrameTimes.moved_until`."""
        return self._pairing.frames.moved_until(time_ns)

    def settle(self, time_ns: int) -> None:
        """See `FrameTimes.settle`."""
        self._pairing.frames.settle(time_ns)
