"""Time stamps -> which odometry lies between which images. Arrays in, arrays out."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, field
from statistics import median
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64, Int64

from filtering.motion import MotionNoise, Odometry, accumulated
from filtering.se3 import Poses
from sequences.errors import SequenceError

MAX_ODOMETRY_GAP_S = 0.5
MAX_TRUE_POSE_GAP_S = 0.1
JUMP_CONTEXT = 2  # steps before and after one that tell whether it is a jump
_LEAST_JUMP_M, _LEAST_JUMP_RAD = 0.1, 0.1
_JUMP_RATIO = 5.0  # how many times as fast as the steps around it
_LONGEST_JUMP_S = 0.5  # in longer steps bodies set off, turn and stop
_STILL_M, _STILL_RAD = 0.05, 0.05


def interpolate(
    times_ns: Int64[np.ndarray, " n"], poses: Poses, query_ns: Int64[np.ndarray, " m"], *, max_gap_s: float
) -> tuple[Poses, Bool[np.ndarray, " m"]]:
    """Poses at the queried times, along the geodesics of SE(3) between neighbours.

    Args:
        times_ns: Strictly increasing stamps of the poses, n ≥ 1.
        poses: Batch (n,).
        query_ns: Times asked for.
        max_gap_s: Neighbours further apart than this do not cover what lies between them.

    Returns:
        Poses (m,), and which of them are covered; those that are not are one of the neighbours.
    """
    after = np.clip(np.searchsorted(times_ns, query_ns, side="left"), 0, len(times_ns) - 1)
    exact = times_ns[after] == query_ns
    before = np.where(exact, after, np.maximum(after - 1, 0))
    gap_ns = times_ns[after] - times_ns[before]
    inside = (times_ns[before] <= query_ns) & (query_ns <= times_ns[after])
    fraction = np.where(inside, (query_ns - times_ns[before]) / np.maximum(gap_ns, 1), 0.0)
    covered = inside & (gap_ns <= max_gap_s * 1e9)
    return poses[before].interpolate(poses[after], fraction), covered


def odometry_between(
    times_ns: Int64[np.ndarray, " n"],
    odom_from_base: Poses,
    twist_covariances: Float64[np.ndarray, "n 6 6"],
    start_ns: int,
    end_ns: int,
    *,
    base_from_camera: Poses,
    motion_noise: MotionNoise,
) -> Odometry:
    """Motion of the camera between two times that the odometry covers.

    A message's twist covariance says how wrong the velocity was on the way to it: over the interval of dt seconds that
    it ends, the increment errs with covariance twist · dt². That error is taken as white noise along the interval, so a
    part of an interval has that fraction of it, and increments compose: wherever the images fall, the covariances of
    consecutive ones add up to that of the whole. For axes that were not measured all the way, and for all where the
    others are zero, `motion_noise` speaks instead, about the motion of the base. Each part between two messages errs as
    one of constant twist (`filtering.motion.accumulated`); the adjoint carries its covariance to the current frame.

    Stamps do not run backwards: who collects the messages leaves out those that do (`PoseWindow.append`). Between a
    time and itself nothing moves and nothing errs.

    Args:
        times_ns: Strictly increasing stamps of the odometry.
        odom_from_base: Batch (n,).
        twist_covariances: Of the velocity (v, ω) in the base frame; infinite on the diagonal where it is not measured.
        start_ns: Time of the previous image, `times_ns[0] <= start_ns <= end_ns`.
        end_ns: Time of the current image, `end_ns <= times_ns[-1]`.
        base_from_camera: Extrinsics, one pose.
        motion_noise: Stated noise of odometry that has no covariance.

    Raises:
        SequenceError: the current image is before the previous one.
    """
    if end_ns < start_ns:
        raise SequenceError(f"odometry from {start_ns} ns to {end_ns} ns, expected the end not to be before the start")
    if end_ns == start_ns:
        return Odometry(Poses.identity(), np.zeros((6, 6)), 0.0)
    inner = times_ns[(times_ns > start_ns) & (times_ns < end_ns)]
    knots_ns = np.concatenate([[start_ns], inner, [end_ns]]).astype(np.int64)
    odom_from_knots, _ = interpolate(times_ns, odom_from_base, knots_ns, max_gap_s=np.inf)
    previous_from_current = odom_from_knots[0].inverse() @ odom_from_knots[-1]

    message = np.searchsorted(times_ns, knots_ns[1:], side="left")
    interval_s = (times_ns[message] - times_ns[message - 1]) * 1e-9
    stated = twist_covariances[message]
    unknown = np.isinf(np.diagonal(stated, axis1=1, axis2=2)).sum(axis=0) > 0
    stated = np.where(unknown[:, None] | unknown, 0.0, stated)
    unknown |= not stated.any()
    part_s = np.diff(knots_ns) * 1e-9
    tangents = (odom_from_knots[:-1].inverse() @ odom_from_knots[1:]).log()
    noise = stated * (interval_s * part_s)[:, None, None]
    noise += np.where(unknown, motion_noise.along(tangents, part_s), 0.0)[:, :, None] * np.eye(6)
    camera_from_base = base_from_camera.inverse()
    carry = (camera_from_base @ odom_from_knots[-1].inverse() @ odom_from_knots[1:]).adjoint()
    covariance = (carry @ accumulated(tangents, noise) @ np.swapaxes(carry, -1, -2)).sum(axis=0)
    return Odometry(
        camera_from_base @ previous_from_current @ base_from_camera,
        (covariance + covariance.T) / 2,
        (end_ns - start_ns) * 1e-9,
    )


def pose_at(
    times_ns: Int64[np.ndarray, " n"], poses: Poses, time_ns: int, *, max_gap_s: float, still_gap_s: float = 0.0
) -> Poses | None:
    """The pose at one time between its neighbours, (n,) of n ≤ 2; None where they do not cover it.

    Neighbours cover what is between them up to a gap of `max_gap_s`, and of `still_gap_s` where they hardly differ:
    within 5 cm and 0.05 rad.
    """
    if still_gap_s > max_gap_s and len(times_ns) == 2:
        metres, radians = poses[0].distance(poses[1])
        max_gap_s = still_gap_s if metres <= _STILL_M and radians <= _STILL_RAD else max_gap_s
    pose, covered = interpolate(times_ns, poses, np.array([time_ns], np.int64), max_gap_s=max_gap_s)
    return pose[0] if covered[0] else None


@dataclass
class PoseWindow:
    """The end of a stream of time-stamped poses: what is no longer asked for is forgotten.

    Poses may come in another order than that of their stamps, as long as nothing later was asked for.

    Attributes:
        max_gap_s: Neighbours further apart than this do not cover what lies between them.
        still_gap_s: The same of neighbours that hardly differ, where it is longer: see `pose_at`.
        watch_jumps: Whether to find jumps (`is_jump`), so that `jumps_at` can say where they are.
        num_jumps: How many were found so far.
        first_jump_ns: When the first of them was over.
        begin_ns: Earliest stamp of all poses that ever came; None before.
        end_ns: The latest one.
    """

    max_gap_s: float
    still_gap_s: float = 0.0
    watch_jumps: bool = False
    num_jumps: int = field(default=0, init=False)
    first_jump_ns: int | None = field(default=None, init=False)
    begin_ns: int | None = field(default=None, init=False)
    end_ns: int | None = field(default=None, init=False)
    _times_ns: list[int] = field(default_factory=list)
    _poses: list[Poses] = field(default_factory=list)
    _covariances: list[np.ndarray] = field(default_factory=list)
    _steps: list[Motion] = field(default_factory=list)  # to each pose from the one before
    _settled_ns: int | None = None  # up to here nothing is taken any more

    def append(self, time_ns: int, pose: Poses, covariance: Float64[np.ndarray, "6 6"] | None = None) -> bool:
        """Take a pose; False, and nothing taken, where there is one of its stamp, or it comes too late."""
        at = bisect_left(self._times_ns, time_ns)
        is_known = at < len(self._times_ns) and self._times_ns[at] == time_ns
        if is_known or (self._settled_ns is not None and time_ns <= self._settled_ns):
            return False
        self._times_ns.insert(at, time_ns)
        self._poses.insert(at, pose)
        self._covariances.insert(at, np.zeros((6, 6)) if covariance is None else covariance)
        if self.watch_jumps:
            self._steps.insert(at, self._step(at))
            if at + 1 < len(self._steps):
                self._steps[at + 1] = self._step(at + 1)
        self.begin_ns = time_ns if self.begin_ns is None else min(self.begin_ns, time_ns)
        if self.end_ns is None or time_ns > self.end_ns:
            self.end_ns = time_ns
            self._count_jump(len(self._steps) - 1 - JUMP_CONTEXT)
        return True

    def _step(self, index: int) -> Motion:
        before = max(index - 1, 0)
        metres, radians = self._poses[before].distance(self._poses[index])
        return Motion(float(metres), float(radians), (self._times_ns[index] - self._times_ns[before]) * 1e-9)

    def finish(self) -> None:
        """No pose comes any more: look for jumps among the last steps as well."""
        for index in range(max(len(self._steps) - JUMP_CONTEXT, 0), len(self._steps)):
            self._count_jump(index)

    def reaches(self, time_ns: int) -> bool:
        """Whether a pose at or after this time has come, and, where that may be behind a jump, what tells it."""
        if not self._times_ns or self._times_ns[-1] < time_ns:
            return False
        after = bisect_left(self._times_ns, time_ns)
        undecided = self.watch_jumps and self._times_ns[after] != time_ns and self._steps[after].is_large
        return not undecided or after + JUMP_CONTEXT < len(self._times_ns)

    def forget_before(self, time_ns: int) -> None:
        """Drop what lies before the last pose that is at or before this time, but for what tells jumps.

        What comes later and lies before the pose after this time would change what was said about it: it is not taken.
        """
        after = bisect_left(self._times_ns, time_ns)
        settled_ns = self._times_ns[after] if after < len(self._times_ns) else time_ns
        self._settled_ns = settled_ns if self._settled_ns is None else max(self._settled_ns, settled_ns)
        keep = bisect_right(self._times_ns, time_ns) - 1 - (2 * JUMP_CONTEXT + 1 if self.watch_jumps else 0)
        if keep > 0:
            del self._times_ns[:keep], self._poses[:keep], self._covariances[:keep], self._steps[:keep]

    def at(self, time_ns: int) -> Poses | None:
        """The pose at one time; None where it is not covered."""
        if not self._times_ns:
            return None
        after = min(bisect_left(self._times_ns, time_ns), len(self._times_ns) - 1)
        near = slice(max(after - 1, 0), after + 1)
        times_ns, poses = np.array(self._times_ns[near], np.int64), Poses.stack(self._poses[near])
        return pose_at(times_ns, poses, time_ns, max_gap_s=self.max_gap_s, still_gap_s=self.still_gap_s)

    def jumps_at(self, time_ns: int) -> bool:
        """Whether a time lies between two poses with a jump between them."""
        after = bisect_left(self._times_ns, time_ns)
        if not self._steps or not 0 < after < len(self._times_ns) or self._times_ns[after] == time_ns:
            return False
        return is_jump(self._steps, after)

    def _count_jump(self, index: int) -> None:
        if index > 0 and is_jump(self._steps, index):
            self.num_jumps += 1
            self.first_jump_ns = self._times_ns[index] if self.first_jump_ns is None else self.first_jump_ns

    def odometry_between(
        self, start_ns: int, end_ns: int, *, base_from_camera: Poses, motion_noise: MotionNoise
    ) -> Odometry:
        """`odometry_between` two covered times, the first of which was not yet forgotten."""
        return odometry_between(
            np.array(self._times_ns, np.int64),
            Poses.stack(self._poses),
            np.stack(self._covariances),
            start_ns,
            end_ns,
            base_from_camera=base_from_camera,
            motion_noise=motion_noise,
        )


class Motion(NamedTuple):
    """How far one pose is from the one before: metres, radians, seconds."""

    metres: float
    radians: float
    seconds: float

    @property
    def is_large(self) -> bool:
        """Whether it is far enough for a jump."""
        return self.metres > _LEAST_JUMP_M or self.radians > _LEAST_JUMP_RAD


def is_jump(steps: Sequence[Motion], index: int) -> bool:
    """Whether a step is no motion: far, and many times as fast as those before and after it.

    What moves is about as fast in the next step; a corrected map, or a false measurement, is so once or twice only.

    Args:
        steps: Consecutive steps, the first of which leads from nowhere.
        index: Which of them, at least 1.
    """
    step = steps[index]
    if not step.is_large or step.seconds > _LONGEST_JUMP_S:
        return False
    near = [
        steps[i] for i in range(index - JUMP_CONTEXT, index + JUMP_CONTEXT + 1) if i != index and 0 < i < len(steps)
    ]
    if not near:
        return False
    usual_m = median(s.metres / s.seconds for s in near)
    usual_rad = median(s.radians / s.seconds for s in near)
    return (step.metres > _LEAST_JUMP_M and step.metres > _JUMP_RATIO * usual_m * step.seconds) or (
        step.radians > _LEAST_JUMP_RAD and step.radians > _JUMP_RATIO * usual_rad * step.seconds
    )
