"""The filter with one of its parts taken out, to see what that part is worth."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

from filtering.config import LocalizerConfig
from filtering.error_model import ErrorModel
from filtering.localizer import ParticleLocalizer
from filtering.motion import SlowErrors
from filtering.rivals import DoubtingLocalizer


@dataclass(frozen=True)
class Variant:
    """Changes to the settings of a filter.

    Attributes:
        meaning: What is different.
        kind: The filter.
        localizer: Settings of the filter -> those of the variant.
        errors: How images err -> how the variant takes them to.
        told_of_kidnap: Whether it is told that the camera was carried off, and starts anew there.
    """

    meaning: str
    kind: type[ParticleLocalizer] = ParticleLocalizer
    localizer: Callable[[LocalizerConfig], LocalizerConfig] = lambda config: config
    errors: Callable[[ErrorModel], ErrorModel] = lambda errors: errors
    told_of_kidnap: bool = False


def _each_image_anew(errors: ErrorModel) -> ErrorModel:
    return replace(errors, lasting_share=0.0, length_m=1e-6 * errors.length_m, length_rad=1e-6)


# To add one: a name, what is different, and a function of the settings.
VARIANTS: Mapping[str, Variant] = MappingProxyType(
    {
        "full": Variant("the filter as it is"),
        "no-lasting-errors": Variant("every image errs anew, and its view is new", errors=_each_image_anew),
        "no-tails": Variant("Gaussian errors", errors=lambda errors: replace(errors, tail=1e6)),
        "no-adaptation": Variant(
            "images err as their model says, whatever odometry shows",
            localizer=lambda config: replace(config, adapt_errors=False),
        ),
        "trusting-shares": Variant(
            "a place is as possible as its share of the samples",
            errors=lambda errors: replace(errors, possible_share=1.0),
        ),
        "no-slow-errors": Variant(
            "the odometry errs as white noise only",
            localizer=lambda config: replace(config, slow_errors=SlowErrors(scale=0.0, relative_drift=0.0)),
        ),
        "no-injection": Variant(
            "no hypothesis is added after the first image",
            localizer=lambda config: replace(config, kidnap_per_view=0.0, max_kidnap_per_view=0.0),
        ),
        "inject-on-doubt": Variant("hypotheses are added where the images cast doubt, as in AMCL", DoubtingLocalizer),
        "told-of-kidnap": Variant("starts anew where the camera was carried to", told_of_kidnap=True),
    }
)
"""Variants by name."""
