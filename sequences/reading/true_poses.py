"""Which poses of a recording are the true ones: those that options name, else the only candidate."""

from __future__ import annotations

from collections.abc import Callable

from sequences.errors import SequenceError
from sequences.frame import Trajectory
from sequences.options import SequenceOptions
from sequences.reading.extrinsics import BASES, Rig, read_tree
from sequences.reading.linked_poses import POSE_TYPES, frames_of_topic
from sequences.reading.pose_routes import (
    CAMERA_POSES,
    SURVEY_S,
    PoseRoute,
    route_of_file,
    route_of_topic,
    route_of_tree,
)
from sequences.recordings.messages import frame_name
from sequences.recordings.source import TF, MessageSource
from sequences.recordings.topics import choose, listing
from sequences.recordings.transforms import TransformTree


def find_true_poses(
    bag: MessageSource, options: SequenceOptions, rig: Rig, *, required: bool, odometry: Callable[[], Trajectory]
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
        return route_of_file(bag, options, rig, odometry)
    if options.ground_truth_frame is not None:
        return route_of_tree(bag, options, rig, frame_name(options.ground_truth_frame))
    if options.ground_truth_topic is not None:
        topic = choose(bag, "ground-truth", POSE_TYPES, options.ground_truth_topic)
        return None if topic is None else route_of_topic(bag, options, rig, topic)
    topic = choose(bag, "ground-truth", (CAMERA_POSES,), None)
    if topic is not None:
        return route_of_topic(bag, options, rig, topic)
    return _only_candidate(bag, options, rig, required=required)


def _only_candidate(bag: MessageSource, options: SequenceOptions, rig: Rig, *, required: bool) -> PoseRoute | None:
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
    tree = read_tree(bag, within_s=SURVEY_S) if TF in bag else TransformTree()
    frames = _frames_that_could(tree, rig)
    number = len(topics) + bool(frames)
    if number == 1:
        try:
            if topics:
                return route_of_topic(bag, options, rig, topics[0])
            return route_of_tree(bag, options, rig, "map" if "map" in frames else frames[-1])
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
    bodies = [rig.camera] if rig.base_from_camera is None else [rig.base, *BASES]
    above = max((tree.ancestors(body) for body in bodies), key=len)
    odometry = [i for i, frame in enumerate(above) if _is_odometry(frame, rig)]
    above = above[odometry[-1] + 1 :] if odometry else above[-1:]
    return [frame for frame in above if any(not step.static for step in path_to.get(frame) or ())]
