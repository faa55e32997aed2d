"""Where true poses of a recording are: named by an option, or found where there is one candidate; odometry in tf."""

from __future__ import annotations

from array import array
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from filtering.errors import VaporTrackError
from filtering.se3 import Poses
from sequences.bag import TF, Bag, Topic
from sequences.errors import SequenceError
from sequences.extrinsics import Extrinsics, find_extrinsics, read_tree
from sequences.frame import Trajectory
from sequences.messages import frame_name
from sequences.options import SequenceOptions
from sequences.pairing import MAX_ODOMETRY_GAP_S, MAX_TRUE_POSE_GAP_S
from sequences.pose_sources import (
    MAX_GAP_S,
    POSE_TYPES,
    LinkedPoses,
    PoseSource,
    TabledPoses,
    frames_of_topic,
    poses_of_topic,
    poses_of_tree,
    read_path,
)
from sequences.pose_tables import read_pose_table
from sequences.time_offset import find_time_offset
from sequences.topics import choose, decode, listing
from sequences.transforms import Step, TransformTree, along

_SURVEY_S = 60.0  # of /tf that is read to find frames that nobody named
_OFFSET_SEGMENT_S, _OFFSET_STEP_S = 1800.0, 0.02  # of odometry, to find a time offset in
_CAMERA_POSES = "geometry_msgs/PoseStamped"
_BASES = ("base_link", "base_footprint")


@dataclass(frozen=True)
class Rig:
    """The names by which tf knows a camera, and the body that its odometry is of.

    Attributes:
        camera: Frame of the camera.
        base: Frame of the body; '' where no odometry is read.
        base_from_camera: The pose of one on the other where an option gives it.
        odometry_topic: Topic of the odometry, which is none of true poses unless named; '' where there is none.
        odometry_frame: Frame that the odometry is in; '' where none is read.
    """

    camera: str
    base: str = ""
    base_from_camera: Poses | None = None
    odometry_topic: str = ""
    odometry_frame: str = ""

    def on(self, bag: Bag, body: str, body_is: str = "") -> Extrinsics:
        """Where the camera sits on a body. Raises SequenceError where neither tf nor the option says it."""
        if not body or body == self.camera:
            return Extrinsics(Poses.identity())
        if self.base_from_camera is None:
            return find_extrinsics(
                bag, body, self.camera, body_is=body_is, instead="--ground-truth-child-frame or --base-from-camera"
            )
        if self.base in ("", body):
            return Extrinsics(self.base_from_camera)
        carrier = find_extrinsics(bag, body, self.base, body_is=body_is, instead="--ground-truth-child-frame")
        return replace(carrier, body_from_camera=carrier.body_from_camera @ self.base_from_camera)

    def path(self, tree: TransformTree, frame: str) -> list[Step] | None:
        """The links from a frame to the camera, or to the body on which an option says where it sits."""
        return tree.path(frame, self.camera if self.base_from_camera is None else self._carrier(tree, frame))

    def _carrier(self, tree: TransformTree, frame: str) -> str:
        if self.base:
            return self.base
        return next((name for name in _BASES if frame in tree.ancestors(name)), self.camera)

    @property
    def end(self) -> Poses:
        """What follows at the end of such a path, one pose."""
        return Poses.identity() if self.base_from_camera is None else self.base_from_camera


@dataclass(frozen=True)
class PoseRoute:
    """How poses over time are to be had.

    Attributes:
        said: What it is, for messages.
        topic: Where its messages are; '' for none.
        open: A source of them that no message was taken into yet.
        extrinsics: Where the camera sits on the body that they are of.
        resolved: The options that would choose it.
        notices: What a person should know of it.
    """

    said: str
    topic: str
    open: Callable[[], PoseSource]
    extrinsics: Extrinsics
    resolved: dict[str, object]
    notices: list[str] = field(default_factory=list)


def tree_odometry(bag: Bag, options: SequenceOptions, rig: Rig) -> tuple[PoseRoute, Rig]:
    """Odometry as tf has it: poses of a base in a frame such as odom, to which the camera is fixed.

    Raises:
        SequenceError: no such frame is above the camera, or nothing moves in between.
    """
    frame = frame_name(options.odometry_frame or "odom")
    within_s = None if options.odometry_frame else _SURVEY_S
    tree = read_tree(bag, lambda tree: rig.path(tree, frame) is not None, within_s=within_s)
    path = rig.path(tree, frame)
    moving = [i for i, step in enumerate(path or ()) if not step.static]
    if path is None or not moving:
        raise SequenceError(
            f"{bag.path}: tf has no {frame!r} in which {rig.camera!r} moves (--odometry-frame), found frames:"
            f" {', '.join(tree.frames) or 'none'}"
        )
    links, fixed = path[: moving[-1] + 1], path[moving[-1] + 1 :]
    base = links[-1].parent if links[-1].upwards else links[-1].child
    base_from_camera = along(fixed, [step.parent_from_child for step in fixed]) @ rig.end

    def source() -> LinkedPoses:
        return poses_of_tree(links, Poses.identity(), max_gap_s=MAX_ODOMETRY_GAP_S, watch_jumps=False)

    route = PoseRoute(f"tf frame {frame}", TF, source, Extrinsics(base_from_camera), {"odometry_frame": frame})
    end = path[-1].parent if path[-1].upwards else path[-1].child
    return route, replace(rig, odometry_frame=frame, base=base if rig.base_from_camera is None else end)


def find_true_poses(
    bag: Bag, options: SequenceOptions, rig: Rig, *, required: bool, odometry: Callable[[], Trajectory]
) -> PoseRoute | None:
    """The true poses that options name, else the only ones that there are.

    Args:
        bag: The recording.
        options: What was named.
        rig: The camera, and what is known of where it sits.
        required: Whether to fail where none or several are found, rather than do without.
        odometry: Makes the odometry, to find a time offset by.

    Raises:
        SequenceError: what was named is not there or cannot be used, or there is nothing to choose by itself.
    """
    if options.poses is not None:
        return _of_file(bag, options, rig, odometry)
    if options.ground_truth_frame is not None:
        return _of_tree(bag, options, rig, frame_name(options.ground_truth_frame))
    if options.ground_truth_topic is not None:
        topic = choose(bag, "ground-truth", POSE_TYPES, options.ground_truth_topic)
        return None if topic is None else _of_topic(bag, options, rig, topic)
    topic = choose(bag, "ground-truth", (_CAMERA_POSES,), None)
    if topic is not None:
        return _of_topic(bag, options, rig, topic)
    return _only_candidate(bag, options, rig, required=required)


def _only_candidate(bag: Bag, options: SequenceOptions, rig: Rig, *, required: bool) -> PoseRoute | None:
    topics, others = [], []
    for topic in bag.topics.values():
        enough = topic.num_messages > (topic.read_as != "nav_msgs/Path")  # one pose is a goal or a start
        if topic.read_as in POSE_TYPES and enough and topic.encoding in topic.encodings:
            try:
                frame, _ = frames_of_topic(bag, topic)
            except SequenceError:  # nothing readable on it
                continue
            is_odometry = topic.name == rig.odometry_topic or _is_odometry(frame, rig)
            (others if is_odometry else topics).append(topic)
    tree = read_tree(bag, within_s=_SURVEY_S, tolerate=True) if TF in bag else TransformTree()
    frames = _frames_that_could(tree, rig)
    number = len(topics) + bool(frames)
    if number == 1:
        try:
            if topics:
                return _of_topic(bag, options, rig, topics[0])
            return _of_tree(bag, options, rig, "map" if "map" in frames else frames[-1])
        except SequenceError:
            if required:
                raise
            return None
    if not required:
        return None
    could = [f"{t.name} ({t.type}: --ground-truth-topic {t.name})" for t in topics]
    could += [f"tf frame {name} (--ground-truth-frame {name})" for name in frames]
    could += [f"{t.name}, odometry as it seems ({t.type}: --ground-truth-topic {t.name})" for t in others]
    if could:
        raise SequenceError(
            f"{bag.path}: no true poses found without a choice to make, expected one of: {'; '.join(could)}; or a file"
            " of poses (--poses)"
        )
    raise SequenceError(
        f"{bag.path}: no true poses: expected a topic of type {', '.join(POSE_TYPES)}, a frame of tf in which"
        f" {rig.camera!r} moves (found frames: {', '.join(tree.frames) or 'none'}), or a file of poses (--poses);"
        f" {listing(bag.topics.values())}"
    )


def _is_odometry(frame: str, rig: Rig) -> bool:
    return "odom" in frame.rsplit("/", 1)[-1] or (frame != "" and frame == rig.odometry_frame)


def _frames_that_could(tree: TransformTree, rig: Rig) -> list[str]:
    """Frames in which the camera moves, from the lowest: those above a frame of odometry, or the highest."""
    path_to = {frame: rig.path(tree, frame) for frame in tree.frames}
    bodies = [rig.camera] if rig.base_from_camera is None else [rig.base, *_BASES]
    above = max((tree.ancestors(body) for body in bodies), key=len)
    odometry = [i for i, frame in enumerate(above) if _is_odometry(frame, rig)]
    above = above[odometry[-1] + 1 :] if odometry else above[-1:]
    return [frame for frame in above if any(not step.static for step in path_to.get(frame) or ())]


def _of_topic(bag: Bag, options: SequenceOptions, rig: Rig, topic: Topic) -> PoseRoute:
    """Poses of a topic. Raises SequenceError where nothing says where the camera sits on the body that they are of."""
    resolved: dict[str, object] = {"ground_truth_topic": topic.name}
    child = frame_name(options.ground_truth_child_frame or "")
    if not child and topic.num_messages:
        child = frames_of_topic(bag, topic)[1]
    extrinsics = rig.on(bag, child, f" ({topic.name})")
    notices = []
    if not child and topic.read_as != _CAMERA_POSES:
        notices.append(
            f"{topic.name} ({topic.type}) names no child frame: taken for poses of the camera itself"
            " (--ground-truth-child-frame says otherwise)"
        )
    if topic.read_as == "nav_msgs/Path":
        table = TabledPoses(read_path(bag, topic), extrinsics.body_from_camera)
        return PoseRoute(topic.name, "", lambda: table, extrinsics, resolved, notices)
    gap_s = MAX_TRUE_POSE_GAP_S if topic.read_as == _CAMERA_POSES else MAX_GAP_S

    def source() -> LinkedPoses:
        return poses_of_topic(topic, extrinsics.body_from_camera, max_gap_s=gap_s)

    return PoseRoute(topic.name, topic.name, source, extrinsics, resolved, notices)


def _of_tree(bag: Bag, options: SequenceOptions, rig: Rig, frame: str) -> PoseRoute:
    """Poses of the camera in a frame of tf. Raises SequenceError where no transforms lead there, or none moves."""
    if options.ground_truth_child_frame is not None and rig.base_from_camera is not None:
        rig = replace(rig, base=frame_name(options.ground_truth_child_frame))
    tree = read_tree(bag, lambda tree: rig.path(tree, frame) is not None)
    links = rig.path(tree, frame)
    if links is None:
        raise SequenceError(
            f"{bag.path}: no transforms from {frame!r} (--ground-truth-frame) to the camera's {rig.camera!r} on"
            f" /tf_static or /tf, found frames: {', '.join(tree.frames) or 'none'}; expected a chain of transforms"
            " between the two (or name --camera-frame, or give --base-from-camera)"
        )
    if all(step.static for step in links):
        raise SequenceError(
            f"{bag.path}: {rig.camera!r} never moves in {frame!r} (--ground-truth-frame), expected a transform on /tf"
            " between the two"
        )

    def source() -> LinkedPoses:
        return poses_of_tree(links, rig.end, max_gap_s=MAX_GAP_S)

    return PoseRoute(f"tf frame {frame}", TF, source, Extrinsics(rig.end), {"ground_truth_frame": frame})


def _of_file(bag: Bag, options: SequenceOptions, rig: Rig, odometry: Callable[[], Trajectory]) -> PoseRoute:
    """Poses of the file that the options name; the odometry is to find a time offset by.

    Raises:
        SequenceError: the file cannot be used, nothing says where the camera sits, or the rotation tells no offset.
    """
    file = Path(options.poses or "")
    trajectory = read_pose_table(file, options.poses_times)
    extrinsics = rig.on(bag, frame_name(options.ground_truth_child_frame or ""), " (--ground-truth-child-frame)")
    offset_s, notices = options.time_offset_s, []
    if offset_s == "auto":
        try:
            offset_s = find_time_offset(odometry(), trajectory)
        except VaporTrackError as error:
            raise SequenceError(f"{file}: {error}") from error
        notices.append(f"{file}: time offset {offset_s:.4f} s found by rotation")
    table = TabledPoses(
        replace(trajectory, times_ns=trajectory.times_ns + round(offset_s * 1e9)), extrinsics.body_from_camera
    )
    resolved: dict[str, object] = {"poses": file.name, "time_offset_s": offset_s}
    return PoseRoute(str(file), "", lambda: table, extrinsics, resolved, notices)


def odometry_track(bag: Bag, source: PoseSource) -> Trajectory:
    """The first half hour of odometry, at most fifty poses a second."""
    times_ns, numbers = array("q"), array("d")
    step_ns = round(_OFFSET_STEP_S * 1e9)
    for raw in bag.messages([source.topic]):
        message = decode(bag, raw)
        assert message is not None
        for sample in source.samples(message):
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
