"""Odometry and true poses of one reading: messages in, poses and motion at the times of images out."""

from __future__ import annotations

from typing import Any

import numpy as np

from filtering.errors import counted
from filtering.motion import Odometry
from filtering.se3 import Poses
from sequences.errors import SequenceError
from sequences.files import Rows
from sequences.reading.counts import SkipCounter
from sequences.reading.extrinsics import Extrinsics
from sequences.reading.pose_sources import PoseSource
from sequences.reading.roles import Roles
from sequences.reading.timeline import MAX_LATENESS_S
from sequences.recordings.messages import stamp_ns
from sequences.recordings.source import RawMessage
from sequences.trajectories.interpolation import MAX_ODOMETRY_GAP_S
from sequences.trajectories.pose_window import PoseWindow


class MotionOfCamera:
    """How the camera moved, by odometry and by true poses, as far as a recording was read.

    `across_jumps` counts frames without a true pose because it jumps about them; `rows` counts poses, by kind.
    """

    def __init__(self, roles: Roles, skipped: SkipCounter, *, over_gaps: bool) -> None:
        """Set up a reading that took no message yet; arguments as of `FramePairing`."""
        self._over_gaps = over_gaps
        self.across_jumps = 0
        self._roles, self._skipped = roles, skipped
        self.rows: dict[str, Rows] = {}
        self._motion_noise = roles.options.motion_noise
        self._base_from_camera = roles.extrinsics.body_from_camera if roles.extrinsics is not None else None
        # Fixed mounts, by the topics that would show that they move.
        self.source_topics: dict[str, list[Extrinsics]] = {}
        of_truth = roles.truth.extrinsics if roles.truth is not None else None
        mounts = (roles.extrinsics, of_truth, *(camera.mount for camera in roles.cameras))
        for mount in (each for each in mounts if each is not None):
            for topic in mount.source_topics:
                self.source_topics.setdefault(topic, []).append(mount)
        self._moves_from_ns: int | None = None  # where the camera began to move on the base
        self._odometry_source = roles.open_odometry()
        self._odometry = PoseWindow(MAX_ODOMETRY_GAP_S)  # of a tree, at the times of images
        if self._odometry_source is not None and roles.tree_odometry is None:
            (self._odometry,) = self._odometry_source.windows.values()
        self._truth = roles.truth.open() if roles.truth is not None else None
        self._sources = [
            (source, what)
            for source, what in ((self._odometry_source, "poses of odometry"), (self._truth, "true poses"))
            if source is not None
        ]
        self._origin = np.array(roles.options.ground_truth_origin or (0.0, 0.0, 0.0))
        self._num_true = 0

    def take(self, raw: RawMessage, message: Any) -> None:
        """Take a message of any topic but the images'; None for undecodable bytes.

        Raises SequenceError where a camera that should be fixed moves.
        """
        sources = [(source, what) for source, what in self._sources if source.topic == raw.topic]
        if message is not None:
            self._check_extrinsics(raw, message)
        elif not sources:
            problem = self._roles.why_undecodable(raw)
            self._skipped.message(f"unusable message on {raw.topic}", raw.log_time_ns, problem)
        for source, what in sources:
            self._take_poses(raw, message, source, what)

    def _count(self, what: str, raw: RawMessage, problem: str | None) -> None:
        """Count a message, or a transform in it: as unusable where there is a problem."""
        rows = self.rows.setdefault(what, Rows(what))
        rows.num_rows += 1
        if problem is not None:
            rows.leave_out(f"{self._roles.path}: {raw.topic} at {raw.log_time_ns} ns: {problem}")
            self._skipped.message(f"unusable {what}", raw.log_time_ns, problem)

    def _check_extrinsics(self, raw: RawMessage, message: Any) -> None:
        """Take a message of tf: a camera that moves on its base has no odometry, where it can do without."""
        roles = self._roles
        for extrinsics in self.source_topics.get(raw.topic, ()):
            try:
                extrinsics.require_fixed(raw, message)
            except SequenceError as error:
                if extrinsics is not roles.extrinsics or roles.odometry_required:
                    raise SequenceError(f"{roles.path}: {error}") from error
                if self._moves_from_ns is None:
                    reason = "odometry from where the camera moved on its base"
                    self._skipped.message(reason, raw.log_time_ns, str(error))
                    self._moves_from_ns = min(stamp_ns(stamped.header) for stamped in message.transforms)

    def _take_poses(self, raw: RawMessage, message: Any, source: PoseSource, what: str) -> None:
        samples, problems = ([], [self._roles.why_undecodable(raw)]) if message is None else source.samples(message)
        for problem in (*problems, *(None for _ in samples)):
            self._count(what, raw, problem)
        for sample in samples:
            if not source.append(sample):
                self._skipped.message(f"{what}: time stamp not increasing", sample.time_ns)
            if not self._over_gaps:  # a running system has no end
                source.forget_before(sample.time_ns - int(2 * MAX_LATENESS_S * 1e9))

    def reaches(self, time_ns: int) -> bool:
        """Whether odometry and true poses have come as far as a time."""
        return all(source.reaches(time_ns) for source, _ in self._sources)

    def forget_before(self, time_ns: int) -> None:
        """Drop poses that only earlier times need."""
        self._odometry.forget_before(time_ns)
        for source, _ in self._sources:
            source.forget_before(time_ns)

    def covers(self, time_ns: int) -> bool:
        """Whether the base's pose by odometry is known."""
        if self._odometry_source is None or self._roles.tree_odometry is None:
            return self._odometry.covers(time_ns)
        pose = self._odometry_source.at(time_ns)
        return pose is not None and (self._odometry.append(time_ns, pose) or self._odometry.covers(time_ns))

    def odometry_between(self, start_ns: int, end_ns: int) -> Odometry | None:
        """Odometry of the camera between two covered times; None where it had begun to move on the base, or is gone."""
        moves = self._moves_from_ns is not None and end_ns >= self._moves_from_ns
        if self._base_from_camera is None or self._odometry_source is None or moves:
            return None
        if not (self._over_gaps or self._odometry_source.leads(start_ns, end_ns)):
            return None
        return self._odometry.odometry_between(
            start_ns, end_ns, base_from_camera=self._base_from_camera, motion_noise=self._motion_noise
        )

    def odom_from_base(self, time_ns: int) -> Poses | None:
        """Pose of the base by odometry, one pose; None where that does not cover the time."""
        return self._odometry.at(time_ns) if self.covers(time_ns) else None

    def true_pose(self, time_ns: int) -> Poses | None:
        """True pose of the camera, one pose; None where there is none, or it jumps, which is counted."""
        if self._truth is None:
            return None
        if self._truth.jumps_at(time_ns):
            self.across_jumps += 1
            return None
        pose = self._truth.at(time_ns)
        if pose is None:
            return None
        self._num_true += 1
        return Poses(pose.rotation, pose.translation - self._origin)

    @property
    def odometry_span_ns(self) -> tuple[int, int] | None:
        """First and last stamp of the odometry; None where there is none."""
        return None if self._odometry_source is None else self._odometry_source.span_ns

    @property
    def has_no_true_pose(self) -> bool:
        """Whether there are true poses, but none was of the time of a frame."""
        return self._truth is not None and self._num_true == 0

    @property
    def true_poses_span_ns(self) -> tuple[int, int] | None:
        """First and last stamp of the true poses; None where there is none."""
        return None if self._truth is None else self._truth.span_ns

    def jumps(self) -> list[str]:
        """A notice about jumps of the true poses, once all were read."""
        if self._truth is None or self._roles.truth is None:
            return []
        number, first_ns = self._truth.finish()
        if first_ns is None:
            return []
        return [
            f"true poses of {self._roles.truth.label} jump {counted(number, 'time')}, first at {first_ns * 1e-9:.3f} s:"
            f" none for {counted(self.across_jumps, 'image')} between"
        ]


def odometry_apart(images_ns: tuple[int, int] | None, odometry_ns: tuple[int, int] | None) -> str | None:
    """A notice where odometry is of another time than all images, as of another clock; None elsewhere.

    Spans are first and last stamps, None where there is none.
    """
    if images_ns is None or odometry_ns is None:
        return None
    if odometry_ns[0] <= images_ns[1] and images_ns[0] <= odometry_ns[1]:
        return None
    return (
        f"images run {_span(images_ns)}, odometry {_span(odometry_ns)}: they begin"
        f" {abs(odometry_ns[0] - images_ns[0]) * 1e-9:.1f} s apart, expected one clock (--stamps log takes log times)"
    )


def true_poses_apart(label: str, poses_ns: tuple[int, int] | None, frames_ns: tuple[int, int]) -> str:
    """A notice where true poses, so called, are of another time than all frames; spans are first and last stamps."""
    when = "no pose" if poses_ns is None else _span(poses_ns)
    return (
        f"no image with a true pose: those of {label} are {when}, images {_span(frames_ns)}; expected poses of that"
        " time, without long gaps (--time-offset-s shifts a file's)"
    )


def _span(span_ns: tuple[int, int]) -> str:
    return f"from {span_ns[0] * 1e-9:.3f} to {span_ns[1] * 1e-9:.3f} s"
