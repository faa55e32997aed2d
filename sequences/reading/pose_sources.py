"""Poses of the camera over time: from a topic, along links of tf, or from a table."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float64

from filtering.errors import VaporTrackError, counted
from filtering.se3 import Poses
from sequences.errors import SequenceError
from sequences.files import Rows
from sequences.frame import Trajectory
from sequences.reading.extrinsics import Step, along
from sequences.recordings.messages import (
    frame_name,
    odometry_from_message,
    pose_from_message,
    pose_from_transform,
    stamp_ns,
    transforms_from_message,
)
from sequences.recordings.source import TF, MessageSource, Topic, decode, first
from sequences.trajectories.interpolation import MAX_ODOMETRY_GAP_S, pose_at
from sequences.trajectories.pose_window import Motion, PoseWindow, is_jump

MAX_GAP_S = 0.25
_MAX_STILL_GAP_S = 2.0
_POSE_OF: Mapping[str, Callable[[Any], Poses]] = {
    "geometry_msgs/PoseStamped": lambda message: pose_from_message(message.pose),
    "geometry_msgs/PoseWithCovarianceStamped": lambda message: pose_from_message(message.pose.pose),
    "geometry_msgs/TransformStamped": lambda message: pose_from_transform(message.transform),
    "nav_msgs/Odometry": lambda message: pose_from_message(message.pose.pose),
}
POSE_TYPES = (*_POSE_OF, "nav_msgs/Path")


class Sample(NamedTuple):
    """One pose of a message, with its link, stamp and, of odometry, twist covariance."""

    link: tuple[str, str]
    time_ns: int
    pose: Poses
    twist_covariance: Float64[np.ndarray, "6 6"] | None = None


class PoseSource:
    """Poses along a path of links, each interpolated in time by itself; the camera is fixed at the end.

    Attributes:
        topic: Topic of its messages; '' for a table.
        samples: A message -> its samples, and the problems of those that cannot be used.
        windows: The latest poses of each link of the path that is not static.
    """

    def __init__(
        self,
        topic: str,
        path: Sequence[Step],
        body_from_camera: Poses,
        samples: Callable[[Any], tuple[list[Sample], list[str]]],
        *,
        max_gap_s: float,
        still_gap_s: float = 0.0,
        watch_jumps: bool = True,
    ) -> None:
        """Set up a source: `body_from_camera` follows the path; the last three are arguments of `PoseWindow`."""
        self.topic, self.samples = topic, samples
        self._path = path
        self._body_from_camera = body_from_camera
        self.windows = {step.link: PoseWindow(max_gap_s, still_gap_s, watch_jumps) for step in path if not step.static}

    @property
    def links(self) -> Collection[tuple[str, str]]:
        """The links of `windows`; '' and the topic where all messages are of one."""
        return self.windows.keys()

    def append(self, sample: Sample) -> bool:
        """Take a sample; False where it is earlier than the one before of its link."""
        window = self.windows[sample.link]
        # tf repeats the same transform.
        is_later = window.append(sample.time_ns, sample.pose, sample.twist_covariance)
        return is_later or (self.topic == TF and sample.time_ns == window.end_ns)

    def reaches(self, time_ns: int) -> bool:
        """Whether all links have come so far."""
        return all(window.reaches(time_ns) for window in self.windows.values())

    def at(self, time_ns: int) -> Poses | None:
        """The camera's pose, one pose; None where it is not covered."""
        moving = {link: window.at(time_ns) for link, window in self.windows.items()}
        poses = [moving.get(step.link, step.parent_from_child) for step in self._path]
        known = [pose for pose in poses if pose is not None]
        return along(self._path, known) @ self._body_from_camera if len(known) == len(poses) else None

    def jumps_at(self, time_ns: int) -> bool:
        """Whether the pose at this time would be interpolated across a jump."""
        return any(window.jumps_at(time_ns) for window in self.windows.values())

    def leads(self, start_ns: int, end_ns: int) -> bool:
        """Whether the motion between two covered times is known: without gaps and jumps, of all links."""
        return all(window.leads(start_ns, end_ns) for window in self.windows.values())

    def forget_before(self, time_ns: int) -> None:
        """Drop poses that only earlier times need."""
        for window in self.windows.values():
            window.forget_before(time_ns)

    def finish(self) -> tuple[int, int | None]:
        """The number of jumps, and the time of the first, once all messages were taken."""
        for window in self.windows.values():
            window.finish()
        firsts = [w.first_jump_ns for w in self.windows.values() if w.first_jump_ns is not None]
        return sum(w.num_jumps for w in self.windows.values()), min(firsts, default=None)

    @property
    def span_ns(self) -> tuple[int, int] | None:
        """Stamps between which there are poses; None before any came."""
        begins = [w.begin_ns for w in self.windows.values() if w.begin_ns is not None]
        ends = [w.end_ns for w in self.windows.values() if w.end_ns is not None]
        return (max(begins), min(ends)) if begins and len(begins) == len(self.windows) else None


class TabledPoses(PoseSource):
    """Poses of a body at n ≥ 1 stamps, all known before, and of the camera that is fixed on it."""

    def __init__(self, trajectory: Trajectory, body_from_camera: Poses) -> None:
        super().__init__("", [], body_from_camera, lambda _: ([], []), max_gap_s=MAX_GAP_S)
        self._times_ns, self._poses = trajectory.times_ns, trajectory.poses
        metres, radians = self._poses[:-1].distance(self._poses[1:])
        seconds = np.diff(self._times_ns) * 1e-9
        steps = [Motion(0.0, 0.0, 0.0), *map(Motion, metres.tolist(), radians.tolist(), seconds.tolist())]
        self._jumps = [i for i in range(1, len(steps)) if is_jump(steps, i)]

    def at(self, time_ns: int) -> Poses | None:
        """See `PoseSource`."""
        after = min(int(np.searchsorted(self._times_ns, time_ns)), len(self._times_ns) - 1)
        near = slice(max(after - 1, 0), after + 1)
        pose = pose_at(
            self._times_ns[near], self._poses[near], time_ns, max_gap_s=MAX_GAP_S, still_gap_s=_MAX_STILL_GAP_S
        )
        return None if pose is None else pose @ self._body_from_camera

    def jumps_at(self, time_ns: int) -> bool:
        """See `PoseSource`."""
        after = int(np.searchsorted(self._times_ns, time_ns))
        return after in self._jumps and int(self._times_ns[after]) != time_ns

    def finish(self) -> tuple[int, int | None]:
        """See `PoseSource`."""
        return len(self._jumps), int(self._times_ns[self._jumps[0]]) if self._jumps else None

    @property
    def span_ns(self) -> tuple[int, int] | None:
        """See `PoseSource`."""
        return int(self._times_ns[0]), int(self._times_ns[-1])


def poses_of_topic(topic: Topic, body_from_camera: Poses, *, max_gap_s: float) -> PoseSource:
    """Poses of a body on a topic of any type but a path, and of the camera that is fixed on it."""
    pose_of = _POSE_OF[topic.read_as]

    def samples(message: Any) -> list[Sample]:
        return [Sample(("", topic.name), stamp_ns(message.header), pose_of(message))]

    return _source_of_topic(topic, body_from_camera, samples, max_gap_s=max_gap_s)


def odometry_of_topic(topic: Topic) -> PoseSource:
    """Poses of the base, with twist covariances."""

    def samples(message: Any) -> list[Sample]:
        found = odometry_from_message(message)
        return [Sample(("", topic.name), found.time_ns, found.odom_from_base, found.twist_covariance)]

    return _source_of_topic(topic, Poses.identity(), samples, max_gap_s=MAX_ODOMETRY_GAP_S, watch_jumps=False)


def _source_of_topic(
    topic: Topic, body_from_camera: Poses, read: Callable[[Any], list[Sample]], **window: Any
) -> PoseSource:
    def samples(message: Any) -> tuple[list[Sample], list[str]]:
        try:
            return read(message), []
        except VaporTrackError as error:
            return [], [str(error)]

    path = [Step("", topic.name, Poses.identity(), static=False, upwards=False)]
    return PoseSource(topic.name, path, body_from_camera, samples, **window)


def poses_of_tree(
    path: Sequence[Step], body_from_camera: Poses, *, max_gap_s: float, watch_jumps: bool = True
) -> PoseSource:
    """Poses along a path of tf, and of the camera that is fixed at its end."""
    links = {step.link for step in path if not step.static}

    def samples(message: Any) -> tuple[list[Sample], list[str]]:
        transforms, problems = transforms_from_message(message, links)
        return [Sample((t.parent, t.child), t.time_ns, t.parent_from_child) for t in transforms], problems

    return PoseSource(
        TF, path, body_from_camera, samples, max_gap_s=max_gap_s, still_gap_s=_MAX_STILL_GAP_S, watch_jumps=watch_jumps
    )


def frames_of_topic(bag: MessageSource, topic: Topic) -> tuple[str, str]:
    """Frame that the poses of a topic are in, and frame of their body; '' where the message names none."""
    message = first(bag, topic)
    return frame_name(message.header.frame_id), frame_name(getattr(message, "child_frame_id", ""))


def read_path(bag: MessageSource, topic: Topic) -> tuple[Trajectory, Rows]:
    """Poses of nav_msgs/Path: the last message where it begins no later than the first one, else all in turn.

    Raises SequenceError for damaged messages, no poses, poses without stamps of their own, or more than half unusable.
    """
    rows = Rows("true poses")
    last = None
    for raw in bag.messages([topic.name]):
        last = raw
    if last is None:
        raise SequenceError(f"{bag.path}: no message on {topic.name}, expected at least one")
    beginning, whole = first(bag, topic), decode(bag, last)
    assert whole is not None
    is_whole = beginning.poses and whole.poses
    is_whole = is_whole and stamp_ns(whole.poses[0].header) <= stamp_ns(beginning.poses[0].header)
    times_ns: list[int] = []
    poses: list[Poses] = []
    for message in [whole] if is_whole else (decode(bag, raw) for raw in bag.messages([topic.name])):
        assert message is not None
        if len(message.poses) > 1 and len({stamp_ns(stamped.header) for stamped in message.poses}) == 1:
            raise SequenceError(
                f"{bag.path}: {topic.name} ({topic.type}): {len(message.poses)} poses of one stamp, expected each at a"
                " stamp of its own"
            )
        for stamped in message.poses:
            time_ns = stamp_ns(stamped.header)
            if times_ns and time_ns <= times_ns[-1]:
                continue
            rows.num_rows += 1
            try:
                poses.append(pose_from_message(stamped.pose))
                times_ns.append(time_ns)
            except VaporTrackError as error:
                rows.leave_out(f"{bag.path}: {topic.name} at {time_ns} ns: {error}")
    rows.require_few()
    if len(times_ns) < 2:
        raise SequenceError(
            f"{bag.path}: {topic.name}: {counted(len(times_ns), 'pose')} at stamps of their own, expected at least two"
            " whose stamps increase"
        )
    return Trajectory(np.array(times_ns, np.int64), Poses.stack(poses)), rows
