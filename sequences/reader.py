"""A recorded sequence -> frames: images, the odometry between them and, where recorded, the true poses."""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from filtering.errors import VaporTrackError
from filtering.se3 import Poses
from sequences.bag import Bag, RawMessage
from sequences.camera_info import ImageCamera
from sequences.counts import OUTSIDE, ImageCounts
from sequences.errors import SequenceError
from sequences.frame import Frame
from sequences.image_headers import why_left_out
from sequences.images import Picture
from sequences.messages import odometry_from_message, stamp_ns
from sequences.options import OdometryUse, SequenceOptions
from sequences.pairing import MAX_ODOMETRY_GAP_S, PoseWindow
from sequences.pose_sources import PoseSource
from sequences.roles import Roles, TruePoseUse
from sequences.topics import decode

METADATA_NAME = "vapor-track"  # of the record in which a file says where its odometry comes from
_MAX_WAITING = 64  # images held, still encoded, until odometry and true poses reach them
_SORTED_WITHIN_S = 0.5  # images are held until one so much later has come, and so put in the order of their stamps
_MAX_LATENESS_S = 10.0  # how much later than its stamp a message may be logged, and how far clocks may jump ahead


class SequenceReader:
    """Frames of an MCAP file or rosbag2 folder, read as a stream; every iteration reads it anew.

    Attributes:
        path: The file or folder.
        counts: What became of the images of the latest iteration; complete after it.
        across_jumps: How many frames of the latest iteration have no true pose as it jumps about them.
        notices: What a person should know of the camera, the odometry and the true poses; complete after an iteration.
        camera: Intrinsics of the undistorted images, as the file states their size; None where it has none.
        base_from_camera: Extrinsics, one pose; None where odometry is not read.
        num_images: Images in the file, all of it: for progress.
        odometry_description: What the file says of where its odometry comes from; None where it says nothing.
    """

    def __init__(
        self,
        path: Path | str,
        options: SequenceOptions | None = None,
        *,
        odometry: OdometryUse = "required",
        true_poses: TruePoseUse = "optional",
    ) -> None:
        """Open a sequence, find its topics, extrinsics and true poses.

        Args:
            path: MCAP file or rosbag2 folder.
            options: What to read; None for all of it, as found.
            odometry: "required" reads it, and skips the images that it does not cover. "optional" gives images it where
                it can be found, without a choice to make, and skips none for lack of it. "unread" leaves it alone.
            true_poses: "required" fails, and says what could be chosen, where none are found by themselves, and where
                none of them is of the time of an image. "optional" does without.

        Raises:
            SequenceError: the file is damaged, the metadata.yaml of a folder states another number of images than its
                files, a topic is missing or ambiguous, no transform leads from the odometry's or the true poses' child
                frame to the camera, what an option names for true poses gives none, or the intrinsics or the distortion
                are none of a camera.
        """
        self.path = Path(path)
        self.across_jumps = 0
        self._options = options or SequenceOptions()
        self._bag = Bag(self.path, stamps=self._options.stamps)
        self._roles = Roles(self._bag, self._options, odometry, true_poses)
        self.num_images = self._roles.image.num_messages
        self.counts = ImageCounts(self.num_images)
        self._skipped_messages: Counter[str] = Counter()
        self._image_camera = ImageCamera(
            self._bag, self._roles.camera_info, self._roles.image, undistort=self._options.undistort
        )
        self.camera = self._image_camera.camera
        extrinsics = self._roles.extrinsics
        self.base_from_camera: Poses | None = extrinsics.body_from_camera if extrinsics is not None else None
        self.odometry_description = self._bag.metadata.get(METADATA_NAME, {}).get("odometry")
        self._pairing: _Pairing | None = None  # of the latest iteration
        self._found_notices = self._bag.account_for(self._roles.image.name)
        self._found_notices += self._roles.truth.notices if self._roles.truth is not None else []
        self.notices = list(self._found_notices)

    @property
    def skipped(self) -> Counter[str]:
        """How many images and other messages of the latest iteration were left out, by reason."""
        return self.counts.skipped + self._skipped_messages

    @property
    def resolved(self) -> dict[str, Any]:
        """The options that say what to read, as they were found: topics, and the extrinsics; '' and None for none."""
        r = self._roles
        topics = {"image": r.image, "odometry": r.odometry, "camera_info": r.camera_info}
        extrinsics, poses = self.base_from_camera, self._options.poses
        return {
            **{f"{role}_topic": topic.name if topic else "" for role, topic in topics.items()},
            "odometry_frame": None,
            "ground_truth_topic": None if r.truth is not None else "",
            "poses": poses.name if poses else None,
            "poses_times": self._options.poses_times.name if self._options.poses_times else None,
            **(r.tree_odometry.resolved if r.tree_odometry is not None else {}),
            **(r.truth.resolved if r.truth is not None else {}),
            "base_from_camera": [*extrinsics.translation.tolist(), *extrinsics.as_quat_xyzw().tolist()]
            if extrinsics is not None
            else None,
        }

    def __iter__(self) -> Iterator[Frame]:
        """Frames in order of time.

        What lies behind the segment asked for is not decoded, but counted.

        Raises:
            SequenceError: the file is damaged or has not all of the messages that it states, an image is neither used
                nor skipped, no image is left, all stamps are equal, a camera that should be fixed moves, or true poses
                are required and none is of the time of an image.
        """
        pairing = _Pairing(self.path, self._roles, self._options, self._image_camera, self.num_images)
        self.counts, self._skipped_messages, self._pairing = pairing.counts, pairing.skipped, pairing
        self.across_jumps, self.notices = 0, list(self._found_notices)
        for raw in self._bag.messages(self._roles.streamed, until=pairing.is_over):
            pairing.take(raw, decode(self._bag, raw, tolerate=self._roles.may_be_damaged(raw.topic)))
            for frame in pairing.ready_frames():
                self.across_jumps = pairing.across_jumps
                yield frame
        for frame in pairing.ready_frames(at_end=True):
            self.across_jumps = pairing.across_jumps
            yield frame
        pairing.account_for_the_rest()
        pairing.require_stamps()
        apart = pairing.odometry_apart()
        if self.counts.used == 0 and apart is not None:
            raise SequenceError(f"{self.path}: no image has odometry: {apart}")
        if self.counts.used == 0:
            found = ", ".join(f"{count} × {reason}" for reason, count in self.skipped.items()) or "nothing was skipped"
            raise SequenceError(
                f"{self.path}: no image left of {self.num_images} on {self._roles.image.name}: {found}"
                f"{pairing.first_problem}; expected at least one that can be used"
            )
        self.notices += [] if apart is None else [apart]
        if (apart := pairing.true_poses_apart()) is not None:
            if self._roles.truth_required:
                raise SequenceError(f"{self.path}: {apart}")
            self.notices.append(apart)
        self.notices += [*self._image_camera.notices, *pairing.jumps()]

    def stop(self) -> None:
        """Ask for no more frames of the latest iteration: it ends where it is resumed, once the rest was counted."""
        if self._pairing is not None:
            self._pairing.is_stopped = True


@dataclass
class _Stamps:
    """The messages of one topic: how many, the earliest and the latest stamp, and whether log times differ."""

    number: int = 0
    begin_ns: int = 0
    end_ns: int = 0
    first_log_ns: int = 0
    log_times_differ: bool = False

    def take(self, time_ns: int, log_time_ns: int) -> None:
        if self.number == 0:
            self.begin_ns = self.end_ns = time_ns
            self.first_log_ns = log_time_ns
        self.number += 1
        self.begin_ns, self.end_ns = min(self.begin_ns, time_ns), max(self.end_ns, time_ns)
        self.log_times_differ |= log_time_ns != self.first_log_ns


class _Pairing:
    """The state of one iteration: images wait, still encoded, until odometry and true poses have come as far."""

    def __init__(self, path: Path, roles: Roles, options: SequenceOptions, camera: ImageCamera, num_images: int):
        self._path = path
        self.counts = ImageCounts(num_images)
        self.skipped: Counter[str] = Counter()  # messages that are no images
        self.first_problem = ""
        self.across_jumps = 0
        self.is_stopped = False  # no more frames are asked for
        self._roles = roles
        self._options = options
        self._base_from_camera = roles.extrinsics.body_from_camera if roles.extrinsics is not None else None
        self._moves_from_ns: int | None = None  # where the camera began to move on the base
        self._camera = camera
        self._images = roles.open_images()
        self._odometry = PoseWindow(MAX_ODOMETRY_GAP_S)
        self._odometry_source = roles.tree_odometry.open() if roles.tree_odometry is not None else None
        self._truth = roles.truth.open() if roles.truth is not None else None
        self._origin = np.array(options.ground_truth_origin or (0.0, 0.0, 0.0))
        # A heap: what they are ordered by, how many came before, stamps, and messages, None for lost ones.
        self._waiting: list[tuple[int, int, int, SimpleNamespace | None]] = []
        self._image_stamps, self._odometry_stamps = _Stamps(), _Stamps()
        self._begin: tuple[int, int] | None = None  # stamp and log time of the first image
        self._previous_ns: int | None = None  # stamp of the last frame
        self._previous_covered = False  # by odometry
        self._ahead_ns: dict[object, int] = {}  # topic or link -> stamp less log time of its last usual message
        self._span_ns: tuple[int, int] | None = None  # stamps of the first and the last frame
        self._num_true = 0

    def is_over(self, log_time_ns: int) -> bool:
        """Whether what is logged from a time on lies too far behind the segment asked for to be of it."""
        if self.is_stopped:
            return True
        if self._options.duration_s is None or self._begin is None:
            return False
        since_s = (log_time_ns - self._begin[1]) * 1e-9
        return since_s > self._options.start_s + self._options.duration_s + _MAX_LATENESS_S

    def account_for_the_rest(self) -> None:
        """Count the images that were not read as outside the segment; raise SequenceError where one is missing."""
        counts = self.counts
        if unread := counts.stated - counts.read:
            counts.skipped[OUTSIDE] += unread
        if not counts.are_complete:
            raise SequenceError(
                f"{self._path}: {self._roles.image.name}: {counts.used} images used and"
                f" {counts.skipped.total()} skipped, expected the {counts.stated} that are stated"
            )

    def take(self, raw: RawMessage, message: SimpleNamespace | None) -> None:
        """Take one message in, of whichever topic; None for bytes that are no message."""
        if raw.topic == self._roles.image.name:
            self.counts.read += 1
            self._take_image(raw, message)
            return
        if message is None:
            self._skip("unusable odometry", raw.log_time_ns)
            return
        self._check_extrinsics(raw, message)
        if self._roles.odometry is not None and raw.topic == self._roles.odometry.name:
            self._take_odometry(raw, message)
        for source, what in ((self._odometry_source, "odometry"), (self._truth, "true pose")):
            if source is not None and source.topic == raw.topic:
                self._take_poses(raw, message, source, what)

    def _check_extrinsics(self, raw: RawMessage, message: SimpleNamespace) -> None:
        """Take a message of tf: a camera that moves on its base has no odometry, where it can do without."""
        roles = self._roles
        for extrinsics in (roles.extrinsics, roles.truth.extrinsics if roles.truth is not None else None):
            if extrinsics is None or raw.topic not in extrinsics.told_on:
                continue
            try:
                extrinsics.require_fixed(raw, message)
            except SequenceError as error:
                if extrinsics is not roles.extrinsics or roles.odometry_required:
                    raise SequenceError(f"{self._path}: {error}") from error
                if self._moves_from_ns is None:
                    self._skip("odometry from where the camera moved on its base", raw.log_time_ns, error)
                    self._moves_from_ns = min(stamp_ns(stamped.header) for stamped in message.transforms)

    def _take_image(self, raw: RawMessage, message: SimpleNamespace | None) -> None:
        time_ns = stamp_ns(message.header) if message is not None else 0
        is_ahead = message is not None and self._jumps_ahead(raw, time_ns, raw.topic)
        if message is None or is_ahead:
            self._skip_image("time stamp far ahead" if is_ahead else "undecodable image", raw.log_time_ns)
            if self._images.remembers:  # those after it build on it
                self._wait(self._image_stamps.end_ns, None)
            return
        self._image_stamps.take(time_ns, raw.log_time_ns)
        self._begin = self._begin or (time_ns, raw.log_time_ns)
        if self._images.remembers or self._is_asked_for(time_ns):
            self._wait(time_ns, message)
        else:
            self.counts.skipped[OUTSIDE] += 1

    def _wait(self, time_ns: int, message: SimpleNamespace | None) -> None:
        """Have an image wait: in the order of stamps, or as it came where those after it build on it."""
        order = 0 if self._images.remembers else time_ns
        heapq.heappush(self._waiting, (order, self.counts.read, time_ns, message))

    def _is_asked_for(self, time_ns: int) -> bool:
        """Whether an image is of the segment asked for; of video the first packet need not have the first image."""
        assert self._begin is not None
        if self.is_stopped:
            return False
        start_s, duration_s = self._options.start_s, self._options.duration_s
        since_s = (time_ns - self._begin[0]) * 1e-9 - start_s
        return (since_s >= 0 or start_s == 0) and (duration_s is None or since_s <= duration_s)

    def _take_odometry(self, raw: RawMessage, message: SimpleNamespace) -> None:
        time_ns = stamp_ns(message.header)
        if self._jumps_ahead(raw, time_ns, raw.topic):
            self._skip("odometry time stamp far ahead", raw.log_time_ns)
            return
        self._odometry_stamps.take(time_ns, raw.log_time_ns)
        try:
            sample = odometry_from_message(message)
        except VaporTrackError as error:
            if not self._roles.odometry_required:
                self._skip("unusable odometry", time_ns, error)
                return
            raise SequenceError(f"{self._path}: {raw.topic} at {time_ns} ns: odometry: {error}") from error
        if not self._odometry.append(time_ns, sample.odom_from_base, sample.twist_covariance):
            self._skip("odometry time stamp not increasing", time_ns)
        if self._is_before_images:
            self._odometry.forget_before(time_ns - int(_MAX_LATENESS_S * 1e9))

    def _take_poses(self, raw: RawMessage, message: SimpleNamespace, source: PoseSource, what: str) -> None:
        try:
            samples = source.samples(message)
        except VaporTrackError as error:
            stamp = f"{stamp_ns(message.header)} ns" if hasattr(message, "header") else f"{raw.log_time_ns} ns (logged)"
            raise SequenceError(f"{self._path}: {raw.topic} at {stamp}: {what}: {error}") from error
        for sample in samples:
            if self._jumps_ahead(raw, sample.time_ns, (what, sample.link)):
                self._skip(f"{what} time stamp far ahead", raw.log_time_ns)
                continue
            if not source.append(sample):
                self._skip(f"{what} time stamp not increasing", sample.time_ns)
            if self._is_before_images:
                source.forget_before(sample.time_ns - int(_MAX_LATENESS_S * 1e9))

    @property
    def _is_before_images(self) -> bool:
        """Before the first image there is nothing to remember but what a late image may still ask for."""
        return self._previous_ns is None and not self._waiting

    def _jumps_ahead(self, raw: RawMessage, time_ns: int, stream: object) -> bool:
        """Whether a stamp ran ahead of its log time, by what is usual there: all after it would seem late."""
        ahead_ns = time_ns - raw.log_time_ns
        drift_ns = ahead_ns - self._ahead_ns.setdefault(stream, ahead_ns)
        if abs(drift_ns) <= _MAX_LATENESS_S * 1e9:
            self._ahead_ns[stream] = ahead_ns  # clocks may drift apart slowly
        return drift_ns > _MAX_LATENESS_S * 1e9

    def ready_frames(self, *, at_end: bool = False) -> Iterator[Frame]:
        """Frames of the images that need to wait no longer."""
        while self._waiting and (at_end or len(self._waiting) > _MAX_WAITING or self._is_due(self._waiting[0][2])):
            _, _, time_ns, message = heapq.heappop(self._waiting)
            yield from self._frames(self._images.take(time_ns, message))
        if at_end:
            yield from self._frames(self._images.finish())

    def _frames(self, pictures: Iterable[Picture]) -> Iterator[Frame]:
        for picture in pictures:
            if not self._is_asked_for(picture.time_ns):
                self.counts.skipped[OUTSIDE] += 1
            elif (frame := self._frame(picture)) is not None:
                self.counts.used += 1
                yield frame

    def _is_due(self, time_ns: int) -> bool:
        """Whether no image before this one is to be expected any more, and odometry and true poses have come as far."""
        return (
            (self._images.remembers or self._image_stamps.end_ns - time_ns >= _SORTED_WITHIN_S * 1e9)
            and (self._roles.odometry is None or self._odometry.reaches(time_ns))
            and (self._odometry_source is None or self._odometry_source.reaches(time_ns))
            and (self._truth is None or self._truth.reaches(time_ns))
        )

    def _frame(self, picture: Picture) -> Frame | None:
        """The frame of an image; None, and a count of why, where it is skipped."""
        time_ns, previous_ns = picture.time_ns, self._previous_ns
        if picture.skipped:
            return self._skip_image(picture.skipped, time_ns)
        if previous_ns is not None and time_ns <= previous_ns:
            return self._skip_image("time stamp not increasing", time_ns)
        covered = self._is_covered(time_ns)
        if self._roles.odometry_required and not covered:
            return self._skip_image("odometry does not cover", time_ns)
        try:
            image = picture.decode()
        except SequenceError as error:
            return self._skip_image(why_left_out(error), time_ns, error)
        odometry = None
        moves = self._moves_from_ns is not None and time_ns >= self._moves_from_ns
        base_from_camera = None if moves else self._base_from_camera
        if base_from_camera is not None and previous_ns is not None and covered and self._previous_covered:
            odometry = self._odometry.odometry_between(
                previous_ns,
                time_ns,
                base_from_camera=base_from_camera,
                motion_noise=self._options.motion_noise,
            )
        truth = self._true_pose(time_ns)
        self._odometry.forget_before(time_ns)
        for source in (self._odometry_source, self._truth):
            if source is not None:
                source.forget_before(time_ns)
        self._previous_ns, self._previous_covered = time_ns, covered
        self._span_ns = (self._span_ns[0] if self._span_ns else time_ns, time_ns)
        image, camera = self._camera.seen(image)
        return Frame(time_ns, image, odometry, truth, camera)

    def _is_covered(self, time_ns: int) -> bool:
        """Whether odometry tells where the base was; of a tree it becomes a pose like those of a topic."""
        if self._odometry_source is None:
            return self._roles.odometry is not None and self._odometry.at(time_ns) is not None
        pose = self._odometry_source.at(time_ns)
        return pose is not None and (self._odometry.append(time_ns, pose) or self._odometry.at(time_ns) is not None)

    def _true_pose(self, time_ns: int) -> Poses | None:
        if self._truth is None:
            return None
        if self._truth.jumps_at(time_ns):
            self.across_jumps += 1
            return None
        pose = self._truth.at(time_ns)
        if pose is None:
            return None
        self._num_true += 1
        return Poses(pose.rotation, pose.translation - self._origin)

    def require_stamps(self) -> None:
        """Raise SequenceError where all images, or all messages of odometry, have one and the same stamp."""
        odometry = self._odometry_stamps if self._roles.odometry_required else _Stamps()
        for stamps, what in ((self._image_stamps, "images"), (odometry, "messages of odometry")):
            if stamps.number < 2 or stamps.begin_ns != stamps.end_ns:
                continue
            helps = "; --stamps log takes the times at which they were logged" if stamps.log_times_differ else ""
            said = "zero" if stamps.begin_ns == 0 else f"{stamps.begin_ns} ns"
            raise SequenceError(
                f"{self._path}: the time stamps in the headers of all {stamps.number} {what} are {said}, expected"
                f" increasing ones{helps}"
            )

    def odometry_apart(self) -> str | None:
        """What to say where odometry is of another time than all images: by another clock. None elsewhere."""
        images, odometry = self._image_stamps, self._odometry_stamps
        span = (odometry.begin_ns, odometry.end_ns) if odometry.number else None
        if self._odometry_source is not None:
            span = self._odometry_source.span_ns
        if span is None or not images.number or (span[0] <= images.end_ns and images.begin_ns <= span[1]):
            return None
        return (
            f"images run from {_seconds(images.begin_ns)} to {_seconds(images.end_ns)} s, odometry from"
            f" {_seconds(span[0])} to {_seconds(span[1])} s: they begin {abs(span[0] - images.begin_ns) * 1e-9:.1f} s"
            " apart, expected one clock (--stamps log takes log times)"
        )

    def true_poses_apart(self) -> str | None:
        """What to say where there are true poses, but none of the time of an image; None elsewhere."""
        if self._truth is None or self._roles.truth is None or self._num_true or self._span_ns is None:
            return None
        span, (begin, end) = self._truth.span_ns, self._span_ns
        said = "no pose" if span is None else f"from {_seconds(span[0])} to {_seconds(span[1])} s"
        return (
            f"no image with a true pose: those of {self._roles.truth.said} are {said}, images from {_seconds(begin)} to"
            f" {_seconds(end)} s; expected poses of that time, without long gaps (--time-offset-s shifts a file's)"
        )

    def jumps(self) -> list[str]:
        """What to say of jumps of the true poses, once all were read."""
        if self._truth is None or self._roles.truth is None:
            return []
        number, first_ns = self._truth.finish()
        if first_ns is None:
            return []
        return [
            f"true poses of {self._roles.truth.said} jump {number} times, first at {_seconds(first_ns)} s:"
            f" {self.across_jumps} images between have none"
        ]

    def _skip(self, reason: str, time_ns: int, error: Exception | None = None) -> None:
        self._note(time_ns, error)
        self.skipped[reason] += 1

    def _skip_image(self, reason: str, time_ns: int, error: Exception | None = None) -> None:
        self._note(time_ns, error)
        self.counts.skipped[reason] += 1

    def _note(self, time_ns: int, error: Exception | None) -> None:
        if not self.first_problem:
            self.first_problem = f" (first at {time_ns} ns{f': {error}' if error else ''})"


def _seconds(time_ns: int) -> str:
    return f"{time_ns * 1e-9:.3f}"
