"""Two recordings of one motion, by two clocks -> how far the clocks are apart, from how fast it turned.

How fast a rigid body turns is the same in every frame of the world and at every place on the body, so that neither
needs to be known.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from jaxtyping import Float64
from scipy.ndimage import uniform_filter1d
from scipy.signal import correlate, find_peaks

from filtering.errors import VaporTrackError
from sequences.errors import SequenceError
from sequences.frame import Trajectory
from sequences.trajectories.interpolation import interpolate

_STEP_S = 0.02
_SPAN = 20  # steps over which a turn is measured: noise of single poses counts little
_LEAST_OVERLAP_S = 10.0
_MAX_GAP_S = 0.5
_MAX_STEPS = 1 << 21  # half a day
_LEAST_CORRELATION = 0.6
_RIVAL_FRACTION = 0.9  # another offset must correlate by less than this fraction of the best
_LEAST_TURN_RAD_PER_S = 0.02  # standard deviation of how fast it turns
_FASTEST = 1.5  # of the 95th percentile of turn rates
_CERTAIN_S, _AUTO_CERTAIN_S = 0.004, 0.02  # standard deviation of the offset, at most
_WARN_WITHIN_S, _WARN_CERTAIN_S, _WARN_FROM_S, _WARN_DEVIATIONS = 5.0, 0.05, 0.05, 4.0


def find_time_offset(odometry: Trajectory, poses: Trajectory, *, within_s: float = np.inf) -> float:
    """Seconds to add to the stamps of poses for those of odometry, to a fraction of their intervals.

    Args:
        odometry: One recording of the motion.
        poses: The other.
        within_s: Only offsets up to this are possible, either way: a motion that repeats itself has others, too.

    Raises:
        SequenceError: too short, too little or too regular a rotation, or rotations that do not agree.
    """
    return _find(odometry, poses, within_s, _CERTAIN_S)[0]


def _find(odometry: Trajectory, poses: Trajectory, within_s: float, certain_s: float) -> tuple[float, float]:
    """The offset and its standard deviation, seconds.

    Turn rates over 0.4 s are correlated at every offset with ten seconds and half of the shorter recording in common. A
    parabola through the largest correlation and its neighbours refines the grid of 20 ms.
    """
    rates, covered = _turn_rate(odometry, "odometry")
    its_rates, its_covered = _turn_rate(poses, "poses")
    both = (rates, covered), (its_rates, its_covered)
    for (rate, known), what in zip(both, ("odometry", "poses"), strict=True):
        spread = float(np.std(rate[known])) if known.any() else 0.0
        if spread < _LEAST_TURN_RAD_PER_S:
            raise SequenceError(
                f"rotation determines no time offset: that of the {what} varies by {spread:.2g} rad/s,"
                f" expected at least {_LEAST_TURN_RAD_PER_S:g}; give --time-offset-s a number"
            )
    # Turning much faster than the slower of the two is an outlier, as of an estimate of another place.
    fastest = _FASTEST * min(float(np.quantile(rate[known], 0.95)) for rate, known in both)
    covered, its_covered = (known & (rate < fastest) for rate, known in both)
    correlation, seconds = _correlation(rates, covered, its_rates, its_covered)
    begin_s = (int(odometry.times_ns[0]) - int(poses.times_ns[0])) * 1e-9
    offsets_s = begin_s + (np.arange(len(correlation)) - (len(its_rates) - 1)) * _STEP_S
    correlation = np.where(np.abs(offsets_s) <= within_s, correlation, 0.0)
    best = int(np.argmax(correlation))
    peak = float(correlation[best])
    others = find_peaks(correlation)[0]
    rival = float(correlation[others[others != best]].max(initial=0.0))
    left, right = (float(correlation[min(max(best + side, 0), len(correlation) - 1)]) for side in (-1, 1))
    bend = max(2 * peak - left - right, 1e-12)
    # Errors of the turn rate are independent where it is measured over other times; a sharp peak makes them small.
    independent = max(float(seconds[best]) / (_SPAN * _STEP_S), 1.0)
    deviation_s = _STEP_S * np.sqrt(max(1 - peak**2, 0.0) / (independent * bend))
    why = ""
    if peak < _LEAST_CORRELATION:
        why = (
            f"odometry and poses turn alike by {peak:.2f} at best (correlation), expected at least"
            f" {_LEAST_CORRELATION:g}"
        )
    elif rival > _RIVAL_FRACTION * peak:
        why = f"odometry and poses turn as much alike at two offsets (correlation {peak:.2f} and {rival:.2f})"
    elif deviation_s > certain_s:
        why = f"it would be uncertain by {1e3 * deviation_s:.1f} ms, expected at most {1e3 * certain_s:g} ms"
    if why:
        raise SequenceError(f"rotation determines no time offset: {why}; give --time-offset-s a number")
    return float(offsets_s[best]) + 0.5 * (right - left) / bend * _STEP_S, float(deviation_s)


def offset_of_clocks(
    asked: float | Literal["auto"], odometry: Trajectory, poses: Trajectory, name: str
) -> tuple[float, list[str]]:
    """Seconds to add to the stamps of poses for those of odometry, as asked or found by rotation; and notices.

    `name` is the name of the poses in messages. Raises SequenceError where rotations do not determine the offset that
    is to be found.
    """
    if asked == "auto":
        try:
            found_s, deviation_s = _find(odometry, poses, np.inf, _AUTO_CERTAIN_S)
        except VaporTrackError as error:
            raise SequenceError(f"{name}: {error}") from error
        return found_s, [f"{name}: time offset {found_s:.4f} s found by rotation (± {1e3 * deviation_s:.1f} ms)"]
    shifted = Trajectory(poses.times_ns + round(asked * 1e9), poses.poses)
    try:
        left_s, deviation_s = _find(odometry, shifted, _WARN_WITHIN_S, _WARN_CERTAIN_S)
    except VaporTrackError:
        return asked, []  # rotations determine nothing either way
    if abs(left_s) < max(_WARN_FROM_S, _WARN_DEVIATIONS * deviation_s):
        return asked, []
    return asked, [
        f"{name}: by its rotation the clock differs: {asked + left_s:.2f} s are to be added to its stamps, not"
        f" {asked:g} s (--time-offset-s)"
    ]


def _turn_rate(track: Trajectory, what: str) -> tuple[Float64[np.ndarray, " n"], np.ndarray]:
    """How fast a track turns, rad/s, on a grid that begins with it; and where it is known."""
    span_ns = int(track.times_ns[-1] - track.times_ns[0])
    if not _LEAST_OVERLAP_S <= span_ns * 1e-9 <= _MAX_STEPS * _STEP_S:
        raise SequenceError(
            f"{span_ns * 1e-9:.3g} s of {what}, expected {_LEAST_OVERLAP_S:g} to {_MAX_STEPS * _STEP_S:.3g} s to find"
            " a time offset in; give --time-offset-s a number"
        )
    apart_s = float(np.median(np.diff(track.times_ns))) * 1e-9
    if apart_s > _MAX_GAP_S:
        raise SequenceError(
            f"{what} {apart_s:.3g} s apart, expected at most {_MAX_GAP_S:g} s to find a time offset in;"
            " give --time-offset-s a number"
        )
    half_ns = round(_SPAN / 2 * _STEP_S * 1e9)
    grid = track.times_ns[0] + np.arange(int(span_ns * 1e-9 / _STEP_S) + 1) * round(_STEP_S * 1e9)
    begins, begun = interpolate(track.times_ns, track.poses, grid - half_ns, max_gap_s=_MAX_GAP_S)
    ends, ended = interpolate(track.times_ns, track.poses, grid + half_ns, max_gap_s=_MAX_GAP_S)
    _, radians = begins.distance(ends)
    known = begun & ended
    # Twice a mean over 60 ms: corners where poses are interpolated are no turn of their own.
    rate = uniform_filter1d(uniform_filter1d(np.where(known, radians / (_SPAN * _STEP_S), 0.0), 3), 3)
    return rate, known


def _correlation(a: np.ndarray, in_a: np.ndarray, b: np.ndarray, in_b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pearson's correlation at every lag, over what both know, 0 where that is too little; and how long that is, s."""
    known_a, known_b = in_a.astype(np.float64), in_b.astype(np.float64)
    a, b = (a - a[in_a].mean()) * known_a, (b - b[in_b].mean()) * known_b
    count = np.maximum(np.round(correlate(known_a, known_b, method="fft")), 1.0)
    mean_a = correlate(a, known_b, method="fft") / count
    mean_b = correlate(known_a, b, method="fft") / count
    product = correlate(a, b, method="fft") / count - mean_a * mean_b
    variance_a = correlate(a**2, known_b, method="fft") / count - mean_a**2
    variance_b = correlate(known_a, b**2, method="fft") / count - mean_b**2
    least = max(_LEAST_OVERLAP_S / _STEP_S, min(known_a.sum(), known_b.sum()) / 2)
    enough = (
        (count >= least) & (variance_a > _LEAST_TURN_RAD_PER_S**2 / 4) & (variance_b > _LEAST_TURN_RAD_PER_S**2 / 4)
    )
    scale = np.sqrt(np.where(enough, variance_a * variance_b, 1.0))
    return np.where(enough, product / scale, 0.0), count * _STEP_S
