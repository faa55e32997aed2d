"""The clock of images against that of odometry or true poses, by the motion that images show."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from sequences.frame import Trajectory
from sequences.trajectories.interpolation import interpolate
from vapor.inspection.odometry import chained
from vapor.inspection.walk import Walk
from vapor.training_data.ground import runs
from vapor.training_data.views import By, Pair, Residuals, lowest

_MOST_S, _COARSE_S, _FINE_S = 3.0, 0.05, 0.01  # offsets that are tried
_MAX_GAP_S = 1.0  # between poses
_LEAST_PAIRS, _MOST_LACKING = 8, 0.5
_CERTAIN_S, _BETTER, _RIVAL_S = 0.02, 0.8, 0.3  # standard deviation at most; than any offset as far from the best one
_DRAWS, _GOOD = 100, 0.03  # and of the mean residual, focal lengths


@dataclass(frozen=True)
class ImageClock:
    """Delay of the stamps of a recording's images against those of odometry, or without any of true poses.

    The delay, milliseconds, is None where unknown: where the camera hardly turns, or always alike, or where images are
    turned or mirrored.
    """

    name: str
    against: str | None
    late_ms: float | None

    @staticmethod
    def of(walk: Walk) -> ImageClock:
        """The clock of a recording's images, by features that pairs of them share."""
        others: dict[By, Trajectory] = {
            "odometry": _by_odometry(walk),
            "true poses": Trajectory(walk.times_ns[walk.posed], walk.poses),
        }
        known = {by: track for by, track in others.items() if len(track) > 1 and walk.source.assumed_hz is None}
        for by, track in known.items():
            late_s = _late_s(walk.views.pairs, track)
            if late_s is not None:
                return ImageClock(walk.name, by, 1e3 * late_s)
        return ImageClock(walk.name, next(iter(known), None), None)


def _late_s(pairs: Sequence[Pair], track: Trajectory) -> float | None:
    """Delay in seconds with which shared features are seen where they should be; None where unknown."""
    if len(pairs) < _LEAST_PAIRS:
        return None
    late_s = np.arange(-_MOST_S, _MOST_S + _COARSE_S / 2, _COARSE_S)
    means = _means(_residuals(pairs, track, late_s))
    if not np.isfinite(means).any():
        return None
    best = float(late_s[int(np.nanargmin(means))])
    rivals = means[(np.abs(late_s - best) > _RIVAL_S) & np.isfinite(means)]
    if not np.nanmin(means) < min(_GOOD, _BETTER * rivals.min(initial=np.inf)):
        return None
    fine_s = best + np.arange(-3 * _COARSE_S, 3 * _COARSE_S + _FINE_S / 2, _FINE_S)
    table = _residuals(pairs, track, fine_s)
    table = table[:, np.isfinite(table).all(axis=0)]  # the same pairs with every offset
    if table.shape[1] < _LEAST_PAIRS:
        return None
    rng, count = np.random.default_rng(0), table.shape[1]
    drawn = [lowest(fine_s, table[:, rng.integers(count, size=count)].mean(axis=1)) for _ in range(_DRAWS)]
    return lowest(fine_s, table.mean(axis=1)) if float(np.std(drawn)) < _CERTAIN_S else None


def _residuals(
    pairs: Sequence[Pair], track: Trajectory, offsets_s: Float64[np.ndarray, " o"]
) -> Float64[np.ndarray, "o p"]:
    """Of each pair at each delay; NaN where no pose covers it."""
    residuals, stamps_ns = Residuals(pairs), np.array([pair.times_ns for pair in pairs], np.int64)
    found = []
    for late_s in offsets_s.tolist():
        at_ns = (stamps_ns - round(late_s * 1e9)).ravel()
        poses, known = interpolate(track.times_ns, track.poses, at_ns, max_gap_s=_MAX_GAP_S)
        motions = poses[1::2].inverse() @ poses[::2]
        found.append(np.where(known[::2] & known[1::2], residuals.of(motions), np.nan))
    return np.array(found)


def _means(table: Float64[np.ndarray, "o p"]) -> Float64[np.ndarray, " o"]:
    """Means over the covered pairs; NaN where these are too few."""
    known = np.isfinite(table)
    count = known.sum(axis=1)
    means = np.where(known, table, 0.0).sum(axis=1) / np.maximum(count, 1)
    return np.where(count >= np.maximum(_LEAST_PAIRS, _MOST_LACKING * table.shape[1]), means, np.nan)


def _by_odometry(walk: Walk) -> Trajectory:
    """The longest segment of images that odometry leads through, in a frame of its own."""
    known = np.array([step is not None for step in walk.odometry])
    longest = max(runs(known, np.zeros(len(walk), np.int64)), key=lambda run: run.stop - run.start, default=slice(1, 1))
    steps = [step.previous_from_current for step in walk.odometry[longest] if step is not None]
    return Trajectory(walk.times_ns[longest.start - 1 : longest.stop], chained(steps))
