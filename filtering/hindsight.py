"""What is kept of the filter's steps for a look back, and what a look back says of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int64

from filtering.estimate import Estimate, Mode, ModeConfig
from filtering.measurement_noise import PLACE, MeasurementNoise
from filtering.motion import GapMotion, Odometry
from filtering.observation import ONLY_CAMERA, Observation
from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from filtering.trajectory_search import squared_distances
from filtering.vertical import Vertical

_MOST_PLACES = 16  # of an image, the heaviest: enough for a place among many alike
_LEAST_WEIGHT = 1e-3  # of a filter's hypothesis that is remembered
_ABOUT_NS, _ABOUT_IMAGES = 500_000_000, 5  # what is about an image, to each side
_FAR = 10.0


@dataclass(frozen=True)
class FilterStep:
    """What the smoother keeps of a step of the filter: a few kilobytes.

    Attributes:
        posterior: Of the image, without samples, its heaviest places only.
        left_out: Weight of its other places.
        odometry: Motion since the image before; None where it is unknown.
        elapsed_s: Seconds since the image before.
        hypotheses: world_from_camera of the filter's heavy hypotheses, batch (p,).
        weights: Theirs, (p,).
        modes: The filter's, the heaviest two.
        odometry_scale_error: That the filter found.
        gap_motion: Where odometry was missing, as the filter took it.
        camera: Name of the camera; the posterior is of the frame that is localized.
        vertical: Gravity and height, where either was measured.
    """

    posterior: PosePosterior
    left_out: float
    odometry: Odometry | None
    elapsed_s: float
    hypotheses: Poses
    weights: Float64[np.ndarray, " p"]
    modes: tuple[Mode, ...]
    odometry_scale_error: float = 0.0
    gap_motion: GapMotion | None = None
    camera: str = ONLY_CAMERA
    vertical: Vertical | None = None

    @staticmethod
    def of(observation: Observation, estimate: Estimate) -> FilterStep:
        """Of an observation, and the filter's estimate after it."""
        posterior = observation.posterior
        if observation.views and observation.views[0].camera in estimate.left_out:
            posterior = posterior.without_places()
        kept = posterior.heaviest(_MOST_PLACES)
        weights = np.exp(estimate.log_weights)
        heavy = weights >= min(_LEAST_WEIGHT, weights.max())
        modes = sorted(estimate.modes, key=lambda mode: -mode.weight)[:2]
        return FilterStep(
            kept,
            float(posterior.weights.sum() - kept.weights.sum()),
            observation.odometry,
            observation.elapsed_s,
            estimate.particles[heavy],
            weights[heavy],
            tuple(modes),
            estimate.odometry_scale_error,
            estimate.gap_motion,
            observation.views[0].camera if observation.views else ONLY_CAMERA,
            observation.vertical,
        )


@dataclass(frozen=True)
class SmoothedTrajectory:
    """A trajectory in hindsight, n images.

    Attributes:
        poses: world_from_camera, batch (n,).
        covariance: Of the error ξ = (v, ω) of each, metres and radians, in the tangent at it, (n, 6, 6).
        probability: Of the place that each is in, (n,): the filter's weight of it after the last image before the
            camera was carried off next, or of all.
    """

    poses: Poses
    covariance: Float64[np.ndarray, "n 6 6"]
    probability: Float64[np.ndarray, " n"]


@dataclass(frozen=True)
class Hindsight:
    """What all n images say of a run.

    Attributes:
        best: The most probable trajectory.
        second: The second one, where the end is ambiguous, or the image before the camera was carried off; elsewhere it
            is the best one with a probability of 0. None where nothing is ambiguous.
        carried_off: Whether the camera was carried off before each image, or is in another sequence, (n,).
    """

    best: SmoothedTrajectory
    second: SmoothedTrajectory | None
    carried_off: Bool[np.ndarray, " n"]

    def is_ambiguous(self, modes: ModeConfig, noise: MeasurementNoise) -> Bool[np.ndarray, " n"]:
        """At which images both trajectories are at different places, (n,)."""
        if self.second is None:
            return np.zeros(len(self.best.poses), bool)
        squared = np.square(self.best.poses.between(self.second.poses).log() / modes.reach(noise, self.best.covariance))
        elsewhere = (squared[:, :3].sum(axis=1) > 1.0) | (squared[:, 3:].sum(axis=1) > 1.0)
        return elsewhere & (self.second.probability > 0.0)


def trajectory_agreement(
    trajectory: Poses, times_ns: Int64[np.ndarray, " n"], steps: Sequence[FilterStep], noise: MeasurementNoise
) -> Float64[np.ndarray, " n"]:
    """How well each pose of a trajectory fits the images about it, like the filter's agreement for a belief.

    A pose is as possible as the places near it (see `filtering.association`), here relative to the image's most
    possible place. This is averaged over the images within half a second, and five to each side at least. It is small
    where wrong odometry pulls a smoothed trajectory away from its images.

    Args:
        trajectory: world_from_camera, batch (n,).
        times_ns: Stamps, increasing, (n,).
        steps: Of the filter, n.
        noise: Noise of the images.

    Returns:
        From 0 to 1, (n,); 0 where no image about a pose is informative.
    """
    n = len(trajectory)
    fits, informative = np.zeros(n), np.array([not step.posterior.is_uninformative for step in steps], bool)
    in_map = _within_map(trajectory, [step.posterior for step in steps], noise)
    for i in np.flatnonzero(informative).tolist():
        posterior, rest = steps[i].posterior, steps[i].left_out
        near = np.exp(-0.5 * squared_distances(posterior, trajectory[i : i + 1])[0] / PLACE**2)
        sums = float(near @ posterior.weights) + in_map[i] * rest, float(posterior.weights.max()) + rest
        possible, most = (total / (total + noise.possible_fraction) for total in sums)
        fits[i] = min(possible / most, 1.0)
    at = np.arange(n)
    first = np.minimum(np.searchsorted(times_ns, times_ns - _ABOUT_NS), np.maximum(at - _ABOUT_IMAGES, 0))
    last = np.maximum(
        np.searchsorted(times_ns, times_ns + _ABOUT_NS, side="right"), np.minimum(at + _ABOUT_IMAGES + 1, n)
    )
    summed, count = (np.concatenate([[0.0], np.cumsum(values)]) for values in (fits, informative))
    return (summed[last] - summed[first]) / np.maximum(count[last] - count[first], 1.0)


def _within_map(
    trajectory: Poses, posteriors: Sequence[PosePosterior], noise: MeasurementNoise
) -> Bool[np.ndarray, " n"]:
    """Whether poses are near enough for a place beyond those given: within ten times the extent of all places."""
    positions = np.concatenate([np.zeros((0, 3)), *(each.means.translation for each in posteriors)])
    if len(positions) == 0:
        return np.zeros(len(trajectory), bool)
    middle = positions.mean(axis=0)
    furthest_m = np.linalg.norm(positions - middle, axis=1).max() + noise.map_size_m
    return np.linalg.norm(trajectory.translation - middle, axis=1) <= _FAR * furthest_m
