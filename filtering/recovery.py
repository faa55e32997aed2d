"""How much to distrust the belief: the chance that the camera is not where the particles are.

Source: augmented Monte Carlo localization (Thrun, Burgard and Fox, "Probabilistic Robotics", 2005, §8.3.5), with the
averaged quantity taken before normalisation and relative to what the image could have given.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from filtering.errors import require_within


@dataclass(frozen=True)
class RecoveryConfig:
    """When the belief is doubted."""

    min_kidnap_probability: float = 1e-5
    """κ while the images fit the belief: the chance that the camera is elsewhere all the same; 0 for both: never."""
    max_kidnap_probability: float = 0.1
    """κ per image where no image fits."""
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


_LEAST_EVIDENCE = 1e-9  # log likelihoods begin at 0, where only an outlier is left; a share of 0 is none


@dataclass(frozen=True)
class Recovery:
    """Long- and short-term averages of how well images agree with the belief.

    The agreement of an image is the log of its mean likelihood over the belief as a share of the log of that over its
    own posterior. Of the likelihoods themselves no ratio would do: tempered ones hardly differ between a place that
    fits and one that does not, and normalised weights always average 1/n. Where the belief is in one place, tempering
    the likelihood leaves the share as it is.

    Attributes:
        slow: Long-term average, in [0, 1]; None before the first image.
        fast: Short-term average, in [0, 1].
    """

    slow: float | None = None
    fast: float = 0.0

    def update(self, log_evidence: float, log_best_evidence: float, config: RecoveryConfig) -> Recovery:
        """The averages after an image; one whose likelihood is 1 or less wherever it looks leaves them as they are.

        Args:
            log_evidence: Log of the mean likelihood over the belief, before normalisation.
            log_best_evidence: Log of the mean likelihood over the image's own posterior.
            config: How fast the averages follow.
        """
        if log_best_evidence < _LEAST_EVIDENCE:
            return self
        agreement = float(np.clip(log_evidence / log_best_evidence, 0.0, 1.0))
        if self.slow is None:
            return Recovery(agreement, agreement)
        return Recovery(
            self.slow + config.slow_rate * (agreement - self.slow),
            self.fast + config.fast_rate * (agreement - self.fast),
        )

    @property
    def doubt(self) -> float:
        """1 − fast/slow, in [0, 1]: 0 while images agree with the belief as they long have, 1 where none does."""
        if self.slow is None or self.slow <= 0.0:
            return 0.0
        return float(np.clip(1.0 - self.fast / self.slow, 0.0, 1.0))

    def kidnap_probability(self, config: RecoveryConfig) -> float:
        """κ from its least to its greatest value, in equal ratios, as the doubt goes from 0 to 1."""
        return config.min_kidnap_probability ** (1.0 - self.doubt) * config.max_kidnap_probability**self.doubt

    def reset(self) -> Recovery:
        """The averages once the belief has moved: the past doubt does not count against the new place."""
        return self if self.slow is None else replace(self, fast=self.slow)
