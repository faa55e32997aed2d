"""Recorded and visual odometry of one camera as one."""

from __future__ import annotations

from collections import deque

import numpy as np
from jaxtyping import Float64

from filtering.motion import Odometry, joined
from filtering.se3 import Poses

_UNIT_STD, _LEAST_UNIT, _MOST_UNIT = 1.0, 0.1, 10.0  # of the unit of visual odometry over its expected one
_UNIT_CHANGES_S = 200.0  # time in which the unit changes
_NEW_UNIT = 0.5  # standard deviation of another unit, over the one before
_WINDOW_S = 1.0  # over which both are compared, and for which their errors last
_DISAGREE = np.array([22.5, 10.8])  # squared distances that one in a thousand exceeds: of the motion, along the way
_AGREE = np.array([16.8, 4.0])  # and that one in a hundred, and one in twenty exceeds
_MOVED = 25.0  # squared distance of a motion from none: it teaches the unit
_SMALL = 1e-3  # change of the unit, for a derivative
_LONGEST_S = 10.0  # of a disagreement while both move: then the unit is another one


class OdometryFusion:
    """Fuses recorded and visual odometry, image by image.

    The unit of visual odometry is found by comparing both. Where they agree, the motion is that of both, weighted by
    their covariances. Where they do not, as where a wheel slips or a crowd moves, the motion is that of the visual
    odometry in the unit found, and its covariance includes the difference.

    Attributes:
        disagreed_s: Seconds during which they disagreed, so far.
    """

    def __init__(self) -> None:
        """Before the first motion."""
        self._unit, self._variance = 1.0, _UNIT_STD**2
        self._recent: deque[tuple[Odometry, Odometry]] = deque()
        self._learned_s = self._disagree_s = 0.0  # since the unit was learned, and since both agreed
        self.disagreed_s = 0.0

    @property
    def unit(self) -> float:
        """Metres of a unit of visual odometry, as found so far."""
        return self._unit

    def step(self, recorded: Odometry | None, visual: Odometry | None) -> Odometry | None:
        """The motion by both; by one where the other is unknown; None where both are."""
        if visual is None or recorded is None:
            self._recent.clear()
            self._learned_s = 0.0
            if visual is None:  # it may begin anew, in another unit
                self._forget_unit()
            return recorded if visual is None else self._lasting(visual)
        self._recent.append((recorded, visual))
        while sum(one.duration_s for one, _ in self._recent) - self._recent[0][0].duration_s > _WINDOW_S:
            self._recent.popleft()
        by_recorded, by_visual = (joined([pair[i] for pair in self._recent]) for i in (0, 1))
        assert by_recorded is not None
        assert by_visual is not None
        apart = _apart(by_recorded, self._metric(by_visual, self._variance))
        if (apart > (_AGREE if self._disagree_s > 0.0 else _DISAGREE)).any():
            if self._disagree_s > _LONGEST_S and _moves(by_recorded) and _moves(by_visual):
                self._forget_unit()
            return self._in_dispute(recorded, visual)
        self._variance -= np.expm1(-2.0 * recorded.duration_s / _UNIT_CHANGES_S) * (_UNIT_STD**2 - self._variance)
        self._disagree_s = 0.0
        self._learned_s += recorded.duration_s
        # By long motions, as the noise of short ones would seem to be length.
        if self._learned_s >= _WINDOW_S and (apart < _AGREE).all() and _moves(by_recorded) and _moves(by_visual):
            self._learn(by_recorded, by_visual)
            self._learned_s = 0.0
        return _product(recorded, self._lasting(visual))

    def _forget_unit(self) -> None:
        self._variance = max(self._variance, (_NEW_UNIT * self._unit) ** 2)

    def _in_dispute(self, recorded: Odometry, visual: Odometry) -> Odometry:
        """The motion where both disagree; the difference lasts."""
        seen, duration_s = self._lasting(visual), recorded.duration_s
        self._learned_s = 0.0
        self._disagree_s += duration_s
        self.disagreed_s += duration_s
        apart = recorded.previous_from_current.between(seen.previous_from_current).log()
        covariance = seen.covariance + _lasts(duration_s) * np.outer(apart, apart)
        return Odometry(seen.previous_from_current, covariance, duration_s)

    def _lasting(self, visual: Odometry) -> Odometry:
        """Visual odometry in metres. The error of its unit lasts, so it counts for more than in one motion."""
        return self._metric(visual, _lasts(visual.duration_s) * self._variance)

    def _metric(self, visual: Odometry, variance: float) -> Odometry:
        """Visual odometry in metres, with a variance of its unit."""
        tangent, lengths = visual.previous_from_current.log(), np.repeat([1.0, 0.0], 3)
        moved = Poses.exp((1.0 + (self._unit - 1.0) * lengths) * tangent)
        longer = Poses.exp((1.0 + (self._unit + _SMALL - 1.0) * lengths) * tangent)
        by_unit = moved.between(longer).log() / _SMALL
        spread = np.diag(1.0 + (np.hypot(self._unit, np.sqrt(self._variance)) - 1.0) * lengths)
        covariance = spread @ visual.covariance @ spread + variance * np.outer(by_unit, by_unit)
        return Odometry(moved, covariance, visual.duration_s)

    def _learn(self, recorded: Odometry, visual: Odometry) -> None:
        """Correct the unit by one motion: a Kalman update."""
        along, length = visual.previous_from_current.log()[:3], recorded.previous_from_current.log()[:3]
        noise = recorded.covariance[:3, :3] + self._unit**2 * visual.covariance[:3, :3]
        information = np.linalg.solve(noise, along)
        of_motion = float(along @ information)
        variance = 1.0 / (1.0 / self._variance + of_motion)
        unit = self._unit + variance * float(information @ (length - self._unit * along))
        self._unit = min(max(unit, _LEAST_UNIT), _MOST_UNIT)
        self._variance = variance


def _lasts(duration_s: float) -> float:
    """How much more an error that lasts for a window counts, in one motion of it, than white noise."""
    return max(1.0, _WINDOW_S / max(duration_s, 1e-9))


def _moves(motion: Odometry) -> bool:
    """Whether a motion is one for certain."""
    way = motion.previous_from_current.translation
    return bool(way @ np.linalg.solve(motion.covariance[:3, :3] + 1e-12 * np.eye(3), way) > _MOVED)


def _apart(recorded: Odometry, seen: Odometry) -> Float64[np.ndarray, " 2"]:
    """Squared distances of two motions: of all six degrees of freedom, and along the way."""
    difference = recorded.previous_from_current.between(seen.previous_from_current).log()
    spread = recorded.covariance + seen.covariance
    way = recorded.previous_from_current.translation
    along = (way @ difference[:3]) ** 2 / max(float(way @ spread[:3, :3] @ way), 1e-300)
    return np.array([difference @ np.linalg.solve(spread, difference), along])


def _product(one: Odometry, other: Odometry) -> Odometry:
    """The motion by two independent ones: the product of their Gaussians."""
    difference = one.previous_from_current.between(other.previous_from_current).log()
    gain: Float64[np.ndarray, "6 6"] = np.linalg.solve(one.covariance + other.covariance, one.covariance).T
    keeps = np.eye(6) - gain
    covariance = keeps @ one.covariance @ keeps.T + gain @ other.covariance @ gain.T
    return Odometry(one.previous_from_current @ Poses.exp(gain @ difference), covariance, one.duration_s)
