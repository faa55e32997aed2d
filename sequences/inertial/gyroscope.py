"""The turns of a gyroscope, its bias, and odometry whose rotation they correct.

Source: Forster, Carlone, Dellaert and Scaramuzza, "On-manifold preintegration for real-time visual-inertial odometry",
2017, of which this is the part of the rotation.
"""

from __future__ import annotations

from collections import deque
from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from filtering.errors import counted
from filtering.motion import Odometry
from filtering.se3 import Poses
from sequences.inertial.rows import TimedRows
from sequences.inertial.samples import InertialSamples

_LEAST_S = 0.01  # a motion of less time, as between images of several cameras, says nothing of how it turns
_GAP_NS = 100_000_000  # between samples, over which a turn is unknown
_WHITE_RAD_PER_SQRT_S = 0.001  # of a small unit, the times of its samples included
_BIAS_RAD_PER_S, _BIAS_CHANGES = 0.02, 1e-4  # standard deviations: of the bias, of its change in a second
_TURN_UP = 20.0  # rad/s²: standard deviation of the change of a rate that is not known yet
_TURN = 0.01  # of a turn: how the unit is mounted, and its scale
_LASTS_S = 1.0  # such errors, and that of the bias, count in each motion as if for so long
_DISPUTED, _USUAL = 16.3, 9.0  # squared distance of three: one in a thousand is above; median where most is wrong
_WATCHED, _FEWEST = 60, 20  # motions


class GyroscopeFusion:
    """Corrects the rotation of odometry by a gyroscope, motion by motion.

    Both are weighted by their covariances; what a correlated translation learns of it follows. The bias of the
    gyroscope is one constant of each axis, found against the rotation of the odometry. Where a rotation differs by more
    than both err, as where a wheel slips in a turn, it is that of the gyroscope; where that is so most of the time, the
    gyroscope is wrong (degrees for radians, other axes, another clock) and not used. Where odometry is unknown, the
    rotation is that of the gyroscope, and only the translation is unknown.

    Attributes:
        num_motions, num_disputed, num_unused, num_alone: Numbers of motions: with both, in which they differed, without
            the gyroscope because it is wrong, and without odometry.
    """

    def __init__(self, samples: InertialSamples | None = None) -> None:
        """Before the first motion, with the samples so far."""
        self._rates = TimedRows(3)
        self._bias, self._covariance = np.zeros(3), _BIAS_RAD_PER_S**2 * np.eye(3)
        self._squared: deque[float] = deque(maxlen=_WATCHED)
        self._learned_ns: int | None = None
        self.num_motions = self.num_disputed = self.num_unused = self.num_alone = 0
        if samples is not None:
            self.extend(samples)

    @property
    def bias(self) -> Float64[np.ndarray, "3"]:
        """Of the turn rate about the axes of the camera, as found so far, rad/s."""
        return self._bias

    def extend(self, samples: InertialSamples) -> None:
        """Take samples that are later than those before."""
        self._rates.extend(samples.times_ns, samples.turn_rate)

    def forget_before(self, time_ns: int) -> None:
        """Drop samples that only earlier times need."""
        self._rates.forget_before(time_ns)

    def begin_anew(self) -> None:
        """Forget the samples, but not the bias: their clock was set."""
        self._rates, self._learned_ns = TimedRows(3), None

    def step(self, begin_ns: int, end_ns: int, odometry: Odometry | None) -> Odometry | None:
        """The motion between two times, by odometry and the turns between; None where both are unknown.

        A motion that was part of one before teaches nothing again.
        """
        duration_s = (end_ns - begin_ns) * 1e-9
        turned = self.turned(begin_ns, end_ns)
        if turned is None or (odometry is not None and duration_s < _LEAST_S):
            return odometry
        longer = max(_LASTS_S / duration_s, 1.0)
        angle, ahead_s = float(np.linalg.norm(turned.log()[3:])), self._ahead_s(end_ns)
        variance = _WHITE_RAD_PER_SQRT_S**2 * duration_s + longer * (_TURN * angle) ** 2
        white = (variance + (_TURN_UP * ahead_s**2 / 2.0) ** 2) * np.eye(3)
        if odometry is None:
            if self._is_wrong:
                return None
            self.num_alone += 1
            return Odometry.turn(turned, white + longer * duration_s**2 * self._covariance, duration_s)
        is_new = self._learned_ns is None or begin_ns >= self._learned_ns
        if is_new:
            self._learned_ns = end_ns
            self._covariance = self._covariance + _BIAS_CHANGES**2 * duration_s * np.eye(3)
        difference, by_odometry = odometry.previous_from_current.between(turned).log()[3:], odometry.covariance[3:, 3:]
        spread = by_odometry + white + duration_s**2 * self._covariance
        squared = float(difference @ np.linalg.solve(spread, difference))
        disputed = squared > _DISPUTED
        if is_new:
            self._squared.append(squared)
            self.num_motions += 1
            self.num_unused += self._is_wrong
            self.num_disputed += disputed and not self._is_wrong
        if self._is_wrong:
            return odometry
        if is_new and not disputed:
            self._learn(difference, by_odometry + white, duration_s)
            turned = self.turned(begin_ns, end_ns)
            assert turned is not None
        lasting = longer * duration_s**2 * self._covariance
        return _corrected(odometry, turned, white + lasting, by_gyroscope=disputed)

    @property
    def _is_wrong(self) -> bool:
        """Whether most of the latest turns are not those of the odometry."""
        return len(self._squared) >= _FEWEST and bool(np.median(self._squared) > _USUAL)

    def turned(self, begin_ns: int, end_ns: int) -> Poses | None:
        """The turn of the camera between two times, less the bias found so far; None across a gap.

        The latest rate goes on for a tenth of a second where no later one has come yet.
        """
        times_ns = self._rates.times_ns
        first = int(np.searchsorted(times_ns, begin_ns, side="right")) - 1
        last = int(np.searchsorted(times_ns, end_ns, side="left"))
        if first < 0 or end_ns <= begin_ns:
            return None
        times_ns, rates = times_ns[first : last + 1], self._rates.rows[first : last + 1]
        if not np.isfinite(rates).all() or np.diff(times_ns, append=max(end_ns, times_ns[-1])).max() > _GAP_NS:
            return None
        # Rates between samples change evenly; each stretch turns by the rate in its middle.
        edges_ns = np.unique(np.clip(np.append(times_ns, [begin_ns, end_ns]), begin_ns, end_ns))
        middles = (edges_ns[:-1] - begin_ns) * 0.5e-9 + (edges_ns[1:] - begin_ns) * 0.5e-9
        at = (times_ns - begin_ns) * 1e-9
        mean = np.stack([np.interp(middles, at, rates[:, axis]) for axis in range(3)], axis=1) - self._bias
        turns = Poses.exp(np.column_stack([np.zeros((len(mean), 3)), mean * (np.diff(edges_ns) * 1e-9)[:, None]]))
        whole = turns[0]
        for each in turns[1:]:
            whole = whole @ each
        return whole

    def _ahead_s(self, time_ns: int) -> float:
        """How far a time is ahead of the latest sample, seconds."""
        return max(time_ns - (self._rates.last_ns or time_ns), 0) * 1e-9

    def _learn(
        self, difference: Float64[np.ndarray, "3"], noise: Float64[np.ndarray, "3 3"], duration_s: float
    ) -> None:
        """Correct the bias by how much further the gyroscope turned: a Kalman update."""
        gain = np.linalg.solve(duration_s**2 * self._covariance + noise, duration_s * self._covariance).T
        self._bias = self._bias + gain @ difference
        keeps = np.eye(3) - duration_s * gain
        self._covariance = keeps @ self._covariance @ keeps.T + gain @ noise @ gain.T

    @property
    def notices(self) -> list[str]:
        """Sentences for users, by the motions so far."""
        if self.num_unused:
            return [
                f"turns by the gyroscope are not those of the odometry, and not used in {self.num_unused} of"
                f" {self.num_motions} motions: another unit (degrees), other axes, or another clock"
            ]
        notices = []
        if self.num_disputed:
            notices = [
                f"odometry turns otherwise than the gyroscope in {self.num_disputed} of {self.num_motions} motions"
            ]
        if self.num_alone:
            notices.append(
                f"only the turns are known of {counted(self.num_alone, 'motion')} without odometry, by the gyroscope"
            )
        return notices


def _corrected(odometry: Odometry, turned: Poses, noise: Float64[np.ndarray, "3 3"], *, by_gyroscope: bool) -> Odometry:
    """Odometry with its rotation corrected by a turn, or replaced by it."""
    moved, covariance = odometry.previous_from_current, odometry.covariance
    difference = moved.between(turned).log()[3:]
    if by_gyroscope:
        own = covariance.copy()
        own[3:, :3] = own[:3, 3:] = 0.0
        own[3:, 3:] = noise
        return replace(odometry, previous_from_current=Poses(turned.rotation, moved.translation), covariance=own)
    gain = np.linalg.solve(covariance[3:, 3:] + noise, covariance[3:, :]).T
    change = gain @ difference
    keeps = np.eye(6)
    keeps[:, 3:] -= gain
    corrected = keeps @ covariance @ keeps.T + gain @ noise @ gain.T
    return replace(odometry, previous_from_current=moved @ Poses.exp(change), covariance=(corrected + corrected.T) / 2)
