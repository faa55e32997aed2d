"""The baselines that step beside the filter: a Kalman filter and a Gaussian sum."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from filtering.config import LocalizerConfig
from filtering.estimate import Mode
from filtering.localizer import ParticleLocalizer
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


GAUSSIANS = 15
"""Gaussians of the Gaussian sum."""


class GaussianSumTracker:
    """A Gaussian sum filter: the particle filter without births, truncated to its heaviest hypotheses.

    Source: Alspach and Sorenson, "Nonlinear Bayesian estimation using Gaussian sum approximations", 1972.

    Args:
        config: Settings of the filter.
        rng: Source of its random draws.
    """

    def __init__(self, config: LocalizerConfig, rng: np.random.Generator) -> None:
        self._localizer = ParticleLocalizer(None, gaussian_sum(config), rng=rng)

    def update(self, posterior: PosePosterior, odometry: Odometry | None, *, elapsed_s: float) -> tuple[Mode, ...]:
        """Take one image, see `Tracker`."""
        return self._localizer.update(posterior, odometry, elapsed_s=elapsed_s).modes


def gaussian_sum(config: LocalizerConfig) -> LocalizerConfig:
    """The settings of the filter that make it a Gaussian sum filter."""
    rates = {"kidnap_per_view": 0.0, "max_kidnap_per_view": 0.0}
    return replace(config, **rates, births="rate", max_hypotheses=GAUSSIANS, resampling="heaviest")
