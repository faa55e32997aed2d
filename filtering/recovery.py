"""How much to distrust the belief: the chance that the camera is not where the particles are.

Source: augmented Monte Carlo localization (Thrun, Burgard and Fox, "Probabilistic Robotics", 2005, §8.3.5), with the
averaged quantity taken before normalisation and relative to what the image could have given.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from filtering.errors import require_within
from filtering.particles import log_sum


@dataclass(frozen=True)
class RecoveryConfig:
    """When the belief is doubted."""

    min_kidnap_probability: float = 1e-4
    """κ while the images fit the belief: chance per image that the camera was carried elsewhere unnoticed; 0: never."""
    max_kidnap_probability: float = 0.1
    """κ at most, however badly the images fit."""
    slow_rate: float = 0.02
    """Share of the long-term average that one image replaces."""
    fast_rate: float = 0.25
    """Share of the short-term average that one image replaces."""

    def __post_init__(self) -> None:
        require_within(
            self,
            max_kidnap_probability=(0.0, 1.0),
            min_kidnap_probability=(0.0, self.max_kidnap_probability),
            slow_rate=(0.0, 1.0),
            fast_rate=(0.0, 1.0),
        )


@dataclass(frozen=True)
class Recovery:
    """Long- and short-term averages of how well images fit the belief, each relative to the best they could.

    Attributes:
        slow: Long-term average, in [0, 1]; None before the first image.
        fast: Short-term average, in [0, 1].
    """

    slow: float | None = None
    fast: float = 0.0

    def update(self, agreement: float, config: RecoveryConfig) -> Recovery:
        """The averages after an image with this `agreement`."""
        if self.slow is None:
            return Recovery(agreement, agreement)
        return Recovery(
            self.slow + config.slow_rate * (agreement - self.slow),
            self.fast + config.fast_rate * (agreement - self.fast),
        )

    def kidnap_probability(self, config: RecoveryConfig) -> float:
        """κ from its least to its greatest value, in equal ratios, as the doubt 1 − fast/slow goes from 0 to 1."""
        if self.slow is None or self.slow <= 0.0:
            return config.min_kidnap_probability
        doubt = float(np.clip(1.0 - self.fast / self.slow, 0.0, 1.0))
        return config.min_kidnap_probability ** (1.0 - doubt) * config.max_kidnap_probability**doubt

    def reset(self) -> Recovery:
        """The averages once the belief has moved: the past doubt does not count against the new place."""
        return self if self.slow is None else replace(self, fast=self.slow)


def agreement(log_evidence: float, log_best_evidence: float) -> float:
    """Mean likelihood over the belief relative to the mean over the image's own posterior, at most 1, from their logs.

    Both are means of unnormalised likelihoods: normalised weights always average 1/n and could tell nothing.
    """
    return float(np.exp(min(0.0, log_evidence - log_best_evidence)))


def log_mean(log_values: Float64[np.ndarray, " n"], log_weights: Float64[np.ndarray, " n"] | None = None) -> float:
    """Log of the mean of exp(values) (n,), weighted by exp(weights), which need not be normalised; equal without."""
    if log_weights is None:
        return log_sum(log_values) - float(np.log(len(log_values)))
    return log_sum(log_values + log_weights) - log_sum(log_weights)
