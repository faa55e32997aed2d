"""The turns of a gyroscope, its bias, and odometry whose rotation they correct.

Source: Forster, Carlone, Dellaert and Scaramuzza, "On-manifold preintegration for real-time visual-inertial odometry",
2017, of which this is the part of the rotation.
"""

from __future__ import annotations

from collections import deque
from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from filtering.motion import Odometry
from filtering.se3 import Poses
from sequences.inertial.samples import InertialSamples

_GAP_NS = 100_000_000  # between samples, over which a turn is unknown
_WHITE_RAD_PER_SQRT_S = 0.001  # of a small unit, the times of its samples included
_BIAS_RAD_PER_S, _BIAS_CHANGES = 0.02, 1e-4  # standard deviations: of the bias, of its change in a second
_TURN = 0.01  # of a turn: how the unit is mounted, and its scale
_LASTS_S = 1.0  # such errors, and that of the bias, count in each motion as if for so long
_DISPUTED, _USUAL = 16.3, 9.0  # squared distance of three: one in a thousand is above; median where most is wrong
_WATCHED, _FEWEST = 60, 20  # motions


class GyroscopeFusion:
    """Corrects the rotation of odometry by a gyroscope, motion by motion.

    Both are weighted by their covariances; what a correlated translation learns of it follows. The bias of the
    gyroscope is one constant of each axis, found against the rotation of the odometry. Where a rotation differs by more
    than both err, as where a wheel slips in a turn, it is that of the gyroscope; where that is so most of the time, the
    gyroscope is wrong (degrees for radians, other axes, another clock) and not used.

    Attributes:
        num_motions, num_disputed, num_unused: Numbers of motions: with both, in which they differed, and without the
            gyroscope because it is wrong.
    """

    def __init__(self, samples: InertialSamples) -> None:
        """Before the first motion of a recording with these samples."""
        self._times_ns, self._rates = samples.times_ns, samples.turn_rate
        self._bias, self._covariance = np.zeros(3), _BIAS_RAD_PER_S**2 * np.eye(3)
        self._squared: deque[float] = deque(maxlen=_WATCHED)
        self.num_motions = self.num_disputed = self.num_unused = 0

    @property
    def bias(self) -> Float64[np.ndarray, "3"]:
        """Of the turn rate about the axes of the camera, as found so far, rad/s."""
        return self._bias

    def step(self, begin_ns: int, end_ns: int, odometry: Odometry | None) -> Odometry | None:
        """The motion between two times, by odometry and the turns between; None where odometry is unknown."""
        duration_s = (end_ns - begin_ns) * 1e-9
        turned = self.turned(begin_ns, end_ns)
        if odometry is None or turned is None or duration_s <= 0.0:
            return odometry
        self._covariance = self._covariance + _BIAS_CHANGES**2 * duration_s * np.eye(3)
        difference = odometry.previous_from_current.between(turned).log()[3:]
        longer = max(_LASTS_S / duration_s, 1.0)
        angle = float(np.linalg.norm(turned.log()[3:]))
        white = (_WHITE_RAD_PER_SQRT_S**2 * duration_s + longer * (_TURN * angle) ** 2) * np.eye(3)
        by_odometry = odometry.covariance[3:, 3:]
        spread = by_odometry + white + duration_s**2 * self._covariance
        squared = float(difference @ np.linalg.solve(spread, difference))
        self._squared.append(squared)
        self.num_motions += 1
        if len(self._squared) >= _FEWEST and np.median(self._squared) > _USUAL:
            self.num_unused += 1
            return odometry
        disputed = squared > _DISPUTED
        self.num_disputed += disputed
        if not disputed:
            self._learn(difference, by_odometry + white, duration_s)
            turned = self.turned(begin_ns, end_ns)
            assert turned is not None
        lasting = longer * duration_s**2 * self._covariance
        return _corrected(odometry, turned, white + lasting, by_gyroscope=disputed)

    def turned(self, begin_ns: int, end_ns: int) -> Poses | None:
        """The turn of the camera between two times, less the bias found so far; None across a gap."""
        first = int(np.searchsorted(self._times_ns, begin_ns, side="right")) - 1
        last = int(np.searchsorted(self._times_ns, end_ns, side="left"))
        if first < 0 or last >= len(self._times_ns) or end_ns <= begin_ns:
            return None
        times_ns, rates = self._times_ns[first : last + 1], self._rates[first : last + 1]
        if not np.isfinite(rates).all() or np.diff(times_ns).max() > _GAP_NS:
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
        if self.num_disputed:
            return [f"odometry turns otherwise than the gyroscope in {self.num_disputed} of {self.num_motions} motions"]
        return []


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
