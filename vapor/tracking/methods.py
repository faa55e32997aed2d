"""Every method over the same posteriors and odometry, and what each was worth: what all benchmarks of runs share."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Bool, Float64, Int64

from filtering.error_model import ErrorModel
from filtering.estimate import Mode, posterior_modes
from filtering.kalman import KalmanConfig, KalmanLocalizer
from filtering.localizer import LocalizerConfig
from filtering.motion import Odometry
from filtering.posterior import PosePosterior
from filtering.rivals import GaussianSumLocalizer
from filtering.se3 import Poses
from filtering.smoothing import SMOOTHED_MODES, SmoothingConfig, smooth
from sequences.frame import Trajectory
from sequences.odometry_fit.result import OdometryFit
from vapor.evaluation.belief import Belief, judge_belief, judge_floor, mode_status, truth_among_modes
from vapor.evaluation.lengths import scaled_mode, scaled_poses
from vapor.evaluation.trajectory import FILES, TRACKING, dead_reckoning, evaluate_trajectory
from vapor.tracking.ablations import VARIANTS, Variant


@dataclass(frozen=True)
class Passage:
    """What methods are given of n images, and the truth.

    Attributes:
        times_ns: Stamps, increasing, (n,).
        odometry: Camera motion since the image before, (n,); None where it is unknown. The first is not used.
        truth: True poses, world_from_camera, batch (n,).
        posterior: What an image says, by its number.
    """

    times_ns: Int64[np.ndarray, " n"]
    odometry: tuple[Odometry | None, ...]
    truth: Poses
    posterior: Callable[[int], PosePosterior]

    def restated(self, fit: OdometryFit | None) -> Passage:
        """The same with the white noise of the odometry as it was found to be; None: as it is."""
        if fit is None:
            return self
        return replace(self, odometry=tuple(None if each is None else fit.restated(each) for each in self.odometry))

    @cached_property
    def dead_reckoning(self) -> Poses:
        """Poses from odometry alone, from the true one on where there is no odometry, batch (n,)."""
        starts = [i for i, motion in enumerate(self.odometry) if i == 0 or motion is None]
        stretches = zip(starts, [*starts[1:], len(self.odometry)], strict=True)
        return Poses.concatenate([dead_reckoning(self.truth[a], self.odometry[a:b]) for a, b in stretches])


@dataclass(frozen=True)
class Comparison:
    """What every method made of a passage of n images.

    Attributes:
        times_ns: Stamps, (n,).
        truth: True poses, batch (n,).
        poses: Of every method by its name, those of `FILES`, world_from_camera, batches (n,).
        beliefs: Of Kalman filter, Gaussian sum and filter.
        image_modes: Places of each image's posterior alone, (n,).
        particles: Median number of particles of the filter.
        step_ms: Median milliseconds of a step of the filter.
        seam: First image after the camera was carried off; None where it was not.
    """

    times_ns: Int64[np.ndarray, " n"]
    truth: Poses
    poses: dict[str, Poses]
    beliefs: dict[str, Belief]
    image_modes: tuple[tuple[Mode, ...], ...]
    particles: int
    step_ms: float
    seam: int | None = None

    def figures(
        self, judged: Bool[np.ndarray, " n"] | None = None, *, floor_height_m: float | None = None
    ) -> dict[str, Any]:
        """What every method was worth, as JSON.

        Args:
            judged: Images to judge by, at least one; None for all.
            floor_height_m: From floor to floor, in the unit of the poses, where floors look alike.

        Returns:
            `images`, `methods` (see `evaluate_trajectory`), `belief` of Kalman filter, Gaussian sum and filter (see
            `judge_belief`), `image_truth_among_modes` (of the single images' posteriors), `particles` and `step_ms`.
            Where floors look alike, `methods` have `floor` (see `judge_floor`), and `belief` has `on_floor`.
        """
        every = np.ones(len(self.times_ns), bool)
        at = np.flatnonzero(every if judged is None else judged)
        times_ns, truth = self.times_ns[at], self.truth[at]
        # Whoever is carried off has no one moment from which on all is right.
        tracking = TRACKING if self.seam is None else ()
        methods = {
            name: evaluate_trajectory(
                Trajectory(times_ns, self.poses[name][at]), Trajectory(times_ns, truth), tracking=name in tracking
            )
            for name in FILES
        }
        if floor_height_m is not None:
            for name, each in methods.items():
                each["floor"] = judge_floor(self.poses[name][at], truth, floor_height_m)
        belief = {
            name: judge_belief(
                Belief([each.modes[i] for i in at.tolist()], [each.status[i] for i in at.tolist()]),
                times_ns,
                truth,
                converged_at_s=methods[name].get("converged_at_s"),
                seam=self.seam,
                floor_height_m=floor_height_m,
            )
            for name, each in self.beliefs.items()
        }
        return {
            "images": len(at),
            "methods": methods,
            "belief": belief,
            "image_truth_among_modes": truth_among_modes([self.image_modes[i] for i in at.tolist()], truth),
            "particles": self.particles,
            "step_ms": self.step_ms,
        }

    def scaled(self, factor: float) -> Comparison:
        """The same where all lengths are multiplied by a factor: judged in metres, or in another unit."""
        return replace(
            self,
            truth=scaled_poses(self.truth, factor),
            poses={name: scaled_poses(each, factor) for name, each in self.poses.items()},
            beliefs={name: belief.scaled(factor) for name, belief in self.beliefs.items()},
            image_modes=tuple(tuple(scaled_mode(mode, factor) for mode in modes) for modes in self.image_modes),
        )


@dataclass(frozen=True)
class Followed:
    """What filter and baselines made of a passage of n images, one image after the other.

    Attributes:
        passage: What they were given.
        errors: How its images err.
        config: Settings of the filter.
        beliefs: Of Kalman filter, Gaussian sum where it was asked for, and filter.
        image_modes: Places of each image's posterior alone, (n,).
        told_modes: Those that a smoother is told of, (n,): a few, and none of an image that says nothing.
        ways: How far the camera came since the image before, in lengths, (n,).
        particles: Median number of particles of the filter.
        step_ms: Median milliseconds of a step of the filter.
        seam: First image after the camera was carried off; None where it was not.
    """

    passage: Passage
    errors: ErrorModel
    config: LocalizerConfig
    beliefs: dict[str, Belief]
    image_modes: tuple[tuple[Mode, ...], ...]
    told_modes: tuple[tuple[Mode, ...], ...]
    ways: Float64[np.ndarray, " n"]
    particles: int
    step_ms: float
    seam: int | None

    @cached_property
    def poses(self) -> dict[str, Poses]:
        """Of every method but smoothing by its name, world_from_camera, batches (n,)."""
        return {
            "single_image": Poses.stack([modes[0].world_from_camera for modes in self.image_modes]),
            "dead_reckoning": self.passage.dead_reckoning,
            **{name: belief.best for name, belief in self.beliefs.items()},
        }

    def compared(self) -> Comparison:
        """With the methods beside them that see one image, none, or all at once."""
        filtered = self.beliefs["filter"]
        smoothed = smooth(
            self.told_modes,
            self.passage.odometry,
            self.ways,
            filtered.best,
            np.array([status == "converged" for status in filtered.status]),
            self.errors,
            SmoothingConfig(slow_errors=self.config.slow_errors),
        )
        poses = self.poses | {"smoothed": smoothed}
        times_ns, truth = self.passage.times_ns, self.passage.truth
        return Comparison(
            times_ns, truth, poses, self.beliefs, self.image_modes, self.particles, self.step_ms, self.seam
        )


def follow(
    passage: Passage,
    errors: ErrorModel,
    config: LocalizerConfig,
    *,
    rng: np.random.Generator,
    variant: Variant = VARIANTS["full"],
    seam: int | None = None,
    gaussian_sum: bool = True,
) -> Followed:
    """Localize a passage by filter and baselines, each with the same errors and the same odometry.

    Args:
        passage: Its first image has a place.
        errors: How its images err.
        config: Settings of the filter; its slow errors and gaps are those of all methods.
        rng: Of the filters' draws.
        variant: What is different about the filter. How images err is the same to all methods, and changed by the
            caller.
        seam: First image after the camera was carried off; None where it was not.
        gaussian_sum: Whether to run that one, too; it takes as long as the filter.

    Raises:
        VaporTrackError: unusable odometry or posteriors.
    """
    localizer = variant.kind(None, config, rng=rng)
    following = KalmanConfig(slow_errors=config.slow_errors, gap=config.gap)
    kalman, bank = KalmanLocalizer(following), GaussianSumLocalizer(None, config, rng=rng)
    found: dict[str, list[tuple[Mode, ...]]] = {"kalman": []} | ({"gaussian_sum": []} if gaussian_sum else {})
    image_modes, told_modes, estimates, step_ms = [], [], [], []
    elapsed_s = np.maximum(np.diff(passage.times_ns, prepend=passage.times_ns[:1]), 0) * 1e-9
    for i, (odometry, elapsed) in enumerate(zip(passage.odometry, elapsed_s.tolist(), strict=True)):
        told = variant.told_of_kidnap and i == seam
        begin = time.perf_counter()
        posterior = passage.posterior(i)
        if told:
            localizer = variant.kind(None, config, rng=rng)
        estimates.append(localizer.update(posterior, None if told else odometry, elapsed_s=elapsed))
        step_ms.append(1e3 * (time.perf_counter() - begin))
        alone = posterior_modes(posterior)
        told_modes.append(() if posterior.says_nothing else alone[:SMOOTHED_MODES])
        image_modes.append(alone or (image_modes[-1] if image_modes else estimates[-1].modes))
        found["kalman"].append((kalman.update(posterior, odometry, elapsed_s=elapsed),))
        if gaussian_sum:
            found["gaussian_sum"].append(bank.update(posterior, odometry, elapsed_s=elapsed).modes)
    widest = config.widest_std_m(errors)
    beliefs = {
        name: Belief(modes, [mode_status(each[0], widest, config.converged_weight) for each in modes])
        for name, modes in found.items()
    }
    beliefs["filter"] = Belief([each.modes for each in estimates], [each.status for each in estimates])
    return Followed(
        passage,
        errors,
        config,
        beliefs,
        tuple(image_modes),
        tuple(told_modes),
        np.array([each.way for each in estimates]),
        int(np.median([len(each.particles) for each in estimates])),
        float(np.median(step_ms)),
        seam,
    )


def posterior_of(samples: Poses, errors: ErrorModel, unfamiliarity: float) -> PosePosterior:
    """Of an image; without samples one that says nothing, as `ParticleLocalizer.observe` has of a frozen camera."""
    if len(samples):
        return PosePosterior.from_samples(samples, errors, unfamiliarity=unfamiliarity)
    return replace(PosePosterior.nothing(errors), unfamiliarity=unfamiliarity)
