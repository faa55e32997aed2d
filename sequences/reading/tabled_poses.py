"""Poses of the camera over time that are all known before: from a file, or from nav_msgs/Path."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
from jaxtyping import Float64

from filtering.errors import VaporTrackError
from filtering.se3 import Poses
from sequences.errors import SequenceError
from sequences.frame import Trajectory
from sequences.reading.left_out import Unusable
from sequences.reading.pose_source import MAX_GAP_S, MAX_STILL_GAP_S, Jumps, PoseSource
from sequences.recordings.messages import pose_from_message, stamp_ns
from sequences.recordings.source import MessageSource, Topic
from sequences.recordings.topics import decode, first
from sequences.trajectories.interpolation import pose_at
from sequences.trajectories.pose_window import Motion, is_jump


class TabledPoses(PoseSource):
    """Poses of a body that are all known before, and of the camera that is fixed on it."""

    def __init__(self, trajectory: Trajectory, body_from_camera: Poses) -> None:
        """Set up a source of world_from_body at n ≥ 1 stamps."""
        self._times_ns, self._poses = trajectory.times_ns, trajectory.poses
        self._body_from_camera = body_from_camera
        metres, radians = self._poses[:-1].distance(self._poses[1:])
        seconds = np.diff(self._times_ns) * 1e-9
        steps = [Motion(0.0, 0.0, 0.0), *map(Motion, metres.tolist(), radians.tolist(), seconds.tolist())]
        self._jumps = [i for i in range(1, len(steps)) if is_jump(steps, i)]

    def at(self, time_ns: int) -> Poses | None:
        """The camera's pose, one pose; None where it is not covered."""
        after = min(int(np.searchsorted(self._times_ns, time_ns)), len(self._times_ns) - 1)
        near = slice(max(after - 1, 0), after + 1)
        pose = pose_at(
            self._times_ns[near], self._poses[near], time_ns, max_gap_s=MAX_GAP_S, still_gap_s=MAX_STILL_GAP_S
        )
        return None if pose is None else pose @ self._body_from_camera

    def jumps_at(self, time_ns: int) -> bool:
        """Whether the pose at this time would be interpolated across a jump."""
        after = int(np.searchsorted(self._times_ns, time_ns))
        return after in self._jumps and int(self._times_ns[after]) != time_ns

    def finish(self) -> Jumps:
        """All jumps, once no message comes any more."""
        return Jumps(len(self._jumps), int(self._times_ns[self._jumps[0]]) if self._jumps else None)

    @property
    def span_ns(self) -> tuple[int, int] | None:
        """Stamps between which there are poses; None before any came."""
        return int(self._times_ns[0]), int(self._times_ns[-1])


def read_path(bag: MessageSource, topic: Topic) -> tuple[Trajectory, Unusable]:
    """Poses of nav_msgs/Path: the last message where it begins no later than the first one ends, else what each adds.

    Raises:
        SequenceError: damaged messages, no poses, poses without stamps of their own, or more that cannot be used than
            can.
    """
    unusable = Unusable("true poses", topic.name)
    last = None
    for raw in bag.messages([topic.name]):
        last = raw
    if last is None:
        raise SequenceError(f"{bag.path}: no message on {topic.name}, expected at least one")
    beginning, whole = first(bag, topic), decode(bag, last)
    assert whole is not None
    rows: list[tuple[int, Float64[np.ndarray, " 7"]]] = []
    if beginning.poses and whole.poses and stamp_ns(whole.poses[0].header) <= stamp_ns(beginning.poses[0].header):
        _extend(rows, whole, bag, topic, unusable)
    else:
        for raw in bag.messages([topic.name]):
            message = decode(bag, raw)
            assert message is not None
            _extend(rows, message, bag, topic, unusable)
    unusable.require_few(bag.path)
    if len(rows) < 2:
        raise SequenceError(
            f"{bag.path}: {topic.name}: {len(rows)} poses at stamps of their own, expected at least two whose stamps"
            " increase"
        )
    table = np.stack([row for _, row in rows])
    times_ns = np.array([time_ns for time_ns, _ in rows], np.int64)
    return Trajectory(times_ns, Poses.from_quat_xyzw(table[:, :3], table[:, 3:])), unusable


def _extend(
    rows: list[tuple[int, Float64[np.ndarray, " 7"]]],
    message: SimpleNamespace,
    bag: MessageSource,
    topic: Topic,
    unusable: Unusable,
) -> None:
    """Add the poses of a path that are later than those there are. Raises SequenceError where they share a stamp."""
    if len(message.poses) > 1 and len({stamp_ns(stamped.header) for stamped in message.poses}) == 1:
        raise SequenceError(
            f"{bag.path}: {topic.name} ({topic.type}): {len(message.poses)} poses of one stamp, expected each at a"
            " stamp of its own"
        )
    for stamped in message.poses:
        time_ns = stamp_ns(stamped.header)
        if rows and time_ns <= rows[-1][0]:
            continue
        unusable.total += 1
        try:
            pose = pose_from_message(stamped.pose)
        except VaporTrackError as error:
            unusable.note(time_ns, str(error))
            continue
        rows.append((time_ns, np.concatenate([pose.translation, pose.as_quat_xyzw()])))
