"""The smoothed trajectory as a method beside the filter: what it says of each image of a run."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float64, Int64

from filtering.config import LocalizerConfig
from filtering.estimate import Mode, Status
from filtering.hindsight import FilterStep, Hindsight, SmoothedTrajectory, trajectory_agreement
from filtering.measurement_noise import MeasurementNoise
from vapor.tracking.loop import Belief


def hindsight_of(steps: Sequence[FilterStep], noise: MeasurementNoise, config: LocalizerConfig) -> Hindsight:
    """A run in hindsight, by the settings that the smoother has in common with the filter."""
    from filtering.smoothing import SmoothingConfig, smooth  # loads GTSAM, which takes a while

    return smooth(steps, noise, SmoothingConfig.of_filter(config))


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
        else:
            of_image = [Mode(of_image[0].world_from_camera, of_image[0].covariance, 1.0)]
        modes.append(tuple(of_image))
        status.append(_status(of_image[0], fits, widest_m, config))
    return Belief(modes, status)


def _mode(trajectory: SmoothedTrajectory, image: int) -> Mode:
    return Mode(trajectory.poses[image], trajectory.covariance[image], trajectory.probability)


def _status(best: Mode, agreement: float, widest_m: float, config: LocalizerConfig) -> Status:
    if agreement < config.lost_agreement:
        return "lost"
    sure = best.weight >= config.converged_weight and best.widest_std_m <= widest_m
    return "converged" if sure and agreement >= config.converged_agreement else "ambiguous"
