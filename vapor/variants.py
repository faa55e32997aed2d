"""The filter with one of its parts taken out, to see what that part is worth."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from filtering.localizer import LocalizerConfig, ParticleLocalizer
from filtering.particles import log_mean
from filtering.posterior import LikelihoodModel
from filtering.proposal import Proposal
from filtering.se3 import Poses


@dataclass(frozen=True)
class Variant:
    """Changes to the settings of a filter.

    Attributes:
        meaning: What is different.
        kind: The filter.
        localizer: Settings of the filter -> those of the variant.
        likelihood: The likelihood and the poses that its prior is made of -> that of the variant.
        told_of_kidnap: Whether it is told that the camera was carried off, and starts anew there.
    """

    meaning: str
    kind: type[ParticleLocalizer] = ParticleLocalizer
    localizer: Callable[[LocalizerConfig], LocalizerConfig] = lambda config: config
    likelihood: Callable[[LikelihoodModel, Poses], LikelihoodModel] = lambda model, poses: model
    told_of_kidnap: bool = False


def _flat_prior(model: LikelihoodModel, poses: Poses) -> LikelihoodModel:
    """π flat, at the geometric mean of what it was where cameras are: ε then keeps its meaning on average."""
    return replace(model, prior=None, prior_floor=float(np.exp(np.mean(model.log_prior(poses)))))


def _no_recovery(config: LocalizerConfig) -> LocalizerConfig:
    return replace(config, recovery=replace(config.recovery, min_kidnap_probability=0.0, max_kidnap_probability=0.0))


class EqualInjectedWeights(ParticleLocalizer):
    """Injected particles weigh 1/n each whatever the belief says of where they are, as in public filters."""

    def _weigh(self, proposal: Proposal, log_likelihood: np.ndarray) -> np.ndarray:
        moved = slice(proposal.num_from_motion)
        log_weights = log_likelihood[moved] + proposal.log_predicted[moved] - proposal.log_moved[moved]
        injected = np.full(len(log_likelihood) - proposal.num_from_motion, log_mean(log_weights))
        return np.concatenate([log_weights, injected])


# To add one: a name, what is different, and a function of the settings.
VARIANTS: Mapping[str, Variant] = MappingProxyType(
    {
        "full": Variant("the filter as it is"),
        "no-prior": Variant("posterior not divided by π", likelihood=_flat_prior),
        "no-tempering": Variant("β = β_d = 1", likelihood=lambda m, _: replace(m, temper=1.0, detail_temper=1.0)),
        "no-saturation": Variant("c = ∞, β = 0.1", likelihood=lambda m, _: replace(m, temper=0.1, saturation=np.inf)),
        "no-injection": Variant("φ = 0", localizer=lambda config: replace(config, injection_fraction=0.0)),
        "equal-injected-weights": Variant("injected particles weigh 1/n", EqualInjectedWeights),
        "no-recovery": Variant("κ = 0", localizer=_no_recovery),
        "told-of-kidnap": Variant("starts anew where the camera was carried to", told_of_kidnap=True),
        "fixed-size": Variant("1000 particles", localizer=lambda config: replace(config, num_particles=1000)),
    }
)
"""Variants by name."""
