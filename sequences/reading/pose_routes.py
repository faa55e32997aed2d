"""Where odometry of tf and true poses come from: the topic, frame or file of an option, else the only candidate."""

from __future__ import annotations

import shlex
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

from filtering.errors import VaporTrackError
from filtering.se3 import Poses
from sequences.errors import NotFoundError, SequenceError
from sequences.files import Rows
from sequences.frame import Trajectory
from sequences.options import SequenceOptions
from sequences.reading.extrinsics import BASES, CameraMount, Extrinsics, TransformTree, along, read_tree
from sequences.reading.pose_sources import (
    MAX_GAP_S,
    POSE_TYPES,
    PoseSource,
    TabledPoses,
    frames_of_topic,
    poses_of_topic,
    poses_of_tree,
    read_path,
)
from sequences.recordings.messages import frame_name
from sequences.recordings.source import TF, MessageSource, Topic, choose, listing
from sequences.trajectories.interpolation import MAX_ODOMETRY_GAP_S, MAX_TRUE_POSE_GAP_S
from sequences.trajectories.pose_tables import read_pose_table

_SURVEY_S = 60.0  # of /tf that is read to find frames that nobody named
_CAMERA_POSES = "geometry_msgs/PoseStamped"


@dataclass(frozen=True)
class PoseRoute:
    """Where poses over time come from, and how to read them.

    Attributes:
        label: Its name in messages to people.
        topic: Topic of its messages; '' for none.
        open: Makes a source that took no message yet.
        extrinsics: The camera's mount on the body of the poses.
        resolved: The options that would choose it.
    """

    label: str
    topic: str
    open: Callable[[], PoseSource]
    extrinsics: Extrinsics
    resolved: dict[str, object]
    notices: list[str] = field(default_factory=list)


def tree_odometry(bag: MessageSource, options: SequenceOptions, mount: CameraMount) -> tuple[PoseRoute, CameraMount]:
    """Odometry of tf: poses of a base, to which the camera is fixed, in a frame such as odom.

    Raises NotFoundError where no such frame is above the camera, or nothing moves in between.
    """
    frame = frame_name(options.odometry_frame or "odom")
    within_s = None if options.odometry_frame else _SURVEY_S
    tree = read_tree(bag, lambda tree: mount.path(tree, frame) is not None, within_s=within_s)
    path = mount.path(tree, frame)
    moving = [i for i, step in enumerate(path or ()) if not step.static]
    if path is None or not moving:
        raise NotFoundError(
            f"{bag.path}: tf has no {frame!r} in which {mount.camera!r} moves (--odometry-frame), found frames:"
            f" {', '.join(tree.frames) or 'none'}"
        )
    links, fixed = path[: moving[-1] + 1], path[moving[-1] + 1 :]
    base, end = (steps[-1].parent if steps[-1].upwards else steps[-1].child for steps in (links, path))

    source = partial(poses_of_tree, links, Poses.identity(), max_gap_s=MAX_ODOMETRY_GAP_S, watch_jumps=False)
    extrinsics = Extrinsics(along(fixed) @ mount.end)
    route = PoseRoute(f"tf frame {frame}", TF, source, extrinsics, {"odometry_frame": frame})
    return route, replace(mount, odometry_frame=frame, base=base if mount.base_from_camera is None else end)


def find_true_poses(
    bag: MessageSource,
    options: SequenceOptions,
    mount: CameraMount,
    *,
    required: bool,
    odometry: Callable[[], Trajectory],
) -> PoseRoute | None:
    """The true poses that options name, else the only candidate; `odometry` reads it to find a time offset by.

    Raises SequenceError where the named poses are missing or cannot be used; or they are required, and there is no
    single candidate.
    """
    if options.poses is not None:
        return _route_of_file(bag, options, mount, odometry)
    if options.ground_truth_frame is not None:
        return _route_of_tree(bag, options, mount, frame_name(options.ground_truth_frame))
    if options.ground_truth_topic is not None:
        topic = choose(bag, "ground-truth", POSE_TYPES, options.ground_truth_topic)
        return None if topic is None else _route_of_topic(bag, options, mount, topic)
    topic = choose(bag, "ground-truth", (_CAMERA_POSES,), None)
    if topic is not None:
        return _route_of_topic(bag, options, mount, topic)
    return _only_candidate(bag, options, mount, required=required)


def _route_of_topic(bag: MessageSource, options: SequenceOptions, mount: CameraMount, topic: Topic) -> PoseRoute:
    resolved: dict[str, object] = {"ground_truth_topic": topic.name}
    child = frame_name(options.ground_truth_child_frame or "")
    if not child and topic.num_messages:
        child = frames_of_topic(bag, topic)[1]
    extrinsics = mount.on(bag, child, f" ({topic.name})")
    notices = []
    if not child and topic.read_as != _CAMERA_POSES:
        notices.append(
            f"{topic.name} ({topic.type}) names no child frame: taken for poses of the camera itself"
            " (--ground-truth-child-frame names another)"
        )
    if topic.read_as == "nav_msgs/Path":
        poses, unusable = read_path(bag, topic)
        table = TabledPoses(poses, extrinsics.body_from_camera)
        return PoseRoute(topic.name, "", lambda: table, extrinsics, resolved, notices + unusable.notices)
    gap_s = MAX_TRUE_POSE_GAP_S if topic.read_as == _CAMERA_POSES else MAX_GAP_S
    source = partial(poses_of_topic, topic, extrinsics.body_from_camera, max_gap_s=gap_s)
    return PoseRoute(topic.name, topic.name, source, extrinsics, resolved, notices)


def _route_of_tree(bag: MessageSource, options: SequenceOptions, mount: CameraMount, frame: str) -> PoseRoute:
    """Poses of the camera in a frame of tf. Raises SequenceError where no transforms lead there, or none moves."""
    if options.ground_truth_child_frame is not None and mount.base_from_camera is not None:
        mount = replace(mount, base=frame_name(options.ground_truth_child_frame))
    tree = read_tree(bag, lambda tree: mount.path(tree, frame) is not None)
    links = mount.path(tree, frame)
    if links is None:
        raise SequenceError(
            f"{bag.path}: no transforms from {frame!r} (--ground-truth-frame) to the camera's {mount.camera!r} on"
            f" /tf_static or /tf, found frames: {', '.join(tree.frames) or 'none'}; expected a chain of transforms"
            " between the two (or name --camera-frame, or give --base-from-camera)"
        )
    if all(step.static for step in links):
        raise SequenceError(
            f"{bag.path}: {mount.camera!r} never moves in {frame!r} (--ground-truth-frame), expected a transform on /tf"
            " between the two"
        )
    source = partial(poses_of_tree, links, mount.end, max_gap_s=MAX_GAP_S)
    return PoseRoute(f"tf frame {frame}", TF, source, Extrinsics(mount.end), {"ground_truth_frame": frame})


def _route_of_file(
    bag: MessageSource, options: SequenceOptions, mount: CameraMount, odometry: Callable[[], Trajectory]
) -> PoseRoute:
    file = Path(options.poses or "")
    rows = Rows("poses")
    trajectory = read_pose_table(file, rows, options.poses_columns)
    extrinsics = mount.on(bag, frame_name(options.ground_truth_child_frame or ""), " (--ground-truth-child-frame)")
    offset_s, notices = options.time_offset_s, rows.notices
    if offset_s == "auto":
        from sequences.trajectories.time_offset import offset_of_clocks  # loads SciPy's signals, which takes a while

        try:
            track = odometry()
        except VaporTrackError as error:
            raise SequenceError(f"{file}: {error}") from error
        offset_s, found = offset_of_clocks("auto", track, trajectory, str(file))
        notices += found
    trajectory = replace(trajectory, times_ns=trajectory.times_ns + round(offset_s * 1e9))
    table = TabledPoses(trajectory, extrinsics.body_from_camera)
    resolved: dict[str, object] = {"poses": file.name, "time_offset_s": offset_s}
    return PoseRoute(str(file), "", lambda: table, extrinsics, resolved, notices)


def _only_candidate(
    bag: MessageSource, options: SequenceOptions, mount: CameraMount, *, required: bool
) -> PoseRoute | None:
    topics, others = [], []
    for topic in bag.topics.values():
        enough = topic.num_messages > (topic.read_as != "nav_msgs/Path")  # one pose is a goal or a start
        if topic.read_as in POSE_TYPES and enough and topic.encoding in topic.encodings:
            try:
                frame, _ = frames_of_topic(bag, topic)
            except SequenceError:  # nothing readable on it
                continue
            is_odometry = topic.name == mount.odometry_topic or _is_odometry(frame, mount)
            (others if is_odometry else topics).append(topic)
    tree = read_tree(bag, within_s=_SURVEY_S) if TF in bag else TransformTree()
    frames = _frames_that_could(tree, mount)
    if len(topics) + bool(frames) == 1:
        try:
            if topics:
                return _route_of_topic(bag, options, mount, topics[0])
            return _route_of_tree(bag, options, mount, "map" if "map" in frames else frames[-1])
        except SequenceError:
            if required:
                raise
            return None
    if not required:
        return None
    could = [f"{t.name} ({t.type}: --ground-truth-topic {t.name})" for t in topics]
    could += [f"tf frame {name} (--ground-truth-frame {name})" for name in frames]
    could += [f"{t.name}, odometry as it seems ({t.type}: --ground-truth-topic {t.name})" for t in others]
    camera = [] if options.image_topic is None else ["--image-topic", options.image_topic]
    made = f"`{shlex.join(['vapor-track', 'map', str(bag.path), *camera, '--output', 'place/'])}` makes them"
    if could:
        raise SequenceError(
            f"{bag.path}: no true poses found without a choice to make, expected one of: {'; '.join(could)}; or a file"
            f" of poses (--poses); {made}"
        )
    raise SequenceError(
        f"{bag.path}: no true poses: expected a topic of type {', '.join(POSE_TYPES)}, a frame of tf in which"
        f" {mount.camera!r} moves (found frames: {', '.join(tree.frames) or 'none'}), or a file of poses (--poses);"
        f" {made}; {listing(bag.topics.values())}"
    )


def _is_odometry(frame: str, mount: CameraMount) -> bool:
    return "odom" in frame.rsplit("/", 1)[-1] or (frame != "" and frame == mount.odometry_frame)


def _frames_that_could(tree: TransformTree, mount: CameraMount) -> list[str]:
    """Frames in which the camera moves, from the lowest: those above a frame of odometry, or the highest."""
    bodies = [mount.camera] if mount.base_from_camera is None else [mount.base, *BASES]
    above = max((tree.ancestors(body) for body in bodies), key=len)
    odometry = [i for i, frame in enumerate(above) if _is_odometry(frame, mount)]
    above = above[odometry[-1] + 1 :] if odometry else above[-1:]
    return [frame for frame in above if any(not step.static for step in mount.path(tree, frame) or ())]
