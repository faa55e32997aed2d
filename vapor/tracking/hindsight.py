"""The smoothed trajectory as a method beside the filter: what it says of each image of a run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float64, Int64

from filtering.config import LocalizerConfig
from filtering.estimate import Mode, Status
from filtering.hindsight import FilterStep, Hindsight, SmoothedTrajectory, trajectory_agreement
from filtering.measurement_noise import MeasurementNoise
from filtering.se3 import Poses
from vapor.tracking.loop import Belief

if TYPE_CHECKING:
    from filtering.fixed_lag import FixedLagSmoother

LAG_S = 2.0
"""Lag of the benchmarks' fixed-lag trajectory, seconds."""


@dataclass(frozen=True)
class LookBack:
    """A run of n images in hindsight.

    Attributes:
        trajectories: By the name of the method.
        second: The second trajectory, see `Hindsight`.
        carried_off: Whether the camera was carried off before each image, (n,).
        agreement: How well the images about each smoothed pose fit it, in [0, 1], (n,).
        ambiguous: Where the two trajectories are at different places, (n,).
    """

    trajectories: Mapping[str, SmoothedTrajectory]
    second: SmoothedTrajectory | None
    carried_off: Bool[np.ndarray, " n"]
    agreement: Float64[np.ndarray, " n"]
    ambiguous: Bool[np.ndarray, " n"]

    @staticmethod
    def on(
        steps: Sequence[FilterStep],
        times_ns: Int64[np.ndarray, " n"],
        noise: MeasurementNoise,
        config: LocalizerConfig,
        lag_s: float = 0.0,
    ) -> LookBack:
        """Of the steps of the filter, n ≥ 1, with their stamps; with a lag also the fixed-lag trajectory."""
        hindsight = hindsight_of(steps, noise, config)
        trajectories = {"smoothed": hindsight.best}
        if lag_s > 0.0:
            trajectories["fixed_lag"] = lagged_of(steps, noise, config, lag_s)
        agreement = trajectory_agreement(hindsight.best.poses, times_ns, steps, noise)
        ambiguous = hindsight.is_ambiguous(config.modes, noise)
        return LookBack(trajectories, hindsight.second, hindsight.carried_off, agreement, ambiguous)


def hindsight_of(steps: Sequence[FilterStep], noise: MeasurementNoise, config: LocalizerConfig) -> Hindsight:
    """A run in hindsight, by the settings that the smoother has in common with the filter."""
    from filtering.smoothing import SmoothingConfig, smooth  # loads GTSAM, which takes a while

    return smooth(steps, noise, SmoothingConfig.of_filter(config))


def lagged_of(
    steps: Sequence[FilterStep], noise: MeasurementNoise, config: LocalizerConfig, lag_s: float
) -> SmoothedTrajectory:
    """The pose of each image of a run by the images until a lag later."""
    smoother = fixed_lag_smoother(noise, config, lag_s)
    found = [pose for step in steps for pose in smoother.update(step)] + smoother.finish()
    return SmoothedTrajectory(
        Poses.stack([each.world_from_camera for each in found]),
        np.stack([each.covariance for each in found]),
        np.array([each.weight for each in found]),
    )


def fixed_lag_smoother(noise: MeasurementNoise, config: LocalizerConfig, lag_s: float) -> FixedLagSmoother:
    """A fixed-lag smoother by the settings that it has in common with the filter."""
    from filtering.fixed_lag import FixedLagSmoother  # loads GTSAM, which takes a while
    from filtering.smoothing import SmoothingConfig

    return FixedLagSmoother(lag_s, noise, SmoothingConfig.of_filter(config), config.modes)


def smoothed_belief(
    hindsight: Hindsight,
    steps: Sequence[FilterStep],
    times_ns: Int64[np.ndarray, " n"],
    noise: MeasurementNoise,
    config: LocalizerConfig,
) -> Belief:
    """The belief about each image in hindsight, with the status that the same belief of the filter would have.

    Args:
        hindsight: Of n images.
        steps: Of the filter, n.
        times_ns: Stamps, (n,).
        noise: Noise of the images.
        config: Settings of the filter.
    """
    agreement = trajectory_agreement(hindsight.best.poses, times_ns, steps, noise)
    ambiguous = hindsight.is_ambiguous(config.modes, noise)
    widest_m, modes, status = config.widest_std_m(noise), [], []
    for i, (fits, undecided) in enumerate(zip(agreement.tolist(), ambiguous.tolist(), strict=True)):
        of_image = [_mode(hindsight.best, i)]
        if undecided and hindsight.second is not None:
            of_image.append(_mode(hindsight.second, i))
        modes.append(tuple(of_image))
        status.append(_status(of_image[0], fits, widest_m, config))
    return Belief(modes, status)


def _mode(trajectory: SmoothedTrajectory, image: int) -> Mode:
    return Mode(trajectory.poses[image], trajectory.covariance[image], float(trajectory.probability[image]))


def _status(best: Mode, agreement: float, widest_m: float, config: LocalizerConfig) -> Status:
    if agreement < config.lost_agreement:
        return "lost"
    sure = best.weight >= config.converged_weight and best.widest_std_m <= widest_m
    return "converged" if sure and agreement >= config.converged_agreement else "ambiguous"
