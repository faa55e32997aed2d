"""Ablations: the filter with one of its parts taken out, to see what that part is worth."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from filtering.config import LocalizerConfig
from filtering.estimate import Estimate
from filtering.localizer import ParticleLocalizer
from filtering.measurement_noise import MeasurementNoise
from filtering.motion import OdometryBias
from filtering.observation import Observation
from vapor.tracking.loop import Localizer


@dataclass(frozen=True)
class Ablation:
    """Changes to the settings of a filter and to the measurement noise.

    With `known_kidnap` the filter restarts where the camera was carried to.
    """

    meaning: str
    localizer: Callable[[LocalizerConfig], LocalizerConfig] = lambda config: config
    noise: Callable[[MeasurementNoise], MeasurementNoise] = lambda noise: noise
    known_kidnap: bool = False

    def start(self, config: LocalizerConfig, *, rng: np.random.Generator, kidnap_index: int | None = None) -> Localizer:
        """The ablated filter, of changed settings; `kidnap_index` is the first image after a kidnap."""

        def begin() -> ParticleLocalizer:
            return ParticleLocalizer(None, config, rng=rng)

        return _KnownKidnap(begin, kidnap_index) if self.known_kidnap else begin()


class _KnownKidnap:
    def __init__(self, begin: Callable[[], ParticleLocalizer], kidnap_index: int | None) -> None:
        self._begin = begin
        self._kidnap_index = kidnap_index
        self._localizer = begin()
        self._images = 0

    def advance(self, observation: Observation) -> Estimate:
        if self._images == self._kidnap_index:
            self._localizer, observation = self._begin(), replace(observation, odometry=None)
        self._images += 1
        return self._localizer.advance(observation)


def _independent(noise: MeasurementNoise) -> MeasurementNoise:
    verified = None if noise.verified is None else _independent(noise.verified)
    new = {"correlated_fraction": 0.0, "length_m": 1e-6 * noise.length_m, "length_rad": 1e-6}
    return replace(noise, **new, verified=verified)


def _gaussian(noise: MeasurementNoise) -> MeasurementNoise:
    return replace(
        noise, degrees_of_freedom=1e6, verified=None if noise.verified is None else _gaussian(noise.verified)
    )


# To add one: a name, the difference, and a function of the settings.
ABLATIONS: Mapping[str, Ablation] = MappingProxyType(
    {
        "full": Ablation("the filter as it is"),
        "no-correlation": Ablation("every image errs independently, and its view is new", noise=_independent),
        "no-tails": Ablation("Gaussian errors", noise=_gaussian),
        "no-adaptation": Ablation(
            "images err as modelled, whatever odometry shows",
            localizer=lambda config: replace(config, adapt_errors=False),
        ),
        "trusting-fractions": Ablation(
            "a place is as probable as the fraction of the samples in it",
            noise=lambda noise: replace(noise, possible_fraction=1e-9, weight_power=1.0),
        ),
        "no-odometry-bias": Ablation(
            "the odometry errs as white noise only",
            localizer=lambda config: replace(config, odometry_bias=OdometryBias(scale=0.0, relative_drift=0.0)),
        ),
        "no-injection": Ablation(
            "no hypothesis is added after the first image",
            localizer=lambda config: replace(
                config, births="rate", birth_rate=0.0, max_birth_rate=0.0, odometry_failures_per_s=0.0
            ),
        ),
        "inject-on-doubt": Ablation(
            "hypotheses are added where the images cast doubt, as in AMCL",
            localizer=lambda config: replace(config, births="augmented-mcl"),
        ),
        "known-kidnap": Ablation("restarts where the camera was carried to", known_kidnap=True),
    }
)
"""Ablations by name; `full` is none."""
