"""The table of tracking methods: what each is called, where its trajectory is written, and how it is computed.

To add a baseline, write a class that fits `Tracker` in a file of its own in this folder, and add a row here. Runs,
reports, pictures, benchmarks and their tables then include it.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal, TypeVar

import numpy as np

from filtering.config import LocalizerConfig
from filtering.error_model import ErrorModel
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
        label: Its name in tables and pictures.
        file: Name of the file in a run's directory that holds its trajectory.
        color: Its colour in pictures, from Okabe and Ito's palette, safe for the colour-blind, as far as that goes.
        kind: What it uses: each "image" by itself, "odometry" alone, or both, as a "baseline" or as what is "ours".
        short_label: A shorter name for narrow columns, where the label is too long.
        error_curve: Whether it is drawn into the picture of errors over time, in which few curves can be told apart.
        tracker: Makes the `Tracker` of a method that goes from image to image beside the filter, from the filter's
            settings and a source of random draws.
        at_end: Computes the poses (n,) of a method that sees the whole run at once, from the run's history, how images
            err, and the filter's settings.
    """

    label: str
    file: str
    color: str
    kind: Literal["image", "odometry", "baseline", "ours"] = "baseline"
    short_label: str = ""
    error_curve: bool = True
    tracker: Callable[[LocalizerConfig, np.random.Generator], Tracker] | None = None
    at_end: Callable[[History, ErrorModel, LocalizerConfig], Poses] | None = None

    @property
    def can_converge(self) -> bool:
        """Whether it remembers what images said, and can find itself."""
        return self.kind in ("baseline", "ours")


METHODS: Mapping[str, Method] = MappingProxyType(
    {
        "single_image": Method("single image", "single_image.tum", "#e69f00", "image"),
        "dead_reckoning": Method("dead reckoning", "dead_reckoning.tum", "#56b4e9", "odometry"),
        "kalman": Method("Kalman filter", "kalman.tum", "#cc79a7", short_label="Kalman", tracker=KalmanTracker),
        "gaussian_sum": Method(
            "Gaussian sum",
            "gaussian_sum.tum",
            "#8c564b",
            short_label="Gauss.",
            error_curve=False,
            tracker=GaussianSumTracker,
        ),
        "filter": Method("particle filter", "trajectory.tum", "#0072b2", "ours"),
        "smoothed": Method("smoothed", "smoothed.tum", "#009e73", "ours", error_curve=False, at_end=smooth_history),
    }
)
"""The methods by their names in results and code, in the order of a report.

The step loop itself gives the poses of the filter and of single images. Dead reckoning is computed where a first pose
is known: in the recorder of a run, or in a passage.
"""

FILES: Mapping[str, str] = MappingProxyType({name: method.file for name, method in METHODS.items()})
"""The file of a run's directory that holds each method's trajectory."""

BASELINES = tuple(name for name, method in METHODS.items() if method.tracker is not None)
"""Names of the methods that go from image to image beside the filter."""


def start_baselines(
    config: LocalizerConfig, rng: Callable[[], np.random.Generator], *, only: Collection[str] = BASELINES
) -> dict[str, Tracker]:
    """Trackers of the baselines, by name.

    Args:
        config: Settings of the filter.
        rng: Gives each one its source of random draws.
        only: The names of those to start.
    """
    return {name: method.tracker(config, rng()) for name, method in METHODS.items() if method.tracker and name in only}


def poses_at_end(history: History, errors: ErrorModel, config: LocalizerConfig) -> dict[str, Poses]:
    """Poses (n,) of the methods that see a whole run of n images at once, by name.

    Args:
        history: The run.
        errors: How its images err.
        config: Settings of the filter.
    """
    return {name: method.at_end(history, errors, config) for name, method in METHODS.items() if method.at_end}


def in_order(of_methods: Mapping[str, Of]) -> dict[str, Of]:
    """Items by the name of a method, in the order of the table; other names are left out."""
    return {name: of_methods[name] for name in METHODS if name in of_methods}
