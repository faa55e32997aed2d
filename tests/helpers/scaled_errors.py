"""Walks whose images err more or less than their posteriors say, and the scale that is found of it."""

from dataclasses import replace
from functools import cache

import numpy as np

from filtering.adaptation import ErrorScale
from filtering.se3 import Poses
from tests.helpers.modelled_walk import walk
from tests.helpers.simulation import motion

AHEAD = motion(0.5, 0, 0, 0, 0, 0)  # a length

APART = 2.0  # lengths between images that are compared

SPEED_M = 0.2  # an image: some fifty pairs of images two lengths apart


@cache
def simulated(seed, num_images=250, per_image=1):
    """A walk whose errors follow the model; `per_image` times the images a second."""
    return walk(num_images * per_image, rng=np.random.default_rng(seed), speed_m=SPEED_M / per_image)


def understated(path, factor):
    """The same walk, the variance of the errors `factor` times what the posteriors say."""
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
