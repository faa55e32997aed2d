"""Which topic, frame or file of a recording gives images, odometry, true poses and intrinsics."""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from filtering.se3 import Poses
from sequences.errors import NoOdometryError, NotFoundError, SequenceError
from sequences.frame import Trajectory
from sequences.options import OdometryUse, SequenceOptions, TruePoseUse, pose_of_numbers
from sequences.reading.extrinsics import CameraMount, Extrinsics, find_extrinsics
from sequences.reading.pose_routes import PoseRoute, find_true_poses, tree_odometry
from sequences.reading.pose_sources import PoseSource, odometry_of_topic
from sequences.reading.rig import find_cameras
from sequences.reading.timeline import Key, Timeline
from sequences.recordings.messages import frame_name
from sequences.recordings.source import (
    TF,
    TF_STATIC,
    MessageSource,
    RawMessage,
    Topic,
    choose,
    decode,
    first,
    other_than,
    several_robots,
)

ODOMETRY_TYPE = "nav_msgs/Odometry"
"""Type of the messages of odometry."""
_OFFSET_SEGMENT_S, _OFFSET_STEP_S = 1800.0, 0.02  # of odometry, to find a time offset in


class Roles:
    """The role of each topic, frame or file: the one named by an option, or the only one of its kind.

    Odometry, extrinsics and true poses are those of the first of the cameras.
    """

    def __init__(
        self,
        bag: MessageSource,
        options: SequenceOptions,
        odometry: OdometryUse,
        true_poses: TruePoseUse,
        *,
        usual_cameras: Sequence[str] = (),
    ) -> None:
        self._bag, self.path, self.options = bag, bag.path, options
        self.cameras, self.notices = find_cameras(bag, options, usual_cameras)
        for camera in self.cameras:
            camera.open_images(self.path)  # what it needs may not be installed
        self.image = self.cameras[0].image
        self.odometry_required = odometry in ("required", "auto")
        self.no_odometry = ""  # what was looked for where none is recorded, for users
        self.truth_required = true_poses == "required"
        self.odometry: Topic | None = None
        self.odometry_frame = ""  # that its poses are in, where it is read
        self.tree_odometry: PoseRoute | None = None
        self.extrinsics: Extrinsics | None = None
        given = options.base_from_camera
        self.camera_frame = self._find_camera_frame()  # of tf; '' where it is unknown
        mount = CameraMount(self.camera_frame, base_from_camera=None if given is None else pose_of_numbers(given))
        if odometry != "unread":
            try:
                mount = self._find_odometry(mount)
            except SequenceError as error:
                if self.odometry_required and not (odometry == "auto" and isinstance(error, NoOdometryError)):
                    if odometry == "required":
                        raise
                    raise type(error)(f"{error}; --odometry visual makes odometry from the images instead") from error
                if odometry == "auto":
                    other = other_than(bag, options.ground_truth_topic, (ODOMETRY_TYPE,))
                    self.no_odometry = (
                        f"no{other} topic is of type {ODOMETRY_TYPE}, and in tf {self.camera_frame or 'the camera'}"
                        f" does not move in a frame odom{several_robots(bag)}"
                    )
                self.odometry_required = False
                self.odometry = self.tree_odometry = self.extrinsics = None
        needed = self.truth_required and options.ground_truth_topic != ""  # an empty name asks for none
        self.truth = find_true_poses(bag, options, mount, required=needed, odometry=self._odometry_track)
        if len(self.cameras) > 1 and self.truth is not None and self.truth.topic != TF:
            mounted = self.truth.extrinsics
            if mounted is not None and not mounted.path and mounted.body_from_camera.is_identity:
                self.notices.append(
                    f"true poses of {self.truth.label} are taken for those of {self.image.name}, the camera that is"
                    " localized (the first in --image-topic)"
                )
        if odometry == "ignored":
            self.odometry = self.tree_odometry = self.extrinsics = None

    def open_odometry(self) -> PoseSource | None:
        """A new source of odometry; None where none is read."""
        if self.tree_odometry is not None:
            return self.tree_odometry.open()
        return None if self.odometry is None else odometry_of_topic(self.odometry)

    def _find_camera_frame(self) -> str:
        if self.options.camera_frame:
            return frame_name(self.options.camera_frame)
        try:
            return frame_name(first(self._bag, self.image).header.frame_id)
        except SequenceError:  # reported when the images are read
            return ""

    def _find_odometry(self, mount: CameraMount) -> CameraMount:
        """Find odometry, of a topic or else of tf, and extrinsics; returns the mount with both."""
        bag, options = self._bag, self.options
        if options.odometry_frame is not None:
            return self._take_tree(mount)
        try:
            topic = choose(
                bag,
                "odometry",
                (ODOMETRY_TYPE,),
                options.odometry_topic,
                required=True,
                besides=options.ground_truth_topic,
            )
        except NotFoundError as error:
            if options.odometry_topic is not None:
                raise
            try:
                return self._take_tree(mount)
            except NotFoundError as without:
                raise NoOdometryError(f"{error}; {str(without).removeprefix(f'{bag.path}: ')}") from error
        assert topic is not None
        self.odometry = topic
        message = first(bag, topic)
        base, self.odometry_frame = frame_name(message.child_frame_id), frame_name(message.header.frame_id)
        mount = replace(mount, base=base, odometry_topic=topic.name, odometry_frame=self.odometry_frame)
        if mount.base_from_camera is not None:
            self.extrinsics = Extrinsics(mount.base_from_camera)
        else:
            self.extrinsics = find_extrinsics(
                bag, base, mount.camera, body_is=f" ({topic.name}, child frame)", camera_is=f" ({self.image.name})"
            )
        return mount

    def _take_tree(self, mount: CameraMount) -> CameraMount:
        self.tree_odometry, mount = tree_odometry(self._bag, self.options, mount)
        self.extrinsics, self.odometry_frame = self.tree_odometry.extrinsics, mount.odometry_frame
        return mount

    def _odometry_track(self) -> Trajectory:
        """The first half hour of odometry, at most 50 poses a second, by one steady clock, to find a time offset by.

        Raises SequenceError where there is none, or the recording is damaged.
        """
        source = self.open_odometry()
        if source is None:
            raise SequenceError(f"{self.path}: no odometry found, expected it for --time-offset-s auto")
        links = set(source.links) if self.odometry is None else None
        times_ns, numbers = array("q"), array("d")
        for dated in Timeline(self._bag, {source.topic: links}).messages([source.topic]):
            if dated.message is None or not dated.stamps_ns:
                continue
            for sample in source.samples(dated.message)[0]:
                source.append(sample)
            span = source.span_ns
            if span is None or (times_ns and span[1] - times_ns[-1] < round(_OFFSET_STEP_S * 1e9)):
                continue
            pose = source.at(span[1])
            source.forget_before(span[1])
            if pose is None:
                continue
            times_ns.append(span[1])
            numbers.extend([*pose.translation, *pose.as_quat_xyzw()])
            if (times_ns[-1] - times_ns[0]) * 1e-9 > _OFFSET_SEGMENT_S:
                break
        if len(times_ns) < 2:
            raise SequenceError(f"{self.path}: {source.topic}: no odometry, expected some to find a time offset by")
        table = np.array(numbers).reshape(-1, 7)
        return Trajectory(np.array(times_ns, np.int64), Poses.from_quat_xyzw(table[:, :3], table[:, 3:]))

    def why_undecodable(self, raw: RawMessage) -> str:
        """The error of decoding a message; '' where there is none."""
        try:
            decode(self._bag, raw)
        except SequenceError as error:
            return str(error).removeprefix(f"{self.path}: ")
        return ""

    @property
    def image_topics(self) -> list[str]:
        """Names of the topics of images."""
        return [camera.name for camera in self.cameras]

    @property
    def watched(self) -> dict[str, set[Key] | None]:
        """Names of the topics that are read from front to back: with the links that count of tf, else None."""
        names: dict[str, set[Key] | None] = dict.fromkeys(self.image_topics)
        links: dict[str, set[Key]] = {}
        if self.odometry is not None:
            names[self.odometry.name] = None
        routes = [route for route in (self.tree_odometry, self.truth) if route is not None]
        for route in routes:
            if route.topic == TF:
                links.setdefault(TF, set()).update(route.open().links)
            elif route.topic:
                names[route.topic] = None
        mounts = [self.extrinsics, *(route.extrinsics for route in routes), *(camera.mount for camera in self.cameras)]
        for extrinsics in mounts:
            for step in extrinsics.path if extrinsics is not None else ():
                links.setdefault(TF_STATIC if step.static else TF, set()).add(step.link)
        names |= dict.fromkeys(camera.info.name for camera in self.cameras if camera.info is not None)
        return {name: links for name, links in {**names, **links}.items() if name in self._bag}

    @property
    def odometry_keys(self) -> list[Key]:
        """Streams of odometry: a topic, or links of tf."""
        source = self.open_odometry()
        return [] if source is None else [*source.links]

    @property
    def odometry_label(self) -> str:
        """Name of the odometry in messages."""
        return f"the tf frame {self.odometry_frame!r}" if self.odometry is None else self.odometry.name

    @property
    def truth_keys(self) -> list[Key]:
        """Streams of true poses; none where a table has them all."""
        return [] if self.truth is None else [*self.truth.open().links]
