"""Poses of the camera over time, from a topic, from tf or from a table, asked for one time after the other."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from filtering.errors import VaporTrackError
from filtering.se3 import Poses
from sequences.bag import TF, Bag, Topic
from sequences.errors import SequenceError
from sequences.frame import Trajectory
from sequences.messages import frame_name, pose_from_message, pose_from_transform, stamp_ns, transforms_from_message
from sequences.pairing import Motion, PoseWindow, is_jump, pose_at
from sequences.topics import decode, first
from sequences.transforms import Step, along

MAX_GAP_S = 0.25
MAX_STILL_GAP_S = 2.0

_POSE_OF: Mapping[str, Callable[[SimpleNamespace], Poses]] = {
    "geometry_msgs/PoseStamped": lambda message: pose_from_message(message.pose),
    "geometry_msgs/PoseWithCovarianceStamped": lambda message: pose_from_message(message.pose.pose),
    "geometry_msgs/TransformStamped": lambda message: pose_from_transform(message.transform),
    "nav_msgs/Odometry": lambda message: pose_from_message(message.pose.pose),
}
POSE_TYPES = (*_POSE_OF, "nav_msgs/Path")


class Sample(NamedTuple):
    """One pose out of a message: of which link it is, its stamp, and itself."""

    link: tuple[str, str]
    time_ns: int
    pose: Poses


class Jumps(NamedTuple):
    """How many jumps there are, and when the first was over, integer nanoseconds."""

    number: int
    first_ns: int | None


class PoseSource(ABC):
    """Poses of the camera in one frame over time, taken in as a recording is read.

    Attributes:
        topic: Where its messages are; empty where all poses are known before, and none is taken in.
    """

    topic: str = ""

    def samples(self, message: SimpleNamespace) -> list[Sample]:
        """What a message says. Raises VaporTrackError where that is no pose."""
        return []

    def append(self, sample: Sample) -> bool:
        """Take it in; False where it is earlier than the one before, or a second one of its time."""
        return True

    def reaches(self, time_ns: int) -> bool:
        """Whether all that is to know about this time has come."""
        return True

    def forget_before(self, time_ns: int) -> None:
        """Be told that no earlier time is asked for any more."""
        return

    @abstractmethod
    def at(self, time_ns: int) -> Poses | None:
        """The camera's pose, one pose; None where it is not covered."""

    @abstractmethod
    def jumps_at(self, time_ns: int) -> bool:
        """Whether the pose at this time would be interpolated across a jump."""

    @abstractmethod
    def finish(self) -> Jumps:
        """All jumps, once no message comes any more."""

    @property
    @abstractmethod
    def span_ns(self) -> tuple[int, int] | None:
        """Stamps between which there are poses; None before any came."""


class LinkedPoses(PoseSource):
    """Poses along a path of links, each of them interpolated in time by itself; the camera is fixed at its end."""

    def __init__(
        self,
        topic: str,
        path: Sequence[Step],
        body_from_camera: Poses,
        read: Callable[[SimpleNamespace], list[Sample]],
        *,
        max_gap_s: float,
        still_gap_s: float = 0.0,
        watch_jumps: bool = True,
    ) -> None:
        """Set up a source.

        Args:
            topic: Where its messages are.
            path: The links, of which those that are not static are told by messages.
            body_from_camera: What follows at the end of the path, one pose.
            read: What a message says of those.
            max_gap_s: As of `PoseWindow`.
            still_gap_s: Likewise.
            watch_jumps: Likewise.
        """
        self.topic = topic
        self._path = path
        self._body_from_camera = body_from_camera
        self._read = read
        self._windows = {step.link: PoseWindow(max_gap_s, still_gap_s, watch_jumps) for step in path if not step.static}

    def samples(self, message: SimpleNamespace) -> list[Sample]:
        """What a message says of the links. Raises VaporTrackError where that is no pose."""
        return self._read(message)

    def append(self, sample: Sample) -> bool:
        """Take it in; False where it is earlier than the one before of its link."""
        window = self._windows[sample.link]
        # tf tells the same transform again and again.
        return window.append(sample.time_ns, sample.pose) or (self.topic == TF and sample.time_ns == window.end_ns)

    def reaches(self, time_ns: int) -> bool:
        """Whether all links have come so far."""
        return all(window.reaches(time_ns) for window in self._windows.values())

    def at(self, time_ns: int) -> Poses | None:
        """The camera's pose, one pose; None where it is not covered."""
        told = {link: window.at(time_ns) for link, window in self._windows.items()}
        poses = [told.get(step.link, step.parent_from_child) for step in self._path]
        known = [pose for pose in poses if pose is not None]
        return along(self._path, known) @ self._body_from_camera if len(known) == len(poses) else None

    def jumps_at(self, time_ns: int) -> bool:
        """Whether the pose at this time would be interpolated across a jump."""
        return any(window.jumps_at(time_ns) for window in self._windows.values())

    def forget_before(self, time_ns: int) -> None:
        """Drop what no earlier time needs."""
        for window in self._windows.values():
            window.forget_before(time_ns)

    def finish(self) -> Jumps:
        """All jumps, once no message comes any more."""
        for window in self._windows.values():
            window.finish()
        firsts = [w.first_jump_ns for w in self._windows.values() if w.first_jump_ns is not None]
        return Jumps(sum(w.num_jumps for w in self._windows.values()), min(firsts, default=None))

    @property
    def span_ns(self) -> tuple[int, int] | None:
        """Stamps between which there are poses; None before any came."""
        begins = [w.begin_ns for w in self._windows.values() if w.begin_ns is not None]
        ends = [w.end_ns for w in self._windows.values() if w.end_ns is not None]
        return (max(begins), min(ends)) if begins and len(begins) == len(self._windows) else None


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


def poses_of_topic(topic: Topic, body_from_camera: Poses, *, max_gap_s: float) -> LinkedPoses:
    """Poses of a body that a topic tells, of any type but a path, and of the camera that is fixed on it."""
    link, pose_of = ("", topic.name), _POSE_OF[topic.read_as]

    def read(message: SimpleNamespace) -> list[Sample]:
        return [Sample(link, stamp_ns(message.header), pose_of(message))]

    path = [Step(*link, Poses.identity(), static=False, upwards=False)]
    return LinkedPoses(topic.name, path, body_from_camera, read, max_gap_s=max_gap_s)


def poses_of_tree(
    path: Sequence[Step], body_from_camera: Poses, *, max_gap_s: float, watch_jumps: bool = True
) -> LinkedPoses:
    """Poses along a path of tf, and of the camera that is fixed at its end."""

    links = {step.link for step in path if not step.static}

    def read(message: SimpleNamespace) -> list[Sample]:
        told = transforms_from_message(message, links)
        return [Sample((t.parent, t.child), t.time_ns, t.parent_from_child) for t in told]

    return LinkedPoses(
        TF, path, body_from_camera, read, max_gap_s=max_gap_s, still_gap_s=MAX_STILL_GAP_S, watch_jumps=watch_jumps
    )


def frames_of_topic(bag: Bag, topic: Topic) -> tuple[str, str]:
    """Frame that the poses of a topic are in, and the one that they are of; '' where that is not said."""
    message = first(bag, topic)
    return frame_name(message.header.frame_id), frame_name(getattr(message, "child_frame_id", ""))


def read_path(bag: Bag, topic: Topic) -> Trajectory:
    """Poses of nav_msgs/Path: the last message where it begins no later than the first one ends, else what each adds.

    Raises:
        SequenceError: damaged messages, no poses, or poses without stamps of their own.
    """
    last = None
    for raw in bag.messages([topic.name]):
        last = raw
    if last is None:
        raise SequenceError(f"{bag.path}: no message on {topic.name}, expected at least one")
    beginning, whole = first(bag, topic), decode(bag, last)
    assert whole is not None
    rows: list[tuple[int, Float64[np.ndarray, " 7"]]] = []
    if beginning.poses and whole.poses and stamp_ns(whole.poses[0].header) <= stamp_ns(beginning.poses[0].header):
        _extend(rows, whole, bag, topic)
    else:
        for raw in bag.messages([topic.name]):
            message = decode(bag, raw)
            assert message is not None
            _extend(rows, message, bag, topic)
    if len(rows) < 2:
        raise SequenceError(
            f"{bag.path}: {topic.name}: {len(rows)} poses at stamps of their own, expected at least two whose stamps"
            " increase"
        )
    table = np.stack([row for _, row in rows])
    times_ns = np.array([time_ns for time_ns, _ in rows], np.int64)
    return Trajectory(times_ns, Poses.from_quat_xyzw(table[:, :3], table[:, 3:]))


def _extend(
    rows: list[tuple[int, Float64[np.ndarray, " 7"]]], message: SimpleNamespace, bag: Bag, topic: Topic
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
        try:
            pose = pose_from_message(stamped.pose)
        except VaporTrackError as error:
            raise SequenceError(f"{bag.path}: {topic.name} at {time_ns} ns: true pose: {error}") from error
        rows.append((time_ns, np.concatenate([pose.translation, pose.as_quat_xyzw()])))
