"""Whether images have the clock of odometry and true poses: what they show moves as these say, at the same time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from jaxtyping import Float64

from sequences.frame import Trajectory
from sequences.trajectories.interpolation import interpolate
from vapor.inspection.odometry import chained
from vapor.inspection.walk import Walk
from vapor.training_data.ground import runs
from vapor.training_data.views import ORIENTATIONS, By, Pair, Residuals, lowest

_MOST_S, _COARSE_S, _FINE_S = 3.0, 0.05, 0.01  # offsets that are tried
_MAX_GAP_S = 1.0  # between poses
_LEAST_PAIRS, _MOST_LACKING = 8, 0.5
_CERTAIN_S, _BETTER, _RIVAL_S = 0.02, 0.8, 0.3  # standard deviation at most; than any offset as far from the best one
_DRAWS = 100


@dataclass(frozen=True)
class ImageClock:
    """How much later the stamps of a recording's images are than those of something else, of the same moment.

    Attributes:
        name: Of the recording.
        against: What they are compared with: "odometry", or without any "true poses"; None where there is neither.
        late_ms: Milliseconds; None where that cannot be said, as where the camera hardly turns, or always alike.
    """

    name: str
    against: str | None
    late_ms: float | None

    @staticmethod
    def of(walk: Walk) -> ImageClock:
        """The clock of a recording's images, by where what they share is seen."""
        others: dict[By, Trajectory] = {
            "odometry": _by_odometry(walk),
            "true poses": Trajectory(walk.times_ns[walk.posed], walk.poses),
        }
        against: By | None = next((what for what, track in others.items() if len(track) > 1), None)
        if against is None or walk.assumed_hz is not None:
            return ImageClock(walk.name, None, None)
        turn = next((check.orientations[0] for check in walk.views if check.by == against), None)
        late_s = None if turn is None else _late_s(walk.pairs, others[against], ORIENTATIONS[turn])
        return ImageClock(walk.name, against, None if late_s is None else 1e3 * late_s)

    def as_json(self) -> dict[str, Any]:
        """For the report."""
        return asdict(self)


def _late_s(pairs: Sequence[Pair], track: Trajectory, turn: Float64[np.ndarray, "3 3"]) -> float | None:
    """Seconds by which images are late: what two of them share is seen where it should be, so much earlier."""
    if len(pairs) < _LEAST_PAIRS:
        return None
    late_s = np.arange(-_MOST_S, _MOST_S + _COARSE_S / 2, _COARSE_S)
    table = _residuals(pairs, track, turn, late_s)
    covered = np.isfinite(table).mean(axis=0) > _MOST_LACKING  # of each pair
    if covered.sum() < _LEAST_PAIRS:
        return None
    means = _means(table[:, covered])
    best = float(late_s[int(np.nanargmin(means))])
    rivals = means[np.abs(late_s - best) > _RIVAL_S]
    if not np.nanmin(means) < _BETTER * np.nanmin(rivals):
        return None
    pairs = [pair for pair, kept in zip(pairs, covered, strict=True) if kept]
    fine_s = best + np.arange(-3 * _COARSE_S, 3 * _COARSE_S + _FINE_S / 2, _FINE_S)
    table = _residuals(pairs, track, turn, fine_s)
    rng = np.random.default_rng(0)
    drawn = [lowest(fine_s, _means(table[:, rng.integers(len(pairs), size=len(pairs))])) for _ in range(_DRAWS)]
    return lowest(fine_s, _means(table)) if float(np.std(drawn)) < _CERTAIN_S else None


def _residuals(
    pairs: Sequence[Pair], track: Trajectory, turn: Float64[np.ndarray, "3 3"], offsets_s: Float64[np.ndarray, " o"]
) -> Float64[np.ndarray, "o p"]:
    """Of each pair, were its images so late; NaN where no pose covers it then."""
    residuals, stamps_ns = Residuals(pairs), np.array([pair.times_ns for pair in pairs], np.int64)
    found = []
    for late_s in offsets_s.tolist():
        at_ns = (stamps_ns - round(late_s * 1e9)).ravel()
        poses, known = interpolate(track.times_ns, track.poses, at_ns, max_gap_s=_MAX_GAP_S)
        motions = poses[1::2].inverse() @ poses[::2]
        found.append(np.where(known[::2] & known[1::2], residuals.of(motions, turn), np.nan))
    return np.array(found)


def _means(table: Float64[np.ndarray, "o p"]) -> Float64[np.ndarray, " o"]:
    """Of each offset over the pairs that are covered then; NaN where these are too few."""
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
