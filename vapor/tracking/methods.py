"""The table of tracking methods, and the baselines.

To add a baseline, write a class that fits `Tracker` and add a row to `METHODS`; reports and tables then include it.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Literal, TypeVar

import numpy as np

from filtering.config import LocalizerConfig
from filtering.localizer import ParticleLocalizer
from vapor.tracking.loop import Tracker

GAUSSIANS = 15
"""Gaussians of the Gaussian sum."""


def _kalman(config: LocalizerConfig, rng: np.random.Generator) -> Tracker:
    from filtering.kalman import KalmanConfig, KalmanLocalizer  # loads FilterPy, which takes a while

    return KalmanLocalizer(KalmanConfig(odometry_bias=config.odometry_bias, gap=config.gap))


def _gaussian_sum(config: LocalizerConfig, rng: np.random.Generator) -> Tracker:
    return ParticleLocalizer(None, gaussian_sum(config), rng=rng)


def gaussian_sum(config: LocalizerConfig) -> LocalizerConfig:
    """The settings of the filter without births, truncated to its heaviest hypotheses: a Gaussian sum filter.

    Source: Alspach and Sorenson, "Nonlinear Bayesian estimation using Gaussian sum approximations", 1972.
    """
    rates = {"birth_rate": 0.0, "max_birth_rate": 0.0, "odometry_failures_per_s": 0.0}
    return replace(config, **rates, births="rate", max_hypotheses=GAUSSIANS, resampling="heaviest")


Of = TypeVar("Of")


@dataclass(frozen=True)
class Method:
    """One way to track a camera.

    Attributes:
        label: Its name in tables and pictures.
        file: The file of its trajectory in a run's directory.
        color: Its colour in pictures, from Okabe and Ito's palette where possible.
        kind: Its input: each "image" by itself, "odometry" alone, or both, as a "baseline" or as "ours".
        short_label: A shorter name for narrow columns.
        error_curve: Whether it is in the picture of errors over time, which has room for few curves.
        tracker: Makes the `Tracker` of a method that goes from image to image.
    """

    label: str
    file: str
    color: str
    kind: Literal["image", "odometry", "baseline", "ours"] = "baseline"
    short_label: str = ""
    error_curve: bool = True
    tracker: Callable[[LocalizerConfig, np.random.Generator], Tracker] | None = None

    @property
    def can_converge(self) -> bool:
        """Whether it uses earlier images, so that it can converge."""
        return self.kind in ("baseline", "ours")


METHODS: Mapping[str, Method] = MappingProxyType(
    {
        "single_image": Method("single image", "single_image.tum", "#e69f00", "image"),
        "dead_reckoning": Method("dead reckoning", "dead_reckoning.tum", "#56b4e9", "odometry"),
        "kalman": Method("Kalman filter", "kalman.tum", "#cc79a7", short_label="Kalman", tracker=_kalman),
        "gaussian_sum": Method(
            "Gaussian sum",
            "gaussian_sum.tum",
            "#8c564b",
            short_label="Gauss.",
            error_curve=False,
            tracker=_gaussian_sum,
        ),
        "filter": Method("particle filter", "trajectory.tum", "#0072b2", "ours"),
        "smoothed": Method("smoothed", "smoothed.tum", "#009e73", "ours", error_curve=False),
        "fixed_lag": Method("fixed lag", "fixed_lag.tum", "#d55e00", "ours", error_curve=False),
    }
)
"""The methods by their names in results and code, in the order of a report.

The step loop itself gives the poses of the filter and of single images, and `vapor.tracking.hindsight` the smoothed
ones. Dead reckoning is computed where a first pose
is known: in the recorder of a run, or in a segment.
"""


FILES: Mapping[str, str] = MappingProxyType({name: method.file for name, method in METHODS.items()})
"""The file of a run's directory that holds each method's trajectory."""
BASELINES = tuple(name for name, method in METHODS.items() if method.tracker is not None)
"""Names of the methods that go from image to image beside the filter."""
BESIDE_RUNS = ("kalman",)
"""Those of every run. A Gaussian sum takes as long as the filter, and is as good where nobody carries the camera off:
benchmarks have it."""


def start_baselines(
    config: LocalizerConfig, rng: Callable[[], np.random.Generator], *, only: Collection[str] = BASELINES
) -> dict[str, Tracker]:
    """Trackers of the baselines named in `only`, each with its source of random draws."""
    return {name: method.tracker(config, rng()) for name, method in METHODS.items() if method.tracker and name in only}


def in_order(of_methods: Mapping[str, Of]) -> dict[str, Of]:
    """Items by the name of a method, in the order of the table; other names are left out."""
    return {name: of_methods[name] for name in METHODS if name in of_methods}
