"""Filters beside the particle filter, on the same models."""

from dataclasses import replace

import numpy as np
import pytest

from filtering.births import augmented_mcl
from filtering.config import LocalizerConfig
from filtering.localizer import ParticleLocalizer
from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from tests.helpers.modelled_walk import BIAS, walk
from vapor.tracking.methods import GAUSSIANS, gaussian_sum

CONFIG = LocalizerConfig(odometry_bias=BIAS)
GAUSSIAN_SUM, AUGMENTED = gaussian_sum(CONFIG), replace(CONFIG, births="augmented-mcl")
FLOORS = (-6.0, -3.0, 0.0, 3.0, 6.0)


def follow(config, posteriors, odometry):
    localizer = ParticleLocalizer(None, config, rng=np.random.default_rng(0))
    return [localizer.update(seen, motion) for seen, motion in zip(posteriors, odometry, strict=True)]


def error_m(estimates, truth):
    return Poses.stack([estimate.modes[0].world_from_camera for estimate in estimates]).distance(truth)[0]


def carried_off(path, metres, start):
    """The posteriors of a camera that is carried up unnoticed."""
    up = np.array([0.0, 0.0, metres])

    def lifted(posterior):
        means = Poses(posterior.means.rotation, posterior.means.translation + up)
        return replace(posterior, means=means, samples=means)

    return [lifted(p) if i >= start else p for i, p in enumerate(path.posteriors)]


def test_a_gaussian_sum_keeps_all_places_of_the_first_image_until_one_is_told_from_the_others():
    path = walk(80, rng=np.random.default_rng(0), lifts=lambda i: (0.0,) if i >= 40 else FLOORS)
    estimates = follow(GAUSSIAN_SUM, path.posteriors, path.odometry)
    assert len(estimates[30].modes) == 5
    assert (error_m(estimates, path.truth)[70:] < 0.4).all()
    assert estimates[-1].status == "converged"


def test_a_gaussian_sum_has_no_more_than_its_number_and_keeps_the_heaviest():
    heights = tuple(3.0 * k for k in range(25))
    path = walk(20, rng=np.random.default_rng(1), lifts=lambda i: heights)
    fractions = np.arange(1.0, 26.0) / np.arange(1.0, 26.0).sum()
    first = replace(path.posteriors[0], weights=fractions)
    estimates = follow(GAUSSIAN_SUM, [first, *path.posteriors[1:]], path.odometry)
    assert all(len(estimate.particles) <= GAUSSIANS for estimate in estimates)
    assert estimates[0].particles.translation[:, 2].min() > 3.0 * 9


def test_nothing_is_born_into_a_gaussian_sum():
    path = walk(90, rng=np.random.default_rng(2))
    seen = carried_off(path, 8.0, 20)
    lost = follow(GAUSSIAN_SUM, seen, path.odometry)
    assert error_m(lost, path.truth).max() < 2.0
    assert lost[-1].status == "lost"


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("config", [CONFIG, AUGMENTED])
def test_births_find_a_camera_that_was_carried_off(config):
    path = walk(90, rng=np.random.default_rng(2))
    estimates = follow(config, carried_off(path, 8.0, 20), path.odometry)
    height = [estimate.modes[0].world_from_camera.translation[2] for estimate in estimates]
    np.testing.assert_allclose(height[80:], path.truth.translation[80:, 2] + 8.0, atol=0.5)


def test_in_augmented_localization_nothing_is_born_without_doubt_and_much_with_it():
    path = walk(60, rng=np.random.default_rng(3))
    localizer = ParticleLocalizer(None, AUGMENTED, rng=np.random.default_rng(0))
    fractions = []
    for i, (seen, motion) in enumerate(zip(carried_off(path, 8.0, 40), path.odometry, strict=True)):
        localizer.update(PosePosterior.uninformative(seen.noise) if 20 <= i < 30 else seen, motion)
        fractions.append(augmented_mcl(localizer.belief, 1.0, 1.0, AUGMENTED))
    assert max(fractions[:40]) < 0.05
    assert max(fractions[40:50]) > 0.2
