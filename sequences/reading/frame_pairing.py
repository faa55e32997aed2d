"""The state of one reading: images wait, still encoded, until odometry and true poses have come as far.

Of a recording, each topic beside the images is read as far as an image needs it, however late it was logged.
"""

from __future__ import annotations

import heapq
from bisect import bisect_left
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from itertools import count
from typing import Any, NamedTuple

from sequences.errors import SequenceError
from sequences.frame import Frame
from sequences.images.headers import why_skipped
from sequences.images.video import Picture
from sequences.reading.camera_info import ImageCamera
from sequences.reading.counts import NOT_COME, NOT_INCREASING, ODD, OUTSIDE, OVERTAKEN, SkipCounter, uncovered
from sequences.reading.frame_times import FrameTimes
from sequences.reading.motion import MotionOfCamera, odometry_apart
from sequences.reading.roles import Roles
from sequences.reading.timeline import Dated, Timeline
from sequences.recordings.messages import stamp_ns
from sequences.recordings.source import RawMessage

_MOST_WAITING = 64
_HORIZON_NS = 10 * 10**9  # ahead of an image, within which the poses of its time are expected
_FORGET_EVERY = 500  # messages


class RequestedSegment:
    """The segment of a recording that is asked for, in seconds after its first image.

    Attributes:
        is_stopped: Whether no more frames are asked for.
    """

    def __init__(self, begin_ns: int, start_s: float, duration_s: float | None) -> None:
        self.is_stopped = False
        self._begin_ns, self._start_s = begin_ns, start_s
        self._first_ns = begin_ns + round(start_s * 1e9) if start_s else None
        self._last_ns = None if duration_s is None else begin_ns + round((start_s + duration_s) * 1e9)

    def has(self, time_ns: int) -> bool:
        """Whether an image is of the segment; the first packet of a video need not hold its first image."""
        return (self._first_ns is None or time_ns >= self._first_ns) and not self.ends_before(time_ns)

    def ends_before(self, time_ns: int) -> bool:
        """Whether all images from a time on lie behind the segment."""
        return self.is_stopped or (self._last_ns is not None and time_ns > self._last_ns)

    def begins_after(self, end_ns: int) -> str | None:
        """Where the last image, of this stamp, lies before the segment: what is expected instead."""
        if self._first_ns is None or self._first_ns <= end_ns:
            return None
        lasts_s = (end_ns - self._begin_ns) * 1e-9
        return f"the images last {lasts_s:.1f} s, expected --start-s below that, not {self._start_s:g}"


class _Taken(NamedTuple):
    camera: str
    picture: Picture


class FramePairing:
    """Messages in, in the order of a recording; frames out, in the order of their stamps but for late ones.

    Attributes:
        frames: Times of the latest frames, and the motion between them.
        in_order_ns: Images are also held until all cameras have come as far, or one so much later has; 0 for never.
        reaches: Whether odometry and true poses have come as far as a stamp; `MotionStreams` reads on first.
        frames_span_ns: Stamps of the first and the last frame; None before any.
        used: How many images of each camera became frames.
    """

    def __init__(
        self,
        roles: Roles,
        lenses: Mapping[str, ImageCamera],
        num_images: int,
        *,
        begin_ns: int = 0,
        most_waiting: int = _MOST_WAITING,
        lateness_ns: int = 0,
        over_gaps: bool = True,
        late_ns: int = 0,
    ) -> None:
        """Set up a reading that took no message yet.

        Args:
            roles: Roles of the topics.
            lenses: The lens of each camera that is read, by its name.
            num_images: Number of images that the recording states.
            begin_ns: Stamp of the first image, from which the segment asked for is counted.
            most_waiting: Images held, still encoded, until odometry and true poses reach them.
            lateness_ns: Images are held until one so much later has come, to order them by their stamps.
            over_gaps: Whether odometry leads over times without messages.
            late_ns: See `FrameTimes`.
        """
        self._most_waiting, self._lateness_ns, self.in_order_ns = most_waiting, lateness_ns, 0
        self.skipped = SkipCounter(num_images)
        self.segment = RequestedSegment(begin_ns, roles.options.start_s, roles.options.duration_s)
        self.motion = MotionOfCamera(roles, self.skipped, over_gaps=over_gaps)
        self.frames = FrameTimes(self.motion, late_ns)
        self.reaches: Callable[[int], bool] = self.motion.reaches
        self._roles, self._lenses = roles, lenses
        self._counts = self.skipped.counts
        self._cameras = {camera.name: camera for camera in roles.cameras if camera.name in lenses}
        self._infos = {camera.info.name: camera.name for camera in self._cameras.values() if camera.info is not None}
        self._streams = {name: camera.open_images(roles.path) for name, camera in self._cameras.items()}
        self.used = Counter[str]()  # images by camera
        # A heap: order, number of images before, stamp, camera, and message, None for a lost one.
        self._waiting: list[tuple[int, int, int, str, Any]] = []
        self._orders_ns: dict[str, int] = {}  # of the latest packet of each video
        self._last_ns: dict[str, int] = {}  # stamp of the latest frame of each camera
        self._decoded: list[tuple[int, int, _Taken]] = []  # a heap, beside videos: stamp, number, picture
        self._decoded_ns: dict[str, int] = {}  # stamp of the latest picture of each camera
        self._numbers = count()
        self._images_ns: tuple[int, int] | None = None  # earliest and latest stamp
        self._came_ns: dict[str, int] = {}  # latest stamp of each camera
        self._overtaken: list[_Taken] = []  # by a newer frame, in the order of stamps
        self.frames_span_ns: tuple[int, int] | None = None

    def take(self, raw: RawMessage, message: Any) -> None:
        """Take a message; None for undecodable bytes. Raises SequenceError where a fixed camera moves."""
        if raw.topic in self._cameras:
            self._counts.read += 1
            self._take_image(raw, message)
        else:
            if message is not None and raw.topic in self._infos:
                try:
                    self._lenses[self._infos[raw.topic]].take(message)
                except SequenceError as error:
                    self.skipped.message("unusable intrinsics", raw.log_time_ns, str(error))
            self.motion.take(raw, message)

    def take_dated(self, dated: Dated) -> None:
        """Take a message of a recording without its odd stamps."""
        if dated.num_odd:
            self.leave_out_odd(dated.raw, dated.num_odd)
        if dated.stamps_ns or not dated.num_odd:
            self.take(dated.raw, dated.message)

    def leave_out_odd(self, raw: RawMessage, number: int = 1) -> None:
        """Leave out a message whose stamp is unlike those around it, or so many transforms of it."""
        if raw.topic in self._cameras:
            self._counts.read += 1
            self._leave_out_image(raw.topic, ODD, raw.log_time_ns)
            return
        for _ in range(number):
            self.skipped.message(f"{ODD} on {raw.topic}", raw.log_time_ns)

    def _leave_out_image(self, camera: str, reason: str, time_ns: int) -> None:
        self.skipped.image(reason, time_ns)
        if self._streams[camera].remembers:  # those after it build on it
            self._wait(camera, self._latest_ns, None)

    def _take_image(self, raw: RawMessage, message: Any) -> None:
        if message is None:
            self._leave_out_image(raw.topic, "undecodable image", raw.log_time_ns)
            return
        time_ns = stamp_ns(message.header)
        begin_ns, end_ns = self._images_ns or (time_ns, time_ns)
        self._images_ns = min(begin_ns, time_ns), max(end_ns, time_ns)
        self._came_ns[raw.topic] = max(time_ns, self._came_ns.get(raw.topic, time_ns))
        if self._streams[raw.topic].remembers or self.segment.has(time_ns):
            self._wait(raw.topic, time_ns, message)
        else:
            self._counts.skipped[OUTSIDE] += 1

    def _wait(self, camera: str, time_ns: int, message: Any) -> None:
        """Keep an image: in the order of stamps, or as it came where those after it build on it."""
        order = time_ns
        if self._streams[camera].remembers:
            order = self._orders_ns[camera] = max(time_ns, self._orders_ns.get(camera, time_ns))
        heapq.heappush(self._waiting, (order, self._counts.read, time_ns, camera, message))

    def ready_frames(self, *, at_end: bool = False) -> Iterator[Frame]:
        """Frames of the images that need to wait no longer."""
        for taken in self._in_order(at_end=at_end):
            if (frame := self._frame_asked_for(taken)) is not None:
                yield frame

    def _in_order(self, *, at_end: bool) -> Iterator[_Taken]:
        """Pictures in the order of their stamps: decoders give those of videos later than others come."""
        videos = [name for name, stream in self._streams.items() if stream.remembers and len(self._cameras) > 1]
        if not videos:
            yield from self._ready_pictures(at_end=at_end)
            return
        for taken in self._ready_pictures(at_end=at_end):
            self._decoded_ns[taken.camera] = taken.picture.time_ns
            heapq.heappush(self._decoded, (taken.picture.time_ns, next(self._numbers), taken))
        reached_ns = min(self._decoded_ns.get(name, -1 << 63) for name in videos)
        most = self._most_waiting * len(self._cameras)
        while self._decoded and (at_end or self._decoded[0][0] <= reached_ns or len(self._decoded) > most):
            yield heapq.heappop(self._decoded)[2]

    def newest_frame(self) -> Frame | None:
        """The frame of the newest image that needs to wait no longer and can be used.

        Older ones are given where there is no newer one, and skipped where they are too late.
        """
        ready = sorted([*self._overtaken, *self._ready_pictures()], key=lambda taken: taken.picture.time_ns)
        frame: Frame | None = None
        while ready and frame is None:
            newest = {taken.camera: number for number, taken in enumerate(ready)}
            turn = min(newest, key=lambda camera: self._turn(ready[newest[camera]]))
            frame = self._frame_asked_for(ready.pop(newest[turn]))
        after = bisect_left(ready, self.frames.earliest_ns, key=lambda taken: taken.picture.time_ns)
        self._overtaken = ready[max(after, len(ready) - self._most_waiting) :]
        self._counts.skipped[OVERTAKEN] += len(ready) - len(self._overtaken)
        return frame

    def _turn(self, newest: _Taken) -> tuple[bool, int]:
        """A key for the cameras' newest images: new ones first, that of the camera first whose last frame is oldest."""
        last_ns, time_ns = self._last_ns.get(newest.camera, -1), newest.picture.time_ns
        return time_ns <= last_ns, last_ns if time_ns > last_ns else -time_ns

    def drop_overtaken(self) -> None:
        """Skip the oldest of the images that wait where there are too many: newer ones are asked for, but not yet."""
        while len(self._waiting) > self._most_waiting * len(self._cameras):
            _, _, time_ns, camera, message = heapq.heappop(self._waiting)
            reason = OVERTAKEN if self.motion.reaches(time_ns) else NOT_COME
            for _ in self._streams[camera].take(time_ns, message):
                self._counts.skipped[reason] += 1

    def _ready_pictures(self, *, at_end: bool = False) -> Iterator[_Taken]:
        while self._waiting and self._is_due(self._waiting[0], at_end):
            _, _, time_ns, camera, message = heapq.heappop(self._waiting)
            yield from (_Taken(camera, picture) for picture in self._streams[camera].take(time_ns, message))
        for camera, stream in self._streams.items() if at_end else ():
            yield from (_Taken(camera, picture) for picture in stream.finish())

    @property
    def cameras(self) -> list[str]:
        """Names of the cameras that are read."""
        return [*self._cameras]

    @property
    def is_over(self) -> bool:
        """Whether all images that may yet come lie behind the segment asked for."""
        return self._images_ns is not None and self.segment.ends_before(self._latest_ns - self._lateness_ns)

    @property
    def _latest_ns(self) -> int:
        return self._images_ns[1] if self._images_ns else 0

    @property
    def num_waiting(self) -> int:
        """How many images wait."""
        return len(self._waiting) + len(self._overtaken)

    def _is_due(self, waiting: tuple[int, int, int, str, Any], at_end: bool) -> bool:
        """Whether no earlier image is to be expected, and odometry and true poses have come as far."""
        _, _, time_ns, camera, _ = waiting
        is_too_many = at_end or len(self._waiting) > self._most_waiting * len(self._cameras)
        as_it_came = len(self._cameras) == 1 and self._streams[camera].remembers
        is_old = self._latest_ns - time_ns >= max(self._lateness_ns, self.in_order_ns)
        in_order = as_it_came or is_old or (self.in_order_ns > 0 and self._all_came_to(time_ns))
        return (is_too_many or in_order) and (self.reaches(time_ns) or is_too_many)

    def _all_came_to(self, time_ns: int) -> bool:
        return all(self._came_ns.get(name, -1 << 63) >= time_ns for name in self._cameras)

    def _frame_asked_for(self, taken: _Taken) -> Frame | None:
        if not self.segment.has(taken.picture.time_ns):
            self._counts.skipped[OUTSIDE] += 1
            return None
        frame = self._frame(*taken)
        if frame is not None:
            self._counts.used += 1
            self.used[taken.camera] += 1
        return frame

    def _frame(self, name: str, picture: Picture) -> Frame | None:
        """The frame of an image; None, and a count of why, where it is skipped."""
        taken_ns = picture.time_ns
        if picture.skipped:
            return self.skipped.image(picture.skipped, taken_ns)
        if not self.frames.admits(taken_ns, name):
            return self.skipped.image(NOT_INCREASING, taken_ns)
        covered = self.motion.covers(taken_ns)
        if self._roles.odometry_required and not covered:
            return self.skipped.image(uncovered(taken_ns, self.motion.odometry_span_ns), taken_ns)
        try:
            image = picture.decode()
        except SequenceError as error:
            return self.skipped.image(why_skipped(error), taken_ns, str(error))
        truth = self.motion.true_pose(taken_ns)
        odometry = self.frames.motion_until(taken_ns)
        time_ns = self.frames.add(taken_ns, name)
        self._last_ns[name] = max(taken_ns, self._last_ns.get(name, taken_ns))
        latest_ns = self.frames.latest_taken_ns
        assert latest_ns is not None
        self.frames_span_ns = (self.frames_span_ns[0] if self.frames_span_ns else taken_ns, latest_ns)
        image, camera = self._lenses[name].seen(image, taken_ns)
        if len(self._roles.cameras) == 1:
            return Frame(time_ns, image, odometry, truth, camera)
        role = self._cameras[name]
        mount = None if role is self._roles.cameras[0] else role.mount.body_from_camera
        truth = truth if truth is None or mount is None else truth @ mount
        return Frame(time_ns, image, odometry, truth, camera, camera_name=name, reference_from_camera=mount)

    def account_for_the_rest(self) -> None:
        """Count images that were not read as outside the segment. Raises SequenceError where one is missing."""
        counts = self._counts
        if unread := counts.stated - counts.read:
            counts.skipped[OUTSIDE] += unread
        if not counts.are_complete:
            raise SequenceError(
                f"{self._roles.path}: {', '.join(self._cameras)}: {counts.used} images used and"
                f" {counts.skipped.total()} skipped, expected the {counts.stated} that are stated"
            )

    def odometry_apart(self) -> str | None:
        """See `odometry_apart`."""
        return odometry_apart(self._images_ns, self.motion.odometry_span_ns)


class MotionStreams:
    """The topics beside the images, see `Timeline`, each read ten seconds further than an image needs it."""

    def __init__(self, timeline: Timeline, topics: Iterable[str], pairing: FramePairing) -> None:
        self._cursors = [_TopicCursor(timeline, topic) for topic in topics]
        self._pairing = pairing
        pairing.reaches = self._read_until
        self._num_read = 0

    def _read_until(self, time_ns: int) -> bool:
        """Read all that determines the motion at a time; true, as nothing more need be waited for."""
        until_ns = time_ns + _HORIZON_NS
        while behind := [cursor for cursor in self._cursors if not cursor.is_over and cursor.latest_ns < until_ns]:
            self._read(min(behind, key=lambda cursor: cursor.latest_ns), time_ns)
        return True

    def finish(self) -> None:
        """Count the rest undecoded. Raises SequenceError where a topic lacks messages that its file states."""
        for cursor in self._cursors:
            cursor.is_over = True
            for _ in cursor.messages:
                pass

    def _read(self, cursor: _TopicCursor, time_ns: int) -> None:
        dated = next(cursor.messages, None)
        if dated is None:
            cursor.is_over = True
            return
        cursor.latest_ns = max([cursor.latest_ns, *(stamp_ns for _, stamp_ns in dated.stamps_ns)])
        self._pairing.take_dated(dated)
        self._num_read += 1
        # After the first frame, odometry since the latest one will be asked for.
        if self._num_read % _FORGET_EVERY == 0 and self._pairing.frames.latest_ns is None:
            read_ns = (each.latest_ns for each in self._cursors if not each.is_over)
            self._pairing.motion.forget_before(min(read_ns, default=time_ns) - _HORIZON_NS)


class _TopicCursor:
    """How far one topic was read; `is_over` where no more is wanted."""

    def __init__(self, timeline: Timeline, topic: str) -> None:
        self.latest_ns = -(1 << 63)
        self.is_over = False
        self.messages: Iterator[Dated] = timeline.messages([topic], until=lambda _: self.is_over)
