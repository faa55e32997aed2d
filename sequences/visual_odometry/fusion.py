"""Recorded and visual odometry of one camera as one."""

from __future__ import annotations

from collections import deque

import numpy as np
from jaxtyping import Float64

from filtering.motion import Odometry
from filtering.se3 import Poses

_UNIT_STD = 1.0  # of the unit of visual odometry over its expected one, before any motion
_UNIT_CHANGES_S = 200.0  # time in which the unit changes
_WINDOW_S = 0.5  # over which both are compared
_DISAGREE = 22.5  # squared distance of six degrees of freedom that one in a thousand exceeds


class OdometryFusion:
    """Fuses recorded and visual odometry, image by image.

    The unit of visual odometry is found by comparing both. Where they agree, the motion is that of both, weighted by
    their covariances. Where they do not, as where a wheel slips or a crowd moves, the motion is that of the visual
    odometry in the unit found, and its covariance includes the difference.
    """

    def __init__(self) -> None:
        """Before the first motion."""
        self._unit, self._variance = 1.0, _UNIT_STD**2
        self._recent: deque[tuple[Odometry, Odometry]] = deque()

    @property
    def unit(self) -> float:
        """Metres of a unit of visual odometry, as found so far."""
        return self._unit

    def step(self, recorded: Odometry | None, visual: Odometry | None) -> Odometry | None:
        """The motion by both; by one where the other is unknown; None where both are."""
        if visual is None or recorded is None:
            self._recent.clear()
            return recorded if visual is None else self._metric(visual)
        duration_s = recorded.duration_s
        self._variance += _UNIT_STD**2 * 2.0 * duration_s / _UNIT_CHANGES_S
        self._recent.append((recorded, visual))
        while sum(one.duration_s for one, _ in self._recent) - self._recent[0][0].duration_s > _WINDOW_S:
            self._recent.popleft()
        by_recorded, by_visual = (_joined([pair[i] for pair in self._recent]) for i in (0, 1))
        seen = self._metric(by_visual)
        difference = by_recorded.previous_from_current.between(seen.previous_from_current).log()
        spread = by_recorded.covariance + seen.covariance
        if difference @ np.linalg.solve(spread, difference) > _DISAGREE:
            apart = recorded.previous_from_current.between(self._metric(visual).previous_from_current).log()
            covariance = self._metric(visual).covariance + np.outer(apart, apart)
            return Odometry(self._metric(visual).previous_from_current, covariance, duration_s)
        self._learn(recorded, visual)
        return _product(recorded, self._metric(visual))

    def _metric(self, visual: Odometry) -> Odometry:
        """Visual odometry in metres; its covariance includes that of its unit."""
        tangent = visual.previous_from_current.log()
        along = np.concatenate([tangent[:3], np.zeros(3)])
        to_metres = np.diag(np.repeat([self._unit, 1.0], 3))
        covariance = to_metres @ visual.covariance @ to_metres + self._variance * np.outer(along, along)
        return Odometry(Poses.exp(to_metres @ tangent), covariance, visual.duration_s)

    def _learn(self, recorded: Odometry, visual: Odometry) -> None:
        """Correct the unit by one motion: a Kalman update."""
        along, length = visual.previous_from_current.log()[:3], recorded.previous_from_current.log()[:3]
        noise = recorded.covariance[:3, :3] + self._unit**2 * visual.covariance[:3, :3]
        information = np.linalg.solve(noise, along)
        of_motion = float(along @ information)
        if of_motion <= 0.0:
            return
        variance = 1.0 / (1.0 / self._variance + of_motion)
        self._unit = max(self._unit + variance * float(information @ (length - self._unit * along)), 1e-3)
        self._variance = variance


def _joined(motions: list[Odometry]) -> Odometry:
    whole = motions[0]
    for motion in motions[1:]:
        whole = whole.then(motion)
    return whole


def _product(one: Odometry, other: Odometry) -> Odometry:
    """The motion by two independent ones: the product of their Gaussians."""
    difference = one.previous_from_current.between(other.previous_from_current).log()
    gain: Float64[np.ndarray, "6 6"] = np.linalg.solve(one.covariance + other.covariance, one.covariance).T
    keeps = np.eye(6) - gain
    covariance = keeps @ one.covariance @ keeps.T + gain @ other.covariance @ gain.T
    return Odometry(one.previous_from_current @ Poses.exp(gain @ difference), covariance, one.duration_s)
