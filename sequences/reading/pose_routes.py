"""Where poses over time come from: a topic, tf or a file."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

from filtering.errors import VaporTrackError
from filtering.se3 import Poses
from sequences.errors import NotFoundError, SequenceError
from sequences.files import Rows
from sequences.frame import Trajectory
from sequences.options import SequenceOptions
from sequences.reading.extrinsics import Extrinsics, Rig, read_tree
from sequences.reading.linked_poses import LinkedPoses, frames_of_topic, poses_of_topic, poses_of_tree
from sequences.reading.pose_source import MAX_GAP_S, PoseSource
from sequences.reading.tabled_poses import TabledPoses, read_path
from sequences.recordings.messages import frame_name
from sequences.recordings.source import TF, MessageSource, Topic
from sequences.recordings.transforms import along
from sequences.trajectories.interpolation import MAX_ODOMETRY_GAP_S, MAX_TRUE_POSE_GAP_S
from sequences.trajectories.pose_tables import read_pose_table

SURVEY_S = 60.0  # of /tf that is read to find frames that nobody named
CAMERA_POSES = "geometry_msgs/PoseStamped"


@dataclass(frozen=True)
class PoseRoute:
    """Where poses over time come from, and how to read them.

    Attributes:
        said: What people call it, in messages.
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


def tree_odometry(bag: MessageSource, options: SequenceOptions, rig: Rig) -> tuple[PoseRoute, Rig]:
    """Odometry as tf has it: poses of a base in a frame such as odom, to which the camera is fixed.

    Raises:
        NotFoundError: no such frame is above the camera, or nothing moves in between.
    """
    frame = frame_name(options.odometry_frame or "odom")
    within_s = None if options.odometry_frame else SURVEY_S
    tree = read_tree(bag, lambda tree: rig.path(tree, frame) is not None, within_s=within_s)
    path = rig.path(tree, frame)
    moving = [i for i, step in enumerate(path or ()) if not step.static]
    if path is None or not moving:
        raise NotFoundError(
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


def route_of_topic(bag: MessageSource, options: SequenceOptions, rig: Rig, topic: Topic) -> PoseRoute:
    """Poses of a topic. Raises SequenceError where nothing says where the camera sits on the body that they are of."""
    resolved: dict[str, object] = {"ground_truth_topic": topic.name}
    child = frame_name(options.ground_truth_child_frame or "")
    if not child and topic.num_messages:
        child = frames_of_topic(bag, topic)[1]
    extrinsics = rig.on(bag, child, f" ({topic.name})")
    notices = []
    if not child and topic.read_as != CAMERA_POSES:
        notices.append(
            f"{topic.name} ({topic.type}) names no child frame: taken for poses of the camera itself"
            " (--ground-truth-child-frame says otherwise)"
        )
    if topic.read_as == "nav_msgs/Path":
        poses, unusable = read_path(bag, topic)
        notices += unusable.notices
        table = TabledPoses(poses, extrinsics.body_from_camera)
        return PoseRoute(topic.name, "", lambda: table, extrinsics, resolved, notices)
    gap_s = MAX_TRUE_POSE_GAP_S if topic.read_as == CAMERA_POSES else MAX_GAP_S

    def source() -> LinkedPoses:
        return poses_of_topic(topic, extrinsics.body_from_camera, max_gap_s=gap_s)

    return PoseRoute(topic.name, topic.name, source, extrinsics, resolved, notices)


def route_of_tree(bag: MessageSource, options: SequenceOptions, rig: Rig, frame: str) -> PoseRoute:
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


def route_of_file(
    bag: MessageSource, options: SequenceOptions, rig: Rig, odometry: Callable[[], Trajectory]
) -> PoseRoute:
    """Poses of the file that the options name; the odometry is to find a time offset by.

    Raises:
        SequenceError: the file cannot be used, nothing says where the camera sits, or the rotation tells no offset.
    """
    file = Path(options.poses or "")
    rows = Rows("poses")
    trajectory = read_pose_table(file, options.poses_times, rows, options.poses_columns)
    extrinsics = rig.on(bag, frame_name(options.ground_truth_child_frame or ""), " (--ground-truth-child-frame)")
    offset_s, notices = options.time_offset_s, rows.notices
    if offset_s == "auto":
        from sequences.trajectories.time_offset import offset_of_clocks  # loads SciPy's signals, which takes a while

        try:
            track = odometry()
        except VaporTrackError as error:
            raise SequenceError(f"{file}: {error}") from error
        offset_s, found = offset_of_clocks("auto", track, trajectory, str(file))
        notices += found
    table = TabledPoses(
        replace(trajectory, times_ns=trajectory.times_ns + round(offset_s * 1e9)), extrinsics.body_from_camera
    )
    resolved: dict[str, object] = {"poses": file.name, "time_offset_s": offset_s}
    return PoseRoute(str(file), "", lambda: table, extrinsics, resolved, notices)
