"""Rows of single-image pose estimates that others published, with simulated odometry."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from filtering.config import LocalizerConfig
from filtering.errors import VaporTrackError
from filtering.se3 import Poses
from sequences.estimates.options import EstimateOptions
from sequences.estimates.sequence import EstimateSequence
from sequences.odometry import OdometryNoise
from vapor.benchmark.real.row import Draw, RowContext
from vapor.pipeline.fuse import EstimateConfig, EstimateModel, errors_of, over_sequences
from vapor.tracking.passage import Passage


@dataclass(frozen=True)
class PoseEstimates:
    """Pose estimates of others, with simulated odometry.

    Attributes:
        name: Name of the row.
        group: Name of all rows with the same unit.
        files: Files of the data, one for each method.
        truth: File of the data with true poses.
        unit_m: So many metres are taken for one: all lengths are larger by this factor, those of noise too.
        simulated: Whether there are several draws of its odometry.
    """

    name: str
    group: str
    files: tuple[str, ...]
    truth: str
    unit_m: float = 1.0
    simulated: bool = True

    @property
    def needs(self) -> tuple[str, ...]:
        """Files and folders of the data that must be there."""
        return (*self.files, self.truth)

    def prepare(self, context: RowContext, seed: int) -> dict[str, Any]:
        """Nothing to make."""
        return {"files": self.needs, "unit_m": self.unit_m, "seed": seed, "trust": asdict(EstimateConfig())}

    def draw(self, context: RowContext, seed: int, config: LocalizerConfig) -> Draw:
        """The estimates with odometry simulated from the true poses, all lengths in the unit."""
        usual, noise = EstimateConfig(), OdometryNoise()
        trust = replace(usual, std_m=tuple(std_m * self.unit_m for std_m in usual.std_m))
        noise = replace(
            noise,
            translation_bias_m_per_s=noise.translation_bias_m_per_s * self.unit_m,
            translation_white_m_per_sqrt_s=noise.translation_white_m_per_sqrt_s * self.unit_m,
        )
        sequence = EstimateSequence(
            [context.data / file for file in self.files],
            simulate_odometry_from=context.data / self.truth,
            options=EstimateOptions(direction="world-to-camera", noise=noise, unit_m=self.unit_m),
            seed=seed,
        )
        errors = errors_of(sequence, trust)
        model = EstimateModel(len(self.files), trust, errors)
        frames = list(sequence)
        truth = [frame.world_from_camera for frame in frames if frame.world_from_camera is not None]
        if len(truth) < len(frames):
            raise VaporTrackError(
                f"{self.truth}: no true pose of {len(frames) - len(truth)} frames, expected one of all"
            )
        rng = np.random.default_rng(0)  # nothing is drawn from it
        return Draw(
            Passage(
                np.array([frame.time_ns for frame in frames], np.int64),
                tuple(frame.odometry for frame in frames),
                Poses.stack(truth),
                lambda image: model.observe(frames[image].estimates, rng=rng),
            ),
            errors,
            over_sequences(config),
            {"": np.ones(len(frames), bool)},
            self.unit_m,
        )
