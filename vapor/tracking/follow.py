"""The filter and its baselines over a sequence with known posteriors and true poses."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Int64

from filtering.config import LocalizerConfig
from filtering.estimate import Estimate, Mode
from filtering.hindsight import FilterStep, Hindsight
from filtering.measurement_noise import MeasurementNoise
from filtering.motion import Odometry
from filtering.observation import Observation
from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from filtering.training_prior import TrainingPrior
from sequences.odometry_fit.result import OdometryFit
from vapor.tracking.ablations import ABLATIONS, Ablation
from vapor.tracking.hindsight import LAG_S, hindsight_of, lagged_of, smoothed_belief
from vapor.tracking.loop import Belief, StepLoop, elapsed_s, mode_status
from vapor.tracking.methods import BASELINES, start_baselines


def dead_reckoning(first_pose: Poses, odometry: Sequence[Odometry | None]) -> Poses:
    """Poses (n,) from odometry alone.

    Args:
        first_pose: world_from_camera of the first image, one pose.
        odometry: Motion since the previous image, (n,), n ≥ 1; the first is not used. At None the pose stays.
    """
    poses = [first_pose]
    for motion in odometry[1:]:
        poses.append(poses[-1] if motion is None else poses[-1] @ motion.previous_from_current)
    return Poses.stack(poses)


@dataclass(frozen=True)
class Segment:
    """The input of the methods for n images, and the truth.

    Attributes:
        times_ns: Stamps, increasing.
        odometry: Camera motion since the image before; None where unknown. The first is not used.
        truth: True poses, world_from_camera, (n,).
        posterior: Gives the posterior of an image, by its number.
    """

    times_ns: Int64[np.ndarray, " n"]
    odometry: tuple[Odometry | None, ...]
    truth: Poses
    posterior: Callable[[int], PosePosterior]

    def restated(self, fit: OdometryFit | None) -> Segment:
        """The segment with the fitted white noise of the odometry; with None, as it is."""
        if fit is None:
            return self
        return replace(self, odometry=tuple(None if each is None else fit.restated(each) for each in self.odometry))

    def part(self, start: int, stop: int) -> Segment:
        """The images start to stop as a segment."""
        return Segment(
            self.times_ns[start:stop],
            self.odometry[start:stop],
            self.truth[start:stop],
            lambda image: self.posterior(start + image),
        )

    @cached_property
    def dead_reckoning(self) -> Poses:
        """Poses from odometry alone, (n,); wherever odometry is missing they restart at the true pose."""
        starts = [i for i, motion in enumerate(self.odometry) if i == 0 or motion is None]
        segments = zip(starts, [*starts[1:], len(self.odometry)], strict=True)
        return Poses.concatenate([dead_reckoning(self.truth[a], self.odometry[a:b]) for a, b in segments])


def posterior_of(
    samples: Poses, noise: MeasurementNoise, ood_score: float, prior: TrainingPrior | None
) -> PosePosterior:
    """The posterior of an image by its samples; without any, an uninformative one, see `ParticleLocalizer.observe`."""
    if len(samples):
        return PosePosterior.from_samples(samples, noise, ood_score=ood_score, prior=prior)
    return replace(PosePosterior.uninformative(noise), ood_score=ood_score)


@dataclass(frozen=True)
class Followed:
    """The results of filter and baselines on a segment of n images.

    `image_modes` are the places of each image's posterior alone. The number of particles and the milliseconds of a step
    are medians.
    """

    segment: Segment
    noise: MeasurementNoise
    config: LocalizerConfig
    beliefs: dict[str, Belief]
    image_modes: tuple[tuple[Mode, ...], ...]
    steps: tuple[FilterStep, ...]
    particles: int
    step_ms: float
    kidnap_index: int | None

    @cached_property
    def poses(self) -> dict[str, Poses]:
        """Poses of every method that goes from image to image, by name, world_from_camera, (n,) each."""
        return {
            "single_image": Poses.stack([modes[0].world_from_camera for modes in self.image_modes]),
            "dead_reckoning": self.segment.dead_reckoning,
            **{name: belief.best for name, belief in self.beliefs.items()},
        }

    @cached_property
    def hindsight(self) -> Hindsight:
        """The whole segment in hindsight."""
        return hindsight_of(self.steps, self.noise, self.config)

    @cached_property
    def fixed_lag(self) -> Poses:
        """Poses of each image by the images until two seconds later, world_from_camera, (n,)."""
        return lagged_of(self.steps, self.noise, self.config, LAG_S).poses

    @cached_property
    def smoothed(self) -> Belief:
        """The belief about each image in hindsight."""
        return smoothed_belief(self.hindsight, self.steps, self.segment.times_ns, self.noise, self.config)


def follow(
    segment: Segment,
    noise: MeasurementNoise,
    config: LocalizerConfig,
    *,
    rng: np.random.Generator,
    ablation: Ablation = ABLATIONS["full"],
    kidnap_index: int | None = None,
    baselines: Collection[str] = BASELINES,
) -> Followed:
    """Localize a segment, whose first image has a place, by filter and baselines with the same errors and odometry.

    The ablation starts the filter; its changes of `noise` and `config` are already made, as they concern all methods.

    Raises:
        VaporTrackError: unusable odometry or posteriors.
    """
    localizer = ablation.start(config, rng=rng, kidnap_index=kidnap_index)
    loop = StepLoop(localizer, start_baselines(config, lambda: rng, only=baselines))
    steps: list[FilterStep] = []
    estimates: list[Estimate] = []
    image_modes: list[tuple[Mode, ...]] = []
    of_baselines: dict[str, list[tuple[Mode, ...]]] = {}
    step_ms: list[float] = []
    times_ns = segment.times_ns.tolist()
    for i, (before_ns, time_ns, odometry) in enumerate(
        zip([None, *times_ns[:-1]], times_ns, segment.odometry, strict=True)
    ):
        begin = time.perf_counter()
        observation = Observation.of_posterior(segment.posterior(i), odometry, elapsed_s(before_ns, time_ns))
        step = loop.step(observation, observe_ms=1e3 * (time.perf_counter() - begin))
        steps.append(FilterStep.of(observation, step.estimate))
        estimates.append(step.estimate)
        image_modes.append(step.image_modes)
        for name, modes in step.baselines.items():
            of_baselines.setdefault(name, []).append(modes)
        step_ms.append(step.step_ms)
    widest_m = config.widest_std_m(noise)
    beliefs = {
        name: Belief(modes, [mode_status(each[0], widest_m, config.converged_weight) for each in modes])
        for name, modes in of_baselines.items()
    }
    beliefs["filter"] = Belief([each.modes for each in estimates], [each.status for each in estimates])
    return Followed(
        segment,
        noise,
        config,
        beliefs,
        tuple(image_modes),
        tuple(steps),
        int(np.median([len(each.particles) for each in estimates])),
        float(np.median(step_ms)),
        kidnap_index,
    )
