"""Walks whose images and odometry err exactly as the measurement noise says, or more, past copies of the true place."""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from filtering.adaptation import ErrorScale
from filtering.measurement_noise import MeasurementNoise
from filtering.motion import Odometry, OdometryBias
from filtering.novelty import NoveltyTracker
from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from tests.helpers.simulation import motion

ERRORS = MeasurementNoise(
    noise_floor=(0.1, 0.1, 0.1, 0.05, 0.05, 0.05),
    typical_std=(0.1, 0.1, 0.1, 0.05, 0.05, 0.05),
    degrees_of_freedom=1e6,
    constant_fraction=1e-9,
    outlier_probability=1e-3,
)
BIAS = OdometryBias(scale=0.03, relative_drift=1.0)
ODOMETRY_STD = np.array([0.004] * 3 + [0.002] * 3)


@dataclass(frozen=True)
class Walk:
    """True poses, odometry, posteriors, and the normalized distance of each image from the one before."""

    truth: Poses
    odometry: list[Odometry | None]
    posteriors: list[PosePosterior]
    distances: np.ndarray


def walk(num_images, *, rng, lifts=lambda i: (0.0,), noise=ERRORS, speed_m=0.05, unit=1.0):
    """A walk along a wavy line. `lifts` of an image: heights of equally possible places above the true one, metres.

    Lengths are in metres times `unit`; the same generator gives the same walk in any unit.
    """
    noise, lengths = noise.scaled(unit), np.array([unit] * 3 + [1.0] * 3)
    std = np.asarray(noise.noise_floor)
    scale, drift = BIAS.scale * rng.standard_normal(), rng.standard_normal(6)
    bias, tracker = rng.standard_normal(6), NoveltyTracker(noise.length_m, noise.length_rad)
    truth, odometry, posteriors, distances = [Poses.identity()], [None], [], [0.0]
    step_s = 0.1
    for i in range(num_images):
        if i:
            step = lengths * np.array([speed_m, 0, 0.2 * speed_m, 0, 0, 0.4 * speed_m * np.sin(i / 15)])
            kept = np.exp(-step_s / BIAS.time_s)
            drift = kept * drift + np.sqrt(1 - kept**2) * rng.standard_normal(6)
            odometry_std = lengths * ODOMETRY_STD
            wrong = BIAS.relative_drift * odometry_std * np.sqrt(step_s) * drift + odometry_std * rng.standard_normal(6)
            wrong[:3] += scale * step[:3]
            reported = Poses.exp(step) @ Poses.exp(wrong)
            truth.append(truth[-1] @ Poses.exp(step))
            odometry.append(Odometry(reported, np.diag(odometry_std**2), step_s))
            tracker, distance = tracker.predict(reported)
            distances.append(distance)
            bias = np.exp(-distance) * bias + np.sqrt(-np.expm1(-2 * distance)) * rng.standard_normal(6)
        fresh = rng.standard_normal(6)
        lasting = np.append(truth[-1].rotation.T @ bias[:3], bias[3:])  # positions err along the axes of the map
        error = std * (np.sqrt(noise.correlated_fraction) * lasting + np.sqrt(1 - noise.correlated_fraction) * fresh)
        seen = truth[-1] @ Poses.exp(error)
        heights = unit * np.asarray(lifts(i))
        lift = heights[:, None] * np.array([0.0, 0.0, 1.0])
        means = Poses(np.repeat(seen.rotation[None], len(heights), 0), seen.translation + lift)
        covariances = np.repeat(np.diag(std**2)[None], len(heights), 0)
        shares = np.full(len(heights), 1.0 / max(len(heights), 1))
        posteriors.append(PosePosterior(means, covariances, shares, noise, means))
    return Walk(Poses.stack(truth), odometry, posteriors, np.array(distances))


AHEAD = motion(0.5, 0, 0, 0, 0, 0)  # a length

APART = 2.0  # lengths between images that are compared

SPEED_M = 0.2  # an image: some fifty pairs of images two lengths apart


@cache
def simulated(seed, num_images=250, per_image=1):
    """A walk whose errors follow the model; `per_image` times the images a second."""
    return walk(num_images * per_image, rng=np.random.default_rng(seed), speed_m=SPEED_M / per_image)


def understated(path, factor):
    """The same walk, with posteriors whose variance is too small by this factor."""
    return replace(path, posteriors=[posterior.inflated(1.0 / factor) for posterior in path.posteriors])


def scale_along(path, scale=None):
    scale = scale or ErrorScale()
    for posterior, odometry, distance in zip(path.posteriors, path.odometry, path.distances, strict=True):
        scale = scale if odometry is None else scale.predict(odometry, distance)
        scale = scale.observe(posterior, distance)
    return scale


def shifted(posterior, offset):
    means = Poses(posterior.means.rotation, posterior.means.translation + offset)
    return replace(posterior, means=means, samples=means)


def observed(scale, posterior, distance=APART):
    return scale.observe(posterior, distance)
