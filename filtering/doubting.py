"""The particle filter with hypotheses born as in AMCL: only where images agree with the belief less than usual.

Source: Thrun, Burgard and Fox, "Probabilistic robotics", 2005, § 8.3.3 (augmented Monte Carlo localization).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from filtering.cameras import View
from filtering.config import LocalizerConfig
from filtering.estimate import Estimate
from filtering.localizer import ParticleLocalizer
from filtering.posterior import ObservationModel

_USUAL_S = 10.0  # time over which images usually agree with the belief as they do


class DoubtingLocalizer(ParticleLocalizer):
    """The belief begins anew only while images agree with it less than usual, as in augmented Monte Carlo localization.

    The fraction that does is 1 − fast/slow, fast being their agreement of the last second, slow that of the last ten.
    """

    def __init__(
        self, model: ObservationModel | None, config: LocalizerConfig | None = None, *, rng: np.random.Generator
    ) -> None:
        super().__init__(model, config, rng=rng)
        self._usual = 1.0

    def _fraction_anew(self, novelty: float, agreement: float) -> float:
        return max(0.0, 1.0 - self._agreement / max(self._usual, 1e-9))

    def _look(self, views: Sequence[View]) -> Estimate:
        unseen_s, began = self._unseen_s, self._begins(views)
        estimate = super()._look(views)
        if began:
            self._usual = estimate.agreement
        elif self._unseen_s < unseen_s:  # an image said something
            self._usual += -np.expm1(-unseen_s / _USUAL_S) * (estimate.agreement - self._usual)
        return estimate
