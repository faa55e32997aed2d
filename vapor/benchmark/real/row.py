"""Input and output of the rows of `vapor-benchmark real`."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool

from filtering.config import LocalizerConfig
from filtering.errors import require_within
from filtering.measurement_noise import MeasurementNoise
from filtering.motion import MotionNoise, Odometry
from filtering.se3 import Poses
from sequences.estimates.sequence import OdometryTrack
from sequences.frame import BASE_FROM_CAMERA
from sequences.odometry import OdometryNoise, simulate_odometry
from vapor.checkpoints.checkpoint import Checkpoint
from vapor.engines.engine import EngineConfig
from vapor.tracking.follow import Segment


@dataclass(frozen=True)
class RealConfig(EngineConfig):
    """Settings of a benchmark on real recordings."""

    seeds: int = 3
    """Draws of simulated odometry; recorded odometry has one."""
    num_samples: int = 1000
    """Posterior samples per image."""
    localizer: LocalizerConfig = field(default_factory=LocalizerConfig)
    """The particle filter."""

    def __post_init__(self) -> None:
        require_within(self, seeds=(1, 10**6), num_samples=(1, 10**6))


@dataclass(frozen=True)
class RowContext:
    """Where a row finds its data and stores its results.

    Attributes:
        data: Folder with the recordings of others.
        output: Folder for models, sequences, recordings and results.
    """

    data: Path
    output: Path
    config: RealConfig = field(default_factory=RealConfig)

    def folder(self, name: str) -> Path:
        """A folder in the output, made if absent."""
        folder = self.output / name
        folder.mkdir(parents=True, exist_ok=True)
        return folder


@dataclass(frozen=True)
class Draw:
    """One draw of a row, ready to be localized.

    Attributes:
        segment: n images.
        noise: How they err.
        localizer: Settings of the filter.
        evaluated: Which images are evaluated, (n,), by a name for them; the empty name is the row itself.
        unit_m: Lengths are evaluated in units of so many metres.
        in_sequences: Whether short sequences of it are localized too, each from the beginning.
    """

    segment: Segment
    noise: MeasurementNoise
    localizer: LocalizerConfig
    evaluated: Mapping[str, Bool[np.ndarray, " n"]]
    unit_m: float = 1.0
    in_sequences: bool = True

    def with_model(self, checkpoint: Checkpoint) -> Draw:
        """The draw with the odometry's noise and bias as a model has them fitted."""
        fit = checkpoint.calibration.odometry
        if fit is None:
            return self
        localizer = replace(self.localizer, odometry_bias=fit.odometry_bias)
        return replace(self, segment=self.segment.restated(fit), localizer=localizer)


def simulated_motions(times_ns: np.ndarray, truth: Poses, *, rng: np.random.Generator) -> tuple[Odometry, ...]:
    """Motion of a camera since the previous image, (n,), as a reader finds it in a sequence that `convert` wrote.

    Args:
        times_ns: Stamps of the images, strictly increasing, (n,).
        truth: world_from_camera, batch (n,).
        rng: For the errors of the odometry.
    """
    odom_from_base, twists = simulate_odometry(times_ns, truth @ BASE_FROM_CAMERA.inverse(), OdometryNoise(), rng=rng)
    track, stamps = OdometryTrack(times_ns, odom_from_base, twists), times_ns.tolist()
    return tuple(track.between(before, now, MotionNoise()) for before, now in pairwise([stamps[0], *stamps]))


@dataclass(frozen=True)
class Row(ABC):
    """A recording made by others that methods are evaluated on."""

    name: str

    @property
    def group(self) -> str:
        """Rows of a group differ in one thing only; most have a group of their own."""
        return self.name

    @property
    def simulated(self) -> bool:
        """Whether odometry is drawn, so that there are several draws."""
        return True

    @property
    @abstractmethod
    def needs(self) -> tuple[str, ...]:
        """Files and folders of the data that must be there."""

    @abstractmethod
    def prepare(self, context: RowContext, seed: int) -> dict[str, Any]:
        """Make the input of a draw unless it is there; returns all that the result depends on besides code, as JSON."""

    @abstractmethod
    def draw(self, context: RowContext, seed: int) -> Draw:
        """A draw, once its input is there."""
