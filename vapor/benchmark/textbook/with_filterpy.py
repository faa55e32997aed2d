"""The textbook filter as FilterPy's building blocks and its book make one.

Source: Labbe, "Kalman and Bayesian Filters in Python", 2020, chapter 12: predict, update, resample, estimate.
"""

from __future__ import annotations

import numpy as np
from filterpy.monte_carlo import systematic_resample

from filtering.motion import Odometry
from filtering.se3 import Poses
from vapor.benchmark.textbook.building_blocks import (
    TextbookSettings,
    drawing_from,
    drawn,
    heaviest_place,
    log_likelihood,
    moved,
)


class FilterpyFilter:
    """See `TextbookFilter`; resamples where the effective sample size falls below half of the particles.

    Args:
        count: Number of particles.
        settings: Of the filter.
        flat_log_density: Of poses spread evenly over the map, per m³ rad³.
        rng: Source of all randomness.
    """

    def __init__(
        self, count: int, settings: TextbookSettings, flat_log_density: float, rng: np.random.Generator
    ) -> None:
        self._count, self._settings, self._flat, self._rng = count, settings, flat_log_density, rng
        self._poses: Poses | None = None
        self._weights = np.full(count, 1.0 / count)

    def update(self, samples: Poses, odometry: Odometry) -> tuple[Poses, float]:
        """Take one image, see `TextbookFilter`."""
        if self._poses is None:
            self._poses = drawn(samples, self._count, self._settings, self._rng)
            return heaviest_place(self._poses, self._weights)
        poses = moved(self._poses, odometry, samples, self._settings, self._rng)
        fits = log_likelihood(samples, poses, self._settings, self._flat)
        weights = self._weights * np.exp(fits - fits.max())
        weights /= weights.sum()
        best = heaviest_place(poses, weights)
        if 1.0 / np.square(weights).sum() < self._count / 2:
            with drawing_from(self._rng):
                poses = poses[systematic_resample(weights)]
            weights = np.full(self._count, 1.0 / self._count)
        self._poses, self._weights = poses, weights
        return best
