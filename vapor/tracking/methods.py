"""The table of tracking methods: what each is called, where its trajectory lies, and how it comes about.

To add a baseline: a class as `Tracker` asks for, in a file of its own in this folder, and a row here. Runs, reports,
pictures, benchmarks and their tables then have it.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal, TypeVar

import numpy as np

from filtering.error_model import ErrorModel
from filtering.localizer import LocalizerConfig
from filtering.se3 import Poses
from vapor.tracking.baselines import GaussianSumTracker, KalmanTracker
from vapor.tracking.history import History
from vapor.tracking.loop import Tracker
from vapor.tracking.smoothing import smooth_history

Of = TypeVar("Of")


@dataclass(frozen=True)
class Method:
    """One way to track a camera.

    Attributes:
        label: What it is called where a person reads.
        file: In a run's directory, of its trajectory.
        color: In pictures and viewer: of Okabe and Ito's palette, safe for the colour-blind, as far as that reaches.
        kind: Whether it takes each image by itself, or odometry alone, or both as a baseline or as what is ours.
        short_label: The label where there is little room, if another is needed.
        error_curve: Whether the picture of errors over time shows it: few curves can be told apart.
        begin: For a baseline: makes its tracker, by the filter's settings and with a source of draws.
        finish: For a method that sees the whole run at once: makes its poses (n,) of the run's history, of how images
            err and of the filter's settings.
    """

    label: str
    file: str
    color: str
    kind: Literal["image", "odometry", "baseline", "ours"] = "baseline"
    short_label: str = ""
    error_curve: bool = True
    begin: Callable[[LocalizerConfig, np.random.Generator], Tracker] | None = None
    finish: Callable[[History, ErrorModel, LocalizerConfig], Poses] | None = None

    @property
    def can_converge(self) -> bool:
        """Whether it remembers what images said, and can find itself."""
        return self.kind in ("baseline", "ours")


METHODS: Mapping[str, Method] = MappingProxyType(
    {
        "single_image": Method("single image", "single_image.tum", "#e69f00", "image"),
        "dead_reckoning": Method("dead reckoning", "dead_reckoning.tum", "#56b4e9", "odometry"),
        "kalman": Method("Kalman filter", "kalman.tum", "#cc79a7", short_label="Kalman", begin=KalmanTracker),
        "gaussian_sum": Method(
            "Gaussian sum",
            "gaussian_sum.tum",
            "#8c564b",
            short_label="Gauss.",
            error_curve=False,
            begin=GaussianSumTracker,
        ),
        "filter": Method("particle filter", "trajectory.tum", "#0072b2", "ours"),
        "smoothed": Method("smoothed", "smoothed.tum", "#009e73", "ours", error_curve=False, finish=smooth_history),
    }
)
"""By the name that reports, results and code have for them, in the order of a report.

The loop itself makes the filter's poses and those of single images; dead reckoning needs a true pose to start from.
"""

FILES: Mapping[str, str] = MappingProxyType({name: method.file for name, method in METHODS.items()})
"""The file of a run's directory that holds each method's trajectory."""

BASELINES = tuple(name for name, method in METHODS.items() if method.begin is not None)
"""Methods that step beside the filter."""


def start_baselines(
    config: LocalizerConfig, rng: Callable[[], np.random.Generator], *, only: Collection[str] = BASELINES
) -> dict[str, Tracker]:
    """Trackers of the baselines, by name.

    Args:
        config: Settings of the filter.
        rng: Gives each one its source of draws.
        only: Names of those to start.
    """
    return {name: method.begin(config, rng()) for name, method in METHODS.items() if method.begin and name in only}


def finish(history: History, errors: ErrorModel, config: LocalizerConfig) -> dict[str, Poses]:
    """Poses (n,) by the methods that see a whole run of n images at once, by name.

    Args:
        history: Of the run.
        errors: How its images err.
        config: Settings of the filter.
    """
    return {name: method.finish(history, errors, config) for name, method in METHODS.items() if method.finish}


def in_order(of_methods: Mapping[str, Of]) -> dict[str, Of]:
    """What is given by the name of a method, in the order of the table."""
    return {name: of_methods[name] for name in METHODS if name in of_methods}
