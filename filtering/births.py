"""How much of the belief becomes unassigned: the camera may have been carried off unnoticed.

Source: Thrun, Burgard and Fox, "Probabilistic robotics", 2005, § 8.3.3 (augmented Monte Carlo localization).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType

import numpy as np

from filtering.belief import Belief
from filtering.config import Births, LocalizerConfig


def at_a_rate(belief: Belief, novelty: float, agreement: float, config: LocalizerConfig) -> float:
    """In proportion to the novelty of the view, at a rate that is larger for views that do not fit the belief."""
    doubt = 1.0 - min(1.0, agreement / config.converged_agreement)
    rate = config.birth_rate ** (1.0 - doubt) * config.max_birth_rate**doubt
    return float(-np.expm1(-rate * novelty))


def augmented_mcl(belief: Belief, novelty: float, agreement: float, config: LocalizerConfig) -> float:
    """As in augmented Monte Carlo localization: only while images agree with the belief less than usual.

    The averages are those before this image.
    """
    return max(0.0, 1.0 - belief.agreement / max(belief.usual_agreement, 1e-9))


# To add one: a function, its name here and in `Births`.
BIRTHS: Mapping[Births, Callable[[Belief, float, float, LocalizerConfig], float]] = MappingProxyType(
    {"rate": at_a_rate, "augmented-mcl": augmented_mcl}
)
"""Birth probabilities by name, of a belief, the novelty of its views, and how much of it they fit, both in [0, 1]."""
