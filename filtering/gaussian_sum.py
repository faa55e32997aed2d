"""A Gaussian sum filter, with all models of the particle filter: what are hypotheses that are born later worth?

Source: Alspach and Sorenson, "Nonlinear Bayesian estimation using Gaussian sum approximations", 1972.
"""

from __future__ import annotations

from filtering.hypotheses import Hypotheses, reduced
from filtering.localizer import ParticleLocalizer

GAUSSIANS = 15
"""So many has the bank of the Gaussian sum."""


class GaussianSumLocalizer(ParticleLocalizer):
    """A bank of Gaussians that begin at the places of the first image; none is born later.

    Of more than 15 the heaviest go on. `max_hypotheses` and `kidnap_per_view` do not count.
    """

    def _fraction_anew(self, novelty: float, agreement: float) -> float:
        return 0.0

    def _reduced(self, belief: Hypotheses) -> Hypotheses:
        c = self.config
        merged = reduced(
            belief,
            divergence=c.merge_divergence,
            least_weight=c.least_weight,
            most=len(belief),
            rng=self._filter_rng,
        )
        return merged[:GAUSSIANS].with_log_weights(merged.log_weights[:GAUSSIANS])
