"""Poses between their time stamps. Arrays in, arrays out."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Int64

from filtering.se3 import Poses

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
