"""The baselines that step beside the filter: a Kalman filter and a Gaussian sum."""

from __future__ import annotations

import numpy as np

from filtering.config import LocalizerConfig
from filtering.estimate import Mode
from filtering.gaussian_sum import GaussianSumLocalizer
from filtering.motion import Odometry
from filtering.posterior import PosePosterior


class KalmanTracker:
    """One hypothesis, corrected by the place of each image that is nearest to it.

    Args:
        config: Settings of the filter; only the slow errors of odometry and the gaps are used.
        rng: Not used.
    """

    def __init__(self, config: LocalizerConfig, rng: np.random.Generator) -> None:
        from filtering.kalman import KalmanConfig, KalmanLocalizer  # loads FilterPy, which takes a while

        self._localizer = KalmanLocalizer(KalmanConfig(slow_errors=config.slow_errors, gap=config.gap))

    def update(self, posterior: PosePosterior, odometry: Odometry | None, *, elapsed_s: float) -> tuple[Mode, ...]:
        """Take one image, see `Tracker`."""
        return (self._localizer.update(posterior, odometry, elapsed_s=elapsed_s),)


class GaussianSumTracker:
    """The hypotheses of the first image; none is added later. Takes as long as the filter.

    Args:
        config: Settings of the filter.
        rng: Source of its random draws.
    """

    def __init__(self, config: LocalizerConfig, rng: np.random.Generator) -> None:
        self._localizer = GaussianSumLocalizer(None, config, rng=rng)

    def update(self, posterior: PosePosterior, odometry: Odometry | None, *, elapsed_s: float) -> tuple[Mode, ...]:
        """Take one image, see `Tracker`."""
        return self._localizer.update(posterior, odometry, elapsed_s=elapsed_s).modes
