"""Posteriors with given errors, and the fit of these errors."""

from functools import cache

import numpy as np

from filtering.measurement_noise import MeasurementNoise
from filtering.se3 import Poses
from vapor.calibration.error_correlation import Travel
from vapor.calibration.image_errors import fit_errors
from vapor.calibration.places import Observations
from vapor.checkpoints.scene_scale import default_errors

ROOM = np.array([10.0, 6.0, 2.0])
TRUE = MeasurementNoise(
    spread=2.0, noise_floor=(0.05, 0.1, 0.03, 0.02, 0.03, 0.02), degrees_of_freedom=5.0, outlier_probability=0.1
)
UNIT = np.repeat([1.0, 0.5], 3)


def anywhere(count: int, *, rng: np.random.Generator) -> Poses:
    turned = rng.uniform(-1, 1, (count, 6)) * [0, 0, 0, 0.3, 0.3, 3.0]
    return Poses(Poses.exp(turned).rotation, rng.uniform(0, 1, (count, 3)) * ROOM)


def apart(count: int) -> Travel:
    """Travel between images that are from a pass each."""
    return Travel(np.arange(count), np.zeros(count), np.zeros(count))


def posteriors(
    truth: Poses, noise: MeasurementNoise, normal: np.ndarray, *, rng: np.random.Generator, num_samples: int = 80
):
    """Samples of images whose places have these errors (n, 6), in standard deviations."""
    samples = []
    for i, own in enumerate(normal):
        spread = 0.06 * UNIT * np.exp(rng.normal(0.0, 0.8))  # of the samples
        xi = np.sqrt(noise.spread * np.square(spread) + np.square(noise.noise_floor)) * own
        centre = anywhere(1, rng=rng)[0] if rng.random() < noise.outlier_probability else truth[i] @ Poses.exp(-xi)
        samples.append(centre @ Poses.exp(spread * rng.standard_normal((num_samples, 6))))
    return samples


def student(count: int, degrees_of_freedom: float, *, rng: np.random.Generator) -> np.ndarray:
    return rng.standard_normal((count, 6)) * np.sqrt(degrees_of_freedom / rng.chisquare(degrees_of_freedom, (count, 1)))


@cache
def simulated(count: int = 400):
    rng = np.random.default_rng(0)
    truth = anywhere(count, rng=rng)
    return posteriors(truth, TRUE, student(count, TRUE.degrees_of_freedom, rng=rng), rng=rng), truth


def fit(samples, truth, travel=None, before=None, *, score=None, trained=None):
    before = before or default_errors(truth)
    return fit_errors(Observations(samples, truth, score), travel or apart(len(truth)), truth, before, trained=trained)


@cache
def fitted(count: int = 400):
    return fit(*simulated(count))


def walk(count: int, step_m: float, *, rng: np.random.Generator) -> Poses:
    x = np.arange(count) * step_m
    side = np.cumsum(rng.normal(0, 0.01, (count, 2)), axis=0)
    return Poses(np.tile(np.eye(3), (count, 1, 1)), np.column_stack([x, side]))
