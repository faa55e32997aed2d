"""The filters that are compared: ours as it ships, ours with as many hypotheses, and two textbook ones."""

from __future__ import annotations

import importlib.metadata
from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib.util import find_spec

import numpy as np

from filtering.config import LocalizerConfig
from filtering.error_model import ErrorModel
from filtering.localizer import ParticleLocalizer
from filtering.motion import Odometry
from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from vapor.benchmark.textbook.building_blocks import SURE, TextbookFilter, TextbookSettings, drawn
from vapor.tracking.passage import posterior_of

OURS = "filter"
TEXTBOOK = ("filterpy", "particles")
INSTALL_PARTICLES = "pip install numba joblib; pip install --no-deps particles"
"""Its metadata asks for numpy below 2, so pip would not install it beside this package; it works with later ones."""


@dataclass(frozen=True)
class Image:
    """What a filter is given of an image: samples (m,), how unlike the training images it is, the motion before it."""

    samples: Poses
    unfamiliarity: float
    odometry: Odometry


@dataclass(frozen=True)
class Said:
    """What a filter said after an image: its best pose, whether it is sure of it, and how many particles it had."""

    best: Poses
    converged: bool
    particles: int


Step = Callable[[Image], Said]


@dataclass(frozen=True)
class Method:
    """A filter with a number of particles.

    Attributes:
        name: `OURS` or one of `TEXTBOOK`.
        particles: How many; None for ours with its own settings.
    """

    name: str
    particles: int | None = None

    @property
    def key(self) -> str:
        """Its name in results."""
        return self.name if self.particles is None else f"{self.name}-{self.particles}"


def installed() -> tuple[str, ...]:
    """The textbook filters whose library is here."""
    return tuple(name for name in TEXTBOOK if find_spec(name) is not None)


def versions() -> dict[str, str]:
    """Versions of their libraries, by name."""
    return {name: importlib.metadata.version(name) for name in installed()}


def start(
    method: Method, config: LocalizerConfig, errors: ErrorModel, settings: TextbookSettings, rng: np.random.Generator
) -> Step:
    """A filter that has seen nothing yet: called with image after image, it says what it believes.

    Args:
        method: Which.
        config: Settings of ours.
        errors: How the images err; a textbook filter takes nothing from it but the size of the map.
        settings: Of a textbook filter.
        rng: Source of all randomness.
    """
    if method.name != OURS:
        textbook = _start_textbook(method, settings, errors.flat_log_density, rng)

        def update(image: Image) -> Said:
            best, weight = textbook.update(image.samples, image.odometry)
            return Said(best, weight >= SURE, method.particles or 0)

        return update
    if method.particles is not None:
        config = replace(config, max_hypotheses=method.particles, merge_divergence=0.0, least_weight=0.0)
    localizer = ParticleLocalizer(None, config, rng=rng)
    crowd = method.particles  # until the first image, as otherwise an image has a few places

    def localize(image: Image) -> Said:
        nonlocal crowd
        if crowd is None:
            posterior = posterior_of(image.samples, errors, image.unfamiliarity)
        else:
            particles = drawn(image.samples, crowd, settings, rng)
            posterior = PosePosterior.from_estimates(particles, settings.kernel_m, settings.kernel_rad, errors)
            crowd = None
        estimate = localizer.update(posterior, image.odometry)
        return Said(estimate.modes[0].world_from_camera, estimate.status == "converged", len(estimate.particles))

    return localize


def _start_textbook(
    method: Method, settings: TextbookSettings, flat_log_density: float, rng: np.random.Generator
) -> TextbookFilter:
    if method.name == "filterpy":
        from vapor.benchmark.textbook.with_filterpy import FilterpyFilter as Filter
    else:
        from vapor.benchmark.textbook.with_particles import ParticlesFilter as Filter
    return Filter(method.particles or 1, settings, flat_log_density, rng)
