"""Particle filters on walks whose images err as the model says."""

import numpy as np

from filtering.config import LocalizerConfig
from filtering.localizer import ParticleLocalizer
from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from tests.helpers.simulation import ERRORS, image_errors, lifted, motion, seen_at

RNG = np.random.default_rng

STAY = motion(0, 0, 0, 0, 0, 0)

AHEAD = motion(0.1, 0, 0, 0, 0, 0.02)

FOREIGN = PosePosterior(Poses.identity(0), np.zeros((0, 6, 6)), np.zeros(0), ERRORS, Poses.identity(0), 3.0)


def new_localizer(seed=0, **settings):
    return ParticleLocalizer(None, LocalizerConfig(**settings), rng=RNG(seed))


def assert_same_belief(one, other, **tolerance):
    np.testing.assert_allclose(one.particles.as_matrix(), other.particles.as_matrix(), **tolerance)
    np.testing.assert_allclose(one.covariances, other.covariances, **tolerance)
    np.testing.assert_allclose(one.log_weights, other.log_weights, **tolerance)


def weight_near(estimate, position, within=1.0):
    near = np.linalg.norm(estimate.particles.translation - np.asarray(position), axis=1) < within
    return float(np.exp(estimate.log_weights)[near].sum())


def walk(localizer, count, *, shares=(1.0,), heights_m=(0.0,), pose=None, seed=0, errors=ERRORS, step=AHEAD):
    """Estimates along a walk whose images err as the model says, and the true pose at its end."""
    rng = RNG(seed)
    pose = Poses.identity() if pose is None else pose
    distance = float(np.hypot(*(np.linalg.norm(part) for part in np.split(step.previous_from_current.log(), 2)))) / 0.45
    estimates = []
    for error in image_errors([distance] * (count - 1), errors, rng=rng):
        pose = pose @ step.previous_from_current
        seen = lifted(pose @ Poses.exp(error), heights_m)
        estimates.append(localizer.update(seen_at(seen, shares, errors=errors), step))
    return estimates, pose
