"""The state of one reading: images wait, still encoded, until odometry and true poses have come as far."""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

from filtering.motion import Odometry
from sequences.errors import SequenceError
from sequences.frame import Frame
from sequences.images.headers import why_left_out
from sequences.images.streams import Picture
from sequences.options import SequenceOptions
from sequences.reading.camera_info import ImageCamera
from sequences.reading.counts import OUTSIDE, OVERTAKEN, UNCOVERED
from sequences.reading.left_out import LeftOut
from sequences.reading.motion import MotionOfCamera
from sequences.reading.requested_segment import RequestedSegment
from sequences.reading.roles import Roles
from sequences.reading.stamps import Clocks, Stamps, odometry_apart
from sequences.recordings.messages import stamp_ns
from sequences.recordings.source import TF, TF_STATIC, RawMessage

MOST_WAITING = 64
SORTED_WITHIN_S = 0.5


class FramePairing:
    """Messages in, in the order of a recording; frames out, in the order of their stamps.

    Attributes:
        left_out: What becomes of the images, and what is left out.
        segment: Which images are asked for.
        motion: Odometry and true poses.
    """

    def __init__(
        self,
        path: Path,
        roles: Roles,
        options: SequenceOptions,
        camera: ImageCamera,
        num_images: int,
        *,
        most_waiting: int = MOST_WAITING,
        sorted_within_s: float = SORTED_WITHIN_S,
        over_gaps: bool = True,
    ) -> None:
        """Set up a reading that no message was taken into yet.

        Args:
            path: What messages of errors call the recording.
            roles: Which topic is what.
            options: What to read.
            camera: Of the images.
            num_images: How many there are.
            most_waiting: Images held, still encoded, until odometry and true poses reach them.
            sorted_within_s: Images are held until one so much later has come, and so put in the order of their stamps.
            over_gaps: Whether odometry leads over times without messages, by the poses before and after them.
        """
        clocks = Clocks()
        self._most_waiting, self._sorted_within_ns = most_waiting, round(sorted_within_s * 1e9)
        self.left_out = LeftOut(num_images)
        self.segment = RequestedSegment(options.start_s, options.duration_s)
        self.motion = MotionOfCamera(path, roles, options, self.left_out, clocks, over_gaps=over_gaps)
        self._path, self._roles, self._camera, self._clocks = path, roles, camera, clocks
        self._counts = self.left_out.counts
        self._images = roles.open_images()
        # A heap: what they are ordered by, how many came before, stamps, and messages, None for lost ones.
        self._waiting: list[tuple[int, int, int, SimpleNamespace | None]] = []
        self._image_stamps = Stamps()
        self._previous_ns: int | None = None  # stamp of the last frame
        self._previous_covered = False  # by odometry
        self._span_ns: tuple[int, int] | None = None  # stamps of the first and the last frame

    def take(self, raw: RawMessage, message: SimpleNamespace | None) -> None:
        """Take one message in, of whichever topic; None for bytes that are no message.

        Raises:
            SequenceError: a camera that should be fixed moves, or a message says no pose.
        """
        if raw.topic == self._roles.image.name:
            self._counts.read += 1
            self._take_image(raw, message)
        elif message is None:
            is_transforms = raw.topic in (TF, TF_STATIC)
            self.left_out.message("undecodable transforms" if is_transforms else "unusable odometry", raw.log_time_ns)
        else:
            before_images = self._previous_ns is None and not self._waiting
            self.motion.take(raw, message, before_images=before_images)

    def _take_image(self, raw: RawMessage, message: SimpleNamespace | None) -> None:
        time_ns = stamp_ns(message.header) if message is not None else 0
        is_ahead = message is not None and self._clocks.jump_ahead(time_ns, raw.log_time_ns, raw.topic)
        if message is None or is_ahead:
            self.left_out.image("time stamp far ahead" if is_ahead else "undecodable image", raw.log_time_ns)
            if self._images.remembers:  # those after it build on it
                self._wait(self._image_stamps.end_ns, None)
            return
        self._image_stamps.take(time_ns, raw.log_time_ns)
        self.segment.take_image(time_ns, raw.log_time_ns)
        if self._images.remembers or self.segment.has(time_ns):
            self._wait(time_ns, message)
        else:
            self._counts.skipped[OUTSIDE] += 1

    def _wait(self, time_ns: int, message: SimpleNamespace | None) -> None:
        """Have an image wait: in the order of stamps, or as it came where those after it build on it."""
        order = 0 if self._images.remembers else time_ns
        heapq.heappush(self._waiting, (order, self._counts.read, time_ns, message))

    def ready_frames(self, *, at_end: bool = False) -> Iterator[Frame]:
        """Frames of the images that need to wait no longer."""
        for picture in self._ready_pictures(at_end=at_end):
            if (frame := self._frame_asked_for(picture)) is not None:
                yield frame

    def newest_frame(self) -> Frame | None:
        """The frame of the newest image that needs to wait no longer and can be used; those before it are skipped."""
        frame: Frame | None = None
        for picture in reversed(list(self._ready_pictures())):
            if frame is not None:
                self._counts.skipped[OVERTAKEN] += 1
            else:
                frame = self._frame_asked_for(picture)
        return frame

    def drop_overtaken(self) -> None:
        """Skip the oldest of the images that wait where there are too many: newer ones are asked for, but not yet."""
        while len(self._waiting) > self._most_waiting:
            _, _, time_ns, message = heapq.heappop(self._waiting)
            reason = OVERTAKEN if self.motion.reaches(time_ns) else UNCOVERED
            for _ in self._images.take(time_ns, message):
                self._counts.skipped[reason] += 1

    def _ready_pictures(self, *, at_end: bool = False) -> Iterator[Picture]:
        while self._waiting and (
            at_end or len(self._waiting) > self._most_waiting or self._is_due(self._waiting[0][2])
        ):
            _, _, time_ns, message = heapq.heappop(self._waiting)
            yield from self._images.take(time_ns, message)
        if at_end:
            yield from self._images.finish()

    @property
    def previous_ns(self) -> int | None:
        """Stamp of the last frame, or a later one that a motion was asked for until; None before any."""
        return self._previous_ns

    @property
    def num_waiting(self) -> int:
        """How many images wait."""
        return len(self._waiting)

    def _is_due(self, time_ns: int) -> bool:
        """Whether no image before this one is to be expected any more, and odometry and true poses have come as far."""
        in_order = self._images.remembers or self._image_stamps.end_ns - time_ns >= self._sorted_within_ns
        return in_order and self.motion.reaches(time_ns)

    def _frame_asked_for(self, picture: Picture) -> Frame | None:
        """The frame of an image of the segment, which is counted; None elsewhere."""
        if not self.segment.has(picture.time_ns):
            self._counts.skipped[OUTSIDE] += 1
            return None
        frame = self._frame(picture)
        self._counts.used += frame is not None
        return frame

    def _frame(self, picture: Picture) -> Frame | None:
        """The frame of an image; None, and a count of why, where it is skipped."""
        time_ns, previous_ns = picture.time_ns, self._previous_ns
        if picture.skipped:
            return self.left_out.image(picture.skipped, time_ns)
        if previous_ns is not None and time_ns <= previous_ns:
            return self.left_out.image("time stamp not increasing", time_ns)
        covered = self.motion.covers(time_ns)
        if self._roles.odometry_required and not covered:
            return self.left_out.image(UNCOVERED, time_ns)
        try:
            image = picture.decode()
        except SequenceError as error:
            return self.left_out.image(why_left_out(error), time_ns, error)
        odometry = self._odometry_until(time_ns) if covered else None
        truth = self.motion.true_pose(time_ns)
        self.motion.forget_before(time_ns)
        self._previous_ns, self._previous_covered = time_ns, covered
        self._span_ns = (self._span_ns[0] if self._span_ns else time_ns, time_ns)
        image, camera = self._camera.seen(image)
        return Frame(time_ns, image, odometry, truth, camera)

    def _odometry_until(self, time_ns: int) -> Odometry | None:
        """Motion of the camera from the last frame to a covered time; None where it is unknown."""
        if self._previous_ns is None or not self._previous_covered:
            return None
        return self.motion.odometry_between(self._previous_ns, time_ns)

    def moved_until(self, time_ns: int) -> Odometry | None:
        """Motion of the camera since the last frame, for use between images; None where it is unknown."""
        previous_ns = self._previous_ns
        if previous_ns is None or time_ns <= previous_ns or not self.motion.covers(time_ns):
            return None
        return self._odometry_until(time_ns)

    def settle(self, time_ns: int) -> None:
        """Have the next motion begin there, as if it were of a frame: images of before come too late from now on."""
        self._previous_ns, self._previous_covered = time_ns, self.motion.covers(time_ns)
        self.motion.forget_before(time_ns)

    def account_for_the_rest(self) -> None:
        """Count the images that were not read as outside the segment; raise SequenceError where one is missing."""
        counts = self._counts
        if unread := counts.stated - counts.read:
            counts.skipped[OUTSIDE] += unread
        if not counts.are_complete:
            raise SequenceError(
                f"{self._path}: {self._roles.image.name}: {counts.used} images used and"
                f" {counts.skipped.total()} skipped, expected the {counts.stated} that are stated"
            )

    def require_stamps(self) -> None:
        """Raise SequenceError where all images, or all messages of odometry, have one and the same stamp."""
        self._image_stamps.require_differing(self._path, "images")
        if self._roles.odometry_required:
            self.motion.odometry_stamps.require_differing(self._path, "messages of odometry")

    def odometry_apart(self) -> str | None:
        """What to say where odometry is of another time than all images: by another clock. None elsewhere."""
        return odometry_apart(self._image_stamps, self.motion.odometry_span_ns)

    def true_poses_apart(self) -> str | None:
        """What to say where there are true poses, but none of the time of an image; None elsewhere."""
        return self.motion.true_poses_apart(self._span_ns)
