"""Poses of the camera over time, from a topic or along the links of tf."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from types import SimpleNamespace

from filtering.errors import VaporTrackError
from filtering.se3 import Poses
from sequences.reading.pose_source import MAX_STILL_GAP_S, Jumps, PoseSource, Sample
from sequences.recordings.messages import (
    frame_name,
    pose_from_message,
    pose_from_transform,
    stamp_ns,
    transforms_from_message,
)
from sequences.recordings.source import TF, MessageSource, Topic
from sequences.recordings.topics import first
from sequences.recordings.transforms import Step, along
from sequences.trajectories.pose_window import PoseWindow

_POSE_OF: Mapping[str, Callable[[SimpleNamespace], Poses]] = {
    "geometry_msgs/PoseStamped": lambda message: pose_from_message(message.pose),
    "geometry_msgs/PoseWithCovarianceStamped": lambda message: pose_from_message(message.pose.pose),
    "geometry_msgs/TransformStamped": lambda message: pose_from_transform(message.transform),
    "nav_msgs/Odometry": lambda message: pose_from_message(message.pose.pose),
}
POSE_TYPES = (*_POSE_OF, "nav_msgs/Path")


class LinkedPoses(PoseSource):
    """Poses along a path of links, each of them interpolated in time by itself; the camera is fixed at its end."""

    def __init__(
        self,
        topic: str,
        path: Sequence[Step],
        body_from_camera: Poses,
        read: Callable[[SimpleNamespace], tuple[list[Sample], list[str]]],
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
            read: What a message says of those, and what is wrong with the rest.
            max_gap_s: As of `PoseWindow`.
            still_gap_s: Likewise.
            watch_jumps: Likewise.
        """
        self.topic = topic
        self._path = path
        self._body_from_camera = body_from_camera
        self._read = read
        self._windows = {step.link: PoseWindow(max_gap_s, still_gap_s, watch_jumps) for step in path if not step.static}

    @property
    def links(self) -> Collection[tuple[str, str]]:
        """The links of the path that messages tell of."""
        return self._windows.keys()

    def samples(self, message: SimpleNamespace) -> tuple[list[Sample], list[str]]:
        """What a message says of the links, and what is wrong with what cannot be used of it."""
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

    def leads(self, start_ns: int, end_ns: int) -> bool:
        """Whether the motion between two covered times is known: without gaps and jumps, of all links."""
        return all(window.leads(start_ns, end_ns) for window in self._windows.values())

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


def poses_of_topic(topic: Topic, body_from_camera: Poses, *, max_gap_s: float) -> LinkedPoses:
    """Poses of a body that a topic tells, of any type but a path, and of the camera that is fixed on it."""
    link, pose_of = ("", topic.name), _POSE_OF[topic.read_as]

    def read(message: SimpleNamespace) -> tuple[list[Sample], list[str]]:
        try:
            return [Sample(link, stamp_ns(message.header), pose_of(message))], []
        except VaporTrackError as error:
            return [], [str(error)]

    path = [Step(*link, Poses.identity(), static=False, upwards=False)]
    return LinkedPoses(topic.name, path, body_from_camera, read, max_gap_s=max_gap_s)


def poses_of_tree(
    path: Sequence[Step], body_from_camera: Poses, *, max_gap_s: float, watch_jumps: bool = True
) -> LinkedPoses:
    """Poses along a path of tf, and of the camera that is fixed at its end."""

    links = {step.link for step in path if not step.static}

    def read(message: SimpleNamespace) -> tuple[list[Sample], list[str]]:
        told, problems = transforms_from_message(message, links)
        return [Sample((t.parent, t.child), t.time_ns, t.parent_from_child) for t in told], problems

    return LinkedPoses(
        TF, path, body_from_camera, read, max_gap_s=max_gap_s, still_gap_s=MAX_STILL_GAP_S, watch_jumps=watch_jumps
    )


def frames_of_topic(bag: MessageSource, topic: Topic) -> tuple[str, str]:
    """Frame that the poses of a topic are in, and the one that they are of; '' where that is not said."""
    message = first(bag, topic)
    return frame_name(message.header.frame_id), frame_name(getattr(message, "child_frame_id", ""))
