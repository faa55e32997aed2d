"""Time stamps -> which odometry lies between which images. Arrays in, arrays out."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float64, Int64

from filtering.motion import MotionNoise, Odometry, accumulated
from filtering.se3 import Poses
from sequences.errors import SequenceError


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
    share of an interval has that share of it, and increments compose: wherever the images fall, the covariances of
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


@dataclass
class PoseWindow:
    """The last stretch of a stream of time-stamped poses: what is no longer asked for is forgotten.

    Attributes:
        max_gap_s: Neighbours further apart than this do not cover what lies between them.
    """

    max_gap_s: float
    _times_ns: list[int] = field(default_factory=list)
    _poses: list[Poses] = field(default_factory=list)
    _covariances: list[np.ndarray] = field(default_factory=list)

    def append(self, time_ns: int, pose: Poses, covariance: Float64[np.ndarray, "6 6"] | None = None) -> bool:
        """Take the next pose; False, and nothing taken, where its stamp is not after the last one's."""
        if self._times_ns and time_ns <= self._times_ns[-1]:
            return False
        self._times_ns.append(time_ns)
        self._poses.append(pose)
        self._covariances.append(np.zeros((6, 6)) if covariance is None else covariance)
        return True

    def reaches(self, time_ns: int) -> bool:
        """Whether a pose at or after this time has come."""
        return bool(self._times_ns) and self._times_ns[-1] >= time_ns

    def forget_before(self, time_ns: int) -> None:
        """Drop what lies before the last pose that is at or before this time."""
        keep = int(np.searchsorted(self._times_ns, time_ns, side="right")) - 1
        if keep > 0:
            del self._times_ns[:keep], self._poses[:keep], self._covariances[:keep]

    def at(self, time_ns: int) -> Poses | None:
        """The pose at one time; None where it is not covered."""
        if not self._times_ns:
            return None
        times_ns, poses = np.array(self._times_ns, np.int64), Poses.stack(self._poses)
        pose, covered = interpolate(times_ns, poses, np.array([time_ns], np.int64), max_gap_s=self.max_gap_s)
        return pose[0] if covered[0] else None

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
