"""Which topic, frame or file of a recording gives images, odometry, true poses and intrinsics."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Collection
from dataclasses import replace
from functools import partial

import numpy as np

from filtering.se3 import Poses
from sequences.errors import NotFoundError, SequenceError
from sequences.frame import Trajectory
from sequences.images.decoding import decode_compressed_image, decode_image
from sequences.images.streams import ImageStream, Stills
from sequences.images.video import Video
from sequences.options import OdometryUse, SequenceOptions, TruePoseUse, pose_of_numbers
from sequences.reading.extrinsics import Extrinsics, Rig, find_extrinsics
from sequences.reading.linked_poses import poses_of_topic
from sequences.reading.pose_routes import PoseRoute, tree_odometry
from sequences.reading.pose_source import PoseSource
from sequences.reading.timeline import Key, Timeline
from sequences.reading.true_poses import find_true_poses
from sequences.recordings.messages import frame_name
from sequences.recordings.source import TF, TF_STATIC, MessageSource, RawMessage, Topic
from sequences.recordings.topics import choose, decode, first
from sequences.trajectories.interpolation import MAX_ODOMETRY_GAP_S

_OFFSET_SEGMENT_S, _OFFSET_STEP_S = 1800.0, 0.02  # of odometry, to find a time offset in


def odometry_track(bag: MessageSource, source: PoseSource, links: Collection[Key] | None) -> Trajectory:
    """The first half hour of odometry, at most fifty poses a second, by one steady clock.

    Args:
        bag: The recording.
        source: The odometry.
        links: Those of tf that tell it, None where a topic of its own does.

    Raises:
        SequenceError: there is none, or the recording is damaged.
    """
    times_ns, numbers = array("q"), array("d")
    step_ns = round(_OFFSET_STEP_S * 1e9)
    for dated in Timeline(bag, {source.topic: links}).messages(source.topic):
        if dated.message is None or not dated.stamps_ns:
            continue
        for sample in source.samples(dated.message)[0]:
            source.append(sample)
        span = source.span_ns
        if span is None or (times_ns and span[1] - times_ns[-1] < step_ns):
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
        raise SequenceError(f"{bag.path}: {source.topic}: no odometry, expected some to find a time offset by")
    table = np.array(numbers).reshape(-1, 7)
    return Trajectory(np.array(times_ns, np.int64), Poses.from_quat_xyzw(table[:, :3], table[:, 3:]))


_IMAGE_STREAMS: dict[str, Callable[[], ImageStream]] = {
    "sensor_msgs/Image": partial(Stills, decode_image),
    "sensor_msgs/CompressedImage": partial(Stills, decode_compressed_image),
    "foxglove_msgs/CompressedVideo": partial(Video, "format"),
    "ffmpeg_image_transport_msgs/FFMPEGPacket": partial(Video, "encoding"),
}
IMAGE_TYPES = tuple(_IMAGE_STREAMS)
_TRANSPORTS = ("compressed", "ffmpeg", "foxglove")  # by the habit of image_transport, the last part of a topic's name


class Roles:
    """Which topic, frame or file plays which role: the one named by an option, or the only one of its kind."""

    def __init__(self, bag: MessageSource, options: SequenceOptions, odometry: OdometryUse, true_poses: TruePoseUse):
        image = choose(bag, "image", IMAGE_TYPES, options.image_topic, required=True)
        assert image is not None
        self.image = image
        self._bag, self._options = bag, options
        self.open_images()  # what it needs may not be installed
        self.odometry_required = odometry == "required"
        self.truth_required = true_poses == "required"
        self.odometry: Topic | None = None
        self.odometry_frame = ""  # of which its poses are, where it is read
        self.tree_odometry: PoseRoute | None = None
        self.extrinsics: Extrinsics | None = None
        given = options.base_from_camera
        rig = Rig(self._camera_frame(), base_from_camera=None if given is None else pose_of_numbers(given))
        if odometry != "unread":
            try:
                rig = self._find_odometry(rig)
            except SequenceError:
                if self.odometry_required:
                    raise
                self.odometry = self.tree_odometry = self.extrinsics = None
        # Where nothing is to be found by itself, an empty name says so.
        needed = self.truth_required and options.ground_truth_topic != ""
        self.truth = find_true_poses(bag, options, rig, required=needed, odometry=self._odometry_track)
        info_name = options.camera_info_topic
        if info_name is None:
            # By the habit of ROS and of Foxglove, the intrinsics lie beside the image topic.
            parts = image.name.split("/")
            folder = "/".join(parts[: -2 if parts[-1] in _TRANSPORTS else -1])
            beside = (f"{folder}/{name}" for name in ("camera_info", "calibration"))
            info_name = next((name for name in beside if name in bag.topics), None)
        self.camera_info = choose(bag, "camera-info", ("sensor_msgs/CameraInfo",), info_name)

    def open_images(self) -> ImageStream:
        """A stream of the images that no message was taken into yet. Raises SequenceError where PyAV is wanting."""
        try:
            return _IMAGE_STREAMS[self.image.read_as]()
        except SequenceError as error:
            raise SequenceError(f"{self._bag.path}: {self.image.name} ({self.image.type}): {error}") from error

    def _camera_frame(self) -> str:
        """Frame of the camera; '' where nothing says it."""
        if self._options.camera_frame:
            return frame_name(self._options.camera_frame)
        try:
            return frame_name(first(self._bag, self.image).header.frame_id)
        except SequenceError:  # told when the images are read
            return ""

    def _find_odometry(self, rig: Rig) -> Rig:
        """Find odometry, of a topic or else of tf, and extrinsics; the rig with what that tells."""
        bag, options = self._bag, self._options
        if options.odometry_frame is not None:
            return self._take_tree(rig)
        try:
            topic = choose(
                bag,
                "odometry",
                ("nav_msgs/Odometry",),
                options.odometry_topic,
                required=True,
                besides=options.ground_truth_topic,
            )
        except NotFoundError as error:
            if options.odometry_topic is not None:
                raise
            try:
                return self._take_tree(rig)
            except NotFoundError as without:
                raise NotFoundError(f"{error}; {str(without).removeprefix(f'{bag.path}: ')}") from error
        assert topic is not None
        self.odometry = topic
        message = first(bag, topic)
        base, frame = frame_name(message.child_frame_id), frame_name(message.header.frame_id)
        self.odometry_frame = frame
        rig = replace(rig, base=base, odometry_topic=topic.name, odometry_frame=frame)
        if rig.base_from_camera is not None:
            self.extrinsics = Extrinsics(rig.base_from_camera)
        else:
            self.extrinsics = find_extrinsics(
                bag, base, rig.camera, body_is=f" ({topic.name}, child frame)", camera_is=f" ({self.image.name})"
            )
        return rig

    def _take_tree(self, rig: Rig) -> Rig:
        self.tree_odometry, rig = tree_odometry(self._bag, self._options, rig)
        self.extrinsics, self.odometry_frame = self.tree_odometry.extrinsics, rig.odometry_frame
        return rig

    def _odometry_track(self) -> Trajectory:
        """The odometry alone, to find a time offset by."""
        if self.tree_odometry is not None:
            source: PoseSource = self.tree_odometry.open()
        elif self.odometry is not None:
            source = poses_of_topic(self.odometry, Poses.identity(), max_gap_s=MAX_ODOMETRY_GAP_S)
        else:
            raise SequenceError(f"{self._bag.path}: no odometry found, expected it for --time-offset-s auto")
        return odometry_track(self._bag, source, None if self.odometry is not None else set(source.links))

    def why_undecodable(self, raw: RawMessage) -> str:
        """What is wrong with bytes that are no message."""
        try:
            decode(self._bag, raw)
        except SequenceError as error:
            return str(error).removeprefix(f"{self._bag.path}: ")
        return ""

    @property
    def watched(self) -> dict[str, set[tuple[str, str]] | None]:
        """Names of the topics that are read from front to back: with the links that count of tf, else None."""
        names: dict[str, set[tuple[str, str]] | None] = {self.image.name: None}
        links: dict[str, set[tuple[str, str]]] = {}
        if self.odometry is not None:
            names[self.odometry.name] = None
        routes = [route for route in (self.tree_odometry, self.truth) if route is not None]
        for route in routes:
            if route.topic == TF:
                links.setdefault(TF, set()).update(route.open().links)
            elif route.topic:
                names[route.topic] = None
        for extrinsics in (self.extrinsics, *(route.extrinsics for route in routes)):
            for step in extrinsics.path if extrinsics is not None else ():
                links.setdefault(TF_STATIC if step.static else TF, set()).add(step.link)
        if self.camera_info is not None:
            names[self.camera_info.name] = None
        return {name: links for name, links in {**names, **links}.items() if name in self._bag}

    @property
    def odometry_keys(self) -> list[tuple[str, str]]:
        """What tells odometry, of `watched`: a topic, or links of tf."""
        if self.tree_odometry is not None:
            return [*self.tree_odometry.open().links]
        return [] if self.odometry is None else [("", self.odometry.name)]

    @property
    def odometry_said(self) -> str:
        """What tells odometry, to name in a message."""
        return f"the tf frame {self.odometry_frame!r}" if self.odometry is None else self.odometry.name

    @property
    def truth_keys(self) -> list[tuple[str, str]]:
        """What tells true poses as a recording is read, likewise."""
        if self.truth is None or not self.truth.topic:
            return []
        return [*self.truth.open().links]
