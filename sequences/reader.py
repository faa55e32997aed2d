"""A recorded sequence -> frames: images, the odometry between them and, where recorded, the true poses."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

from filtering.se3 import Poses
from sequences.errors import NoImageError, SequenceError
from sequences.frame import Camera, Frame
from sequences.options import OdometryOrigin, OdometryUse, SequenceOptions, TruePoseUse
from sequences.reading.camera_info import ImageCamera
from sequences.reading.counts import ImageCounts
from sequences.reading.frame_pairing import FramePairing, MotionStreams
from sequences.reading.motion import odometry_apart, true_poses_apart
from sequences.reading.roles import ODOMETRY_TYPE, Roles
from sequences.reading.timeline import Key, LoggedSegment, Timeline
from sequences.recordings.bag import METADATA_NAME, Bag
from sequences.trajectories.interpolation import MAX_ODOMETRY_GAP_S

_ONE_CLOCK_S = 2.0  # by which images of several cameras may be logged late


class SequenceReader:
    """Frames of an MCAP file, rosbag2 folder or ROS 1 bag, read as a stream; every iteration reads it again.

    Attributes:
        path: The file or folder.
        counts: Counts of the images of the latest iteration; complete after it.
        across_jumps: Frames of the latest iteration without a true pose because it jumps about them.
        notices: Sentences for users on the camera, the odometry and the true poses; complete after an iteration.
        camera: Intrinsics of the undistorted images, as the file states their size, of the camera that is localized;
            None where it has none.
        base_from_camera: Extrinsics of the localized one, one pose; None where odometry is not read.
        odometry_origin: "recorded" where it is read; else None.
        no_odometry: See `FrameSource`.
        num_images: Images in the whole file, for progress.
        image_description: Origin of the images by the file's metadata, as `synthetic`; None where it states none.
        odometry_description: Origin of the odometry, likewise.

    Example:
        >>> import vapor
        >>> sequence = vapor.SequenceReader("walk.mcap")
        >>> for frame in sequence:
        ...     image, odometry, truth = frame.image, frame.odometry, frame.world_from_camera
        >>> sequence.num_images, sequence.odometry_origin, sequence.base_from_camera.batch_shape
        (25, 'recorded', ())
    """

    def __init__(
        self,
        path: Path | str,
        options: SequenceOptions | None = None,
        *,
        odometry: OdometryUse = "required",
        true_poses: TruePoseUse = "optional",
        usual_cameras: Sequence[str] = (),
        only_camera: str | None = None,
    ) -> None:
        """Open a sequence, find its topics, extrinsics and true poses.

        Args:
            path: MCAP file, rosbag2 folder or ROS 1 bag.
            options: What to read; None for all of it, as found.
            odometry: "required" reads it, and skips the images that it does not cover. "auto" does so where there is
                any, and does without where there is none. "optional" gives images it where it can be found, without a
                choice to make, and skips none for lack of it. "ignored" gives images none, but takes it for no true
                poses. "unread" does not look for it.
            true_poses: "required" fails where none are found, with the candidates, and where none is of the time of an
                image. "optional" does without.
            usual_cameras: Topics of cameras that are read where there are several and none is named.
            only_camera: One of several cameras, whose images alone are read; None for all of them.

        Raises:
            SequenceError: the file is damaged or lacks images, a topic is missing or ambiguous, tf does not lead to the
                camera, named true poses are unusable, or the intrinsics or the distortion are impossible.
        """
        self.path = Path(path)
        self.across_jumps = 0
        self._options = options or SequenceOptions()
        self._bag = Bag(self.path, stamps=self._options.stamps, tf_topic=self._options.tf_topic)
        self._roles = Roles(self._bag, self._options, odometry, true_poses, usual_cameras=usual_cameras)
        if only_camera is not None and only_camera not in self._roles.image_topics:
            raise SequenceError(f"{self.path}: no camera {only_camera}, found {', '.join(self._roles.image_topics)}")
        self._lenses = {
            camera.name: ImageCamera(self._bag, camera.info, camera.image, undistort=self._options.undistort)
            for camera in self._roles.cameras
            if only_camera in (None, camera.name)
        }
        self.num_images = sum(self._bag.topics[name].num_messages for name in self._lenses)
        self.counts = ImageCounts(self.num_images)
        self._skipped_messages: Counter[str] = Counter()
        self.camera = next(iter(self._lenses.values())).camera
        extrinsics = self._roles.extrinsics
        self.base_from_camera: Poses | None = extrinsics.body_from_camera if extrinsics is not None else None
        is_read = self._roles.open_odometry() is not None
        self.odometry_origin: OdometryOrigin | None = "recorded" if is_read else None
        said_of_itself = self._bag.metadata.get(METADATA_NAME, {})
        self.image_description = said_of_itself.get("images")
        self.odometry_description = said_of_itself.get("odometry")
        self._timeline: Timeline | None = None
        self._pairing: FramePairing | None = None  # of the latest iteration
        accounts = chain.from_iterable(self._bag.account_for(name) for name in self._lenses)
        self._found_notices = [*self._roles.notices, *dict.fromkeys(accounts)]
        self._found_notices += self._roles.truth.notices if self._roles.truth is not None else []
        self.no_odometry = self._roles.no_odometry
        self.notices = list(self._found_notices)

    @property
    def camera_names(self) -> tuple[str, ...]:
        """Names of the cameras that are read, that of the localized one first."""
        return tuple(self._lenses)

    @property
    def localized_camera(self) -> str:
        """Name of the camera that is localized, also where it is not read."""
        return self._roles.cameras[0].name

    @property
    def unused_odometry(self) -> dict[str, int]:
        """Topics of odometry that is recorded and cannot be used, with the number of their messages."""
        topics = [] if self.base_from_camera is not None else self._bag.topics.values()
        odometry = [each for each in topics if each.type == ODOMETRY_TYPE and each.num_messages]
        return {each.name: each.num_messages for each in odometry if each.name != self._options.ground_truth_topic}

    def cameras(self) -> Counter[Camera]:
        """How many images are of which camera, undistorted, whether used or not; of known cameras."""
        found = Counter[Camera]()
        for name, lens in self._lenses.items():
            if lens.camera is not None:
                found[lens.camera] += self._bag.topics[name].num_messages
        return found

    @property
    def skipped(self) -> Counter[str]:
        """How many images and other messages of the latest iteration were left out, by reason."""
        return self.counts.skipped + self._skipped_messages

    @property
    def resolved(self) -> dict[str, Any]:
        """The options that would read the same: topics and extrinsics; '' and None for none."""
        r = self._roles
        extrinsics, poses = self.base_from_camera, self._options.poses
        info = r.cameras[0].info if len(r.cameras) == 1 else None
        return {
            "image_topic": ",".join(self._lenses),
            "odometry_topic": r.odometry.name if r.odometry is not None else "",
            "camera_info_topic": info.name if info is not None else None if len(r.cameras) > 1 else "",
            "odometry_frame": None,
            "ground_truth_topic": None if r.truth is not None else "",
            "poses": poses.name if poses else None,
            **(r.tree_odometry.resolved if r.tree_odometry is not None else {}),
            **(r.truth.resolved if r.truth is not None else {}),
            "base_from_camera": [*extrinsics.translation.tolist(), *extrinsics.as_quat_xyzw().tolist()]
            if extrinsics is not None
            else None,
        }

    def __iter__(self) -> Iterator[Frame]:
        """Frames in order of time.

        The stamps of the whole recording are read first, to know where clocks were set and how late messages lie; then
        the images one after the other, and beside them each other topic as far as an image needs it. Messages behind
        the segment asked for are counted without being decoded.

        Raises:
            SequenceError: the file is damaged or lacks messages, no image is left, an image is unaccounted for, all
                stamps are equal, a fixed camera moves, more than half of the odometry cannot be used, or true poses
                are required and none is of the time of an image.
        """
        roles, timeline = self._roles, self._survey()
        lenses, by_other_clocks = self._of_one_clock(timeline)
        self.num_images = sum(self._bag.topics[name].num_messages for name in lenses)
        images = [("", name) for name in lenses]
        pairing = FramePairing(
            roles,
            lenses,
            self.num_images,
            begin_ns=min((timeline.streams[key].begin_ns for key in images if key in timeline.streams), default=0),
            lateness_ns=timeline.lateness_ns(lenses),
        )
        motion, self._pairing = pairing.motion, pairing
        self.counts, self._skipped_messages = pairing.skipped.counts, pairing.skipped.messages
        self.across_jumps, self.notices = 0, [*self._found_notices, *by_other_clocks, *timeline.notices]
        streams = MotionStreams(timeline, [name for name in self._watched if name not in self._lenses], pairing)
        for dated in timeline.messages(lenses, until=lambda _: pairing.is_over):
            pairing.take_dated(dated)
            for frame in pairing.ready_frames():
                self.across_jumps = motion.across_jumps
                yield frame
        for frame in pairing.ready_frames(at_end=True):
            self.across_jumps = motion.across_jumps
            yield frame
        streams.finish()
        pairing.account_for_the_rest()
        self._judge(pairing, timeline)

    def _survey(self) -> Timeline:
        """The clocks of the recording, as far as the segment asked for reaches."""
        if self._timeline is None:
            roles, options = self._roles, self._options
            lasts_s = None if options.duration_s is None else options.start_s + options.duration_s
            segment = None if lasts_s is None else LoggedSegment(self._lenses, lasts_s)
            timeline = Timeline(self._bag, self._watched, segment=segment)
            for name in self._lenses:
                timeline.require_differing(("", name), "images")
            for key in roles.odometry_keys if roles.odometry_required else ():
                timeline.require_differing(key, "messages of odometry")
            self._timeline = timeline
        return self._timeline

    def _of_one_clock(self, timeline: Timeline) -> tuple[dict[str, ImageCamera], list[str]]:
        """The cameras whose stamps are of the same clock as those of the first, and sentences on the others."""
        first, *others = self._lenses
        lenses, said = {first: self._lenses[first]}, []
        for name in others:
            ahead_s = timeline.ahead_s(name) - timeline.ahead_s(first)
            if abs(ahead_s) <= _ONE_CLOCK_S:
                lenses[name] = self._lenses[name]
                continue
            said.append(
                f"{name} is left out: by the times at which images were logged its stamps are {abs(ahead_s):.1f} s"
                f" {'ahead of' if ahead_s > 0 else 'behind'} those of {first}, expected one clock"
            )
        return lenses, said

    @property
    def _watched(self) -> dict[str, set[Key] | None]:
        """Topics that are read, see `Roles.watched`."""
        unread = {camera.name for camera in self._roles.cameras} - self._lenses.keys()
        return {name: links for name, links in self._roles.watched.items() if name not in unread}

    def _judge(self, pairing: FramePairing, timeline: Timeline) -> None:
        """Add the notices of the reading. Raises SequenceError where nothing is usable."""
        roles, motion = self._roles, pairing.motion
        images, odometry = timeline.span_ns([("", next(iter(self._lenses)))]), timeline.span_ns(roles.odometry_keys)
        spacing_s = timeline.spacing_s(roles.odometry_keys)
        notices = [notice for notice in [odometry_apart(images, odometry)] if notice is not None]
        if spacing_s > MAX_ODOMETRY_GAP_S:
            notices.append(
                f"odometry of {roles.odometry_label} comes every {spacing_s:.2g} s: no motion is known over gaps of"
                f" more than {MAX_ODOMETRY_GAP_S:g} s, expected a topic with denser odometry (--odometry-topic,"
                " --odometry-frame)"
            )
        for what, rows in motion.rows.items():
            if roles.odometry_required if what == "poses of odometry" else roles.truth_required:
                rows.require_few()
            notices += rows.notices
        if self.counts.used == 0 and (apart := odometry_apart(images, odometry)) is not None:
            raise SequenceError(f"{self.path}: no image has odometry: {apart}")
        if self.counts.used == 0:
            found = ", ".join(f"{count} × {reason}" for reason, count in self.skipped.items()) or "nothing was skipped"
            problem = next(iter(pairing.skipped.problems.values()), "")
            span = timeline.span_ns([("", name) for name in self._lenses])
            late = None if span is None else pairing.segment.begins_after(span[1])
            expected = late or "expected at least one that can be used"
            raise NoImageError(
                f"{self.path}: no image left of {self.num_images} on {', '.join(self._lenses)}: {found}"
                f"{problem}; {'; '.join([*notices, expected])}"
            )
        self.notices += notices
        if motion.has_no_true_pose and pairing.frames_span_ns is not None and roles.truth is not None:
            span = motion.true_poses_span_ns if roles.truth_keys == [] else timeline.span_ns(roles.truth_keys)
            apart = true_poses_apart(roles.truth.label, span, pairing.frames_span_ns)
            if roles.truth_required:
                raise SequenceError(f"{self.path}: {apart}")
            self.notices.append(apart)
        for name, lens in self._lenses.items():
            about = f"{name}: " if len(self._lenses) > 1 else ""
            self.notices += [f"{about}{notice}" for notice in lens.notices]
            if name in pairing.cameras and not pairing.used[name]:
                self.notices.append(f"{name}: none of its images could be used, so that camera is left out")
        self.notices += motion.jumps()

    def stop(self) -> None:
        """End the latest iteration: resumed, it only counts the rest."""
        if self._pairing is not None:
            self._pairing.segment.is_stopped = True
