"""Odometry and true poses of one reading: taken in message by message, asked for image by image."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np

from filtering.errors import VaporTrackError
from filtering.motion import Odometry
from filtering.se3 import Poses
from sequences.errors import SequenceError
from sequences.options import SequenceOptions
from sequences.reading.counts import AFTER, BEFORE, IN_GAP
from sequences.reading.extrinsics import Extrinsics
from sequences.reading.left_out import LeftOut, Unusable
from sequences.reading.pose_source import PoseSource
from sequences.reading.roles import Roles
from sequences.reading.stamps import MAX_LATENESS_S, Stamps, jumps_of_true_poses
from sequences.recordings.messages import odometry_from_message, stamp_ns
from sequences.recordings.source import RawMessage
from sequences.trajectories.interpolation import MAX_ODOMETRY_GAP_S
from sequences.trajectories.pose_window import PoseWindow


class MotionOfCamera:
    """How the camera moved, by odometry and by true poses, as far as a recording was read.

    Attributes:
        across_jumps: How many frames have no true pose as it jumps about them.
        odometry_stamps: Stamps of the messages of odometry.
        unusable: How much of the odometry and the true poses cannot be used, by what it is.
    """

    def __init__(
        self,
        path: Path,
        roles: Roles,
        options: SequenceOptions,
        left_out: LeftOut,
        *,
        over_gaps: bool = True,
    ) -> None:
        """Set up what no message was taken into yet; arguments as of `FramePairing`."""
        self._over_gaps = over_gaps
        self.across_jumps = 0
        self.odometry_stamps = Stamps()
        self._path, self._roles, self._left_out = path, roles, left_out
        self.unusable: dict[str, Unusable] = {}
        self._motion_noise = options.motion_noise
        self._base_from_camera = roles.extrinsics.body_from_camera if roles.extrinsics is not None else None
        self._told_on = _told_on(roles)
        self._moves_from_ns: int | None = None  # where the camera began to move on the base
        self._odometry = PoseWindow(MAX_ODOMETRY_GAP_S)
        self._odometry_source = roles.tree_odometry.open() if roles.tree_odometry is not None else None
        self._truth = roles.truth.open() if roles.truth is not None else None
        told = (roles.odometry.name if roles.odometry is not None else "", self._odometry_source, self._truth)
        self._poses_on = {each if isinstance(each, str) else each.topic for each in told if each is not None}
        self._origin = np.array(options.ground_truth_origin or (0.0, 0.0, 0.0))
        self._num_true = 0

    def take(self, raw: RawMessage, message: SimpleNamespace | None, *, before_images: bool) -> None:
        """Take one message in that is no image.

        Args:
            raw: The message.
            message: Its fields; None for bytes that are no message.
            before_images: Whether no image came so far: there is nothing to remember but what a late one may ask for.

        Raises:
            SequenceError: a camera that should be fixed moves.
        """
        if message is not None:
            self._check_extrinsics(raw, message)
        elif raw.topic not in self._poses_on:
            problem = self._roles.why_undecodable(raw)
            self._left_out.message(f"unusable message on {raw.topic}", raw.log_time_ns, problem)
        if self._roles.odometry is not None and raw.topic == self._roles.odometry.name:
            self._take_odometry(raw, message, before_images)
        for source, what in ((self._odometry_source, "poses of odometry"), (self._truth, "true poses")):
            if source is not None and source.topic == raw.topic:
                self._take_poses(raw, message, source, what, before_images)

    def _left_out_of(self, what: str, raw: RawMessage, problem: str | None) -> None:
        """Count a message, or a transform in it: as one that cannot be used, where there is a problem."""
        unusable = self.unusable.setdefault(what, Unusable(what, raw.topic))
        unusable.total += 1
        if problem is not None:
            unusable.note(raw.log_time_ns, problem)
            self._left_out.message(f"unusable {what}", raw.log_time_ns, problem)

    def _check_extrinsics(self, raw: RawMessage, message: SimpleNamespace) -> None:
        """Take a message of tf: a camera that moves on its base has no odometry, where it can do without."""
        roles = self._roles
        for extrinsics in self._told_on.get(raw.topic, ()):
            try:
                extrinsics.require_fixed(raw, message)
            except SequenceError as error:
                if extrinsics is not roles.extrinsics or roles.odometry_required:
                    raise SequenceError(f"{self._path}: {error}") from error
                if self._moves_from_ns is None:
                    reason = "odometry from where the camera moved on its base"
                    self._left_out.message(reason, raw.log_time_ns, str(error))
                    self._moves_from_ns = min(stamp_ns(stamped.header) for stamped in message.transforms)

    def _take_odometry(self, raw: RawMessage, message: SimpleNamespace | None, before_images: bool) -> None:
        if message is None:
            self._left_out_of("poses of odometry", raw, self._roles.why_undecodable(raw))
            return
        time_ns = stamp_ns(message.header)
        self.odometry_stamps.take(time_ns)
        try:
            sample = odometry_from_message(message)
        except VaporTrackError as error:
            self._left_out_of("poses of odometry", raw, str(error))
            return
        self._left_out_of("poses of odometry", raw, None)
        if not self._odometry.append(time_ns, sample.odom_from_base, sample.twist_covariance):
            self._left_out.message("poses of odometry: time stamp not increasing", time_ns)
        if before_images:
            self._odometry.forget_before(time_ns - int(MAX_LATENESS_S * 1e9))
        elif not self._over_gaps:  # nothing may grow for ever
            self._odometry.forget_before(self.odometry_stamps.end_ns - int(2 * MAX_LATENESS_S * 1e9))

    def _take_poses(
        self, raw: RawMessage, message: SimpleNamespace | None, source: PoseSource, what: str, before_images: bool
    ) -> None:
        samples, problems = ([], [self._roles.why_undecodable(raw)]) if message is None else source.samples(message)
        for problem in (*problems, *(None for _ in samples)):
            self._left_out_of(what, raw, problem)
        for sample in samples:
            if not source.append(sample):
                self._left_out.message(f"{what}: time stamp not increasing", sample.time_ns)
            if before_images or not self._over_gaps:
                late_s = MAX_LATENESS_S if before_images else 2 * MAX_LATENESS_S
                source.forget_before(sample.time_ns - int(late_s * 1e9))

    def reaches(self, time_ns: int) -> bool:
        """Whether odometry and true poses have come as far as a time."""
        return (
            (self._roles.odometry is None or self._odometry.reaches(time_ns))
            and (self._odometry_source is None or self._odometry_source.reaches(time_ns))
            and (self._truth is None or self._truth.reaches(time_ns))
        )

    def forget_before(self, time_ns: int) -> None:
        """Learn that no earlier time will be asked for."""
        self._odometry.forget_before(time_ns)
        for source in (self._odometry_source, self._truth):
            if source is not None:
                source.forget_before(time_ns)

    def why_uncovered(self, time_ns: int) -> str:
        """The reason to count where odometry does not cover a time: it lies before or behind it all, or in a gap."""
        span = self.odometry_span_ns
        if span is None or time_ns > span[1]:
            return AFTER
        return BEFORE if time_ns < span[0] else IN_GAP

    def covers(self, time_ns: int) -> bool:
        """Whether odometry tells where the base was; of a tree it becomes a pose like those of a topic."""
        if self._odometry_source is None:
            return self._odometry.covers(time_ns)
        pose = self._odometry_source.at(time_ns)
        return pose is not None and (self._odometry.append(time_ns, pose) or self._odometry.covers(time_ns))

    def odometry_between(self, start_ns: int, end_ns: int) -> Odometry | None:
        """Odometry of the camera between two covered times; None where it had begun to move on the base, or is gone."""
        moves = self._moves_from_ns is not None and end_ns >= self._moves_from_ns
        if self._base_from_camera is None or moves:
            return None
        told_by = self._odometry_source or self._odometry
        if not (self._over_gaps or told_by.leads(start_ns, end_ns)):
            return None
        return self._odometry.odometry_between(
            start_ns, end_ns, base_from_camera=self._base_from_camera, motion_noise=self._motion_noise
        )

    def odom_from_base(self, time_ns: int) -> Poses | None:
        """Pose of the base by odometry, one pose; None where that does not cover the time."""
        return self._odometry.at(time_ns) if self.covers(time_ns) else None

    def true_pose(self, time_ns: int) -> Poses | None:
        """True pose of the camera at one time, one pose; None, and counted where it jumps, where there is none."""
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
        if self._odometry_source is not None:
            return self._odometry_source.span_ns
        return self.odometry_stamps.span_ns

    @property
    def has_no_true_pose(self) -> bool:
        """Whether there are true poses, but none was of the time of a frame."""
        return self._truth is not None and self._num_true == 0

    @property
    def true_poses_span_ns(self) -> tuple[int, int] | None:
        """First and last stamp of the true poses; None where there is none."""
        return None if self._truth is None else self._truth.span_ns

    def jumps(self) -> list[str]:
        """What to say of jumps of the true poses, once all were read."""
        if self._truth is None or self._roles.truth is None:
            return []
        number, first_ns = self._truth.finish()
        if first_ns is None:
            return []
        return [jumps_of_true_poses(self._roles.truth.said, number, first_ns, self.across_jumps)]


def _told_on(roles: Roles) -> dict[str, list[Extrinsics]]:
    """Where cameras are fixed, by the topics that would say that they move."""
    told_on: dict[str, list[Extrinsics]] = {}
    fixed = (roles.extrinsics, roles.truth.extrinsics if roles.truth is not None else None)
    for extrinsics in (each for each in fixed if each is not None):
        for topic in extrinsics.told_on:
            told_on.setdefault(topic, []).append(extrinsics)
    return told_on
