"""Poses between their time stamps, and the motion of the camera between two times. Arrays in, arrays out."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float64, Int64

from filtering.motion import Odometry, WhiteNoise, accumulated
from filtering.se3 import Poses
from sequences.errors import SequenceError

MAX_ODOMETRY_GAP_S = 0.5
MAX_TRUE_POSE_GAP_S = 0.1
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
    after = np.minimum(np.searchsorted(times_ns, query_ns, side="left"), len(times_ns) - 1)
    before = np.maximum(after - (times_ns[after] != query_ns), 0)
    gap_ns = times_ns[after] - times_ns[before]
    inside = (times_ns[before] <= query_ns) & (query_ns <= times_ns[after])
    fraction = np.where(inside, (query_ns - times_ns[before]) / np.maximum(gap_ns, 1), 0.0)
    covered = inside & (gap_ns <= max_gap_s * 1e9)
    return poses[before].interpolate(poses[after], fraction), covered


def pose_at(
    times_ns: Sequence[int] | Int64[np.ndarray, " n"],
    poses: Sequence[Poses] | Poses,
    time_ns: int,
    *,
    max_gap_s: float,
    still_gap_s: float = 0.0,
) -> Poses | None:
    """The pose at one time between its neighbours, of which there are at most two; None where they do not cover it.

    Neighbours cover what is between them up to a gap of `max_gap_s`, and of `still_gap_s` where they hardly differ:
    within 5 cm and 0.05 rad.
    """
    if len(times_ns) and times_ns[-1] == time_ns:
        return poses[-1]
    if len(times_ns) < 2 or not times_ns[0] <= time_ns < times_ns[1]:
        return None
    if still_gap_s > max_gap_s:
        metres, radians = poses[0].distance(poses[1])
        max_gap_s = still_gap_s if metres <= _STILL_M and radians <= _STILL_RAD else max_gap_s
    gap_ns = times_ns[1] - times_ns[0]
    if gap_ns > max_gap_s * 1e9:
        return None
    return poses[0].interpolate(poses[1], (time_ns - times_ns[0]) / gap_ns)


def odometry_between(
    times_ns: Int64[np.ndarray, " n"],
    odom_from_base: Poses,
    twist_covariances: Float64[np.ndarray, "n 6 6"],
    start_ns: int,
    end_ns: int,
    *,
    base_from_camera: Poses,
    motion_noise: WhiteNoise,
) -> Odometry:
    """Motion of the camera between two times that the odometry covers.

    A message's twist covariance is the error of the velocity on the way to it: over the interval of dt seconds that
    it ends, the increment errs with covariance twist · dt². That error is taken as white noise along the interval, so a
    part of an interval has that fraction of it, and increments compose: wherever the images fall, the covariances of
    consecutive ones add up to that of the whole. For axes that were not measured all the way, and for all where the
    others are zero, `motion_noise` is used instead, for the motion of the base. Each part between two messages errs as
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
    ends_ns = np.array([start_ns, end_ns], np.int64)
    ends, _ = interpolate(times_ns, odom_from_base, ends_ns, max_gap_s=np.inf)
    inner = slice(np.searchsorted(times_ns, start_ns, "right"), np.searchsorted(times_ns, end_ns))
    knots_ns = np.concatenate([ends_ns[:1], times_ns[inner], ends_ns[1:]])
    odom_from_knots = Poses.concatenate([ends[:1], odom_from_base[inner], ends[1:]])
    knots_from_odom = odom_from_knots.inverse()
    previous_from_current = knots_from_odom[0] @ odom_from_knots[-1]

    message = np.searchsorted(times_ns, knots_ns[1:], side="left")
    interval_s = (times_ns[message] - times_ns[message - 1]) * 1e-9
    part_s = (knots_ns[1:] - knots_ns[:-1]) * 1e-9
    tangents = (knots_from_odom[:-1] @ odom_from_knots[1:]).log()
    stated = twist_covariances[message]
    unknown = np.isinf(np.diagonal(stated, axis1=1, axis2=2)).sum(axis=0) > 0
    if unknown.any():
        stated = np.where(unknown[:, None] | unknown, 0.0, stated)
    unknown |= not stated.any()
    noise = stated * (interval_s * part_s)[:, None, None]
    if unknown.any():
        noise += np.where(unknown, motion_noise.along(tangents, part_s), 0.0)[:, :, None] * np.eye(6)
    camera_from_base = base_from_camera.inverse()
    carry = (camera_from_base @ knots_from_odom[-1] @ odom_from_knots[1:]).adjoint()
    covariance = (carry @ accumulated(tangents, noise) @ np.swapaxes(carry, -1, -2)).sum(axis=0)
    return Odometry(
        camera_from_base @ previous_from_current @ base_from_camera,
        (covariance + covariance.T) / 2,
        (end_ns - start_ns) * 1e-9,
    )
