"""Which place and where in it: the saturating likelihood, and details cut off from the question which place it is."""

import numpy as np
import pytest

from filtering.density import KernelDensity
from filtering.localizer import LocalizerConfig, ParticleLocalizer
from filtering.particles import Particles
from filtering.posterior import LikelihoodModel, PosteriorSamples
from filtering.regularisation import KernelConfig
from filtering.se3 import Poses
from tests.simulation import FLOOR_HEIGHT_M, POSTERIOR_STD, Oracle, climb

MODEL = LikelihoodModel(temper=0.2, saturation=4.0, preference=0.06)
ORIGIN = Poses.identity(1)


def posterior_of(truth, shares, *, num_samples, rng, likelihood=MODEL, std=POSTERIOR_STD):
    """Samples about one true pose, the given shares of them on each floor, to the last sample."""
    around = truth @ Poses.exp(rng.standard_normal((num_samples, 6)) * std)
    lift = np.zeros((num_samples, 3))
    floor = np.repeat(np.arange(len(shares)), np.round(np.multiply(shares, num_samples)).astype(int))
    lift[:, 2] = FLOOR_HEIGHT_M * rng.permutation(floor)
    samples = Poses(around.rotation, around.translation + lift)
    return PosteriorSamples(KernelDensity(samples, 0.1, 0.1), likelihood, KernelDensity(samples[:250], 0.4, 0.3))


def floor_weights(estimate, truth, num_floors):
    """Share of the belief within 1 m of the true place on each floor."""
    height = estimate.particles.translation[:, 2] - truth.translation[2]
    floor = np.round(height / FLOOR_HEIGHT_M).astype(int)
    return np.array([np.exp(estimate.log_weights)[floor == k].sum() for k in range(num_floors)])


def follow(shares_at, num_images, *, seed, likelihood=MODEL):
    """Weights of the floors after every image of a walk past floors that look alike."""
    rng = np.random.default_rng(seed)
    truth, odometry = climb(num_images, rng=rng)
    config = LocalizerConfig(num_particles=800, kernels=KernelConfig(max_kernels=400))
    localizer = ParticleLocalizer(Oracle(truth, (0,), range(0)), config, rng=rng)
    weights = []
    for i in range(num_images):
        shares = shares_at(i)
        posterior = posterior_of(truth[i], shares, num_samples=100, rng=rng, likelihood=likelihood)
        weights.append(floor_weights(localizer.update(posterior, odometry[i]), truth[i], len(shares)))
    return np.array(weights)


@pytest.mark.parametrize("seeds", [range(5 * k, 5 * k + 5) for k in range(4)])
def test_two_equal_places_keep_their_shares_for_300_images_until_one_is_unique(seeds):
    for seed in seeds:
        weights = follow(lambda i: (0.5, 0.5) if i < 300 else (1.0, 0.0), 340, seed=seed)
        assert weights[:300].min() > 0.4
        assert weights[:300].max() < 0.6
        assert weights[-1, 0] > 0.95


def test_a_network_that_prefers_one_of_two_places_all_the_time_does_not_make_the_filter_sure():
    """Four in five samples on one floor, image after image: the other is no less possible for that."""
    biased = [follow(lambda _: (0.2, 0.8), 60, seed=seed)[-1, 0] for seed in range(2)]
    assert min(biased) > 0.05
    trusting = LikelihoodModel(temper=0.2)  # no saturation
    assert max(follow(lambda _: (0.2, 0.8), 60, seed=seed, likelihood=trusting)[-1, 0] for seed in range(2)) < 1e-3


def test_a_place_that_images_rule_out_is_lost():
    weights = follow(lambda i: (0.5, 0.5) if i < 5 else (1.0, 0.0), 40, seed=0)
    assert weights[-1, 0] > 0.98


def test_the_likelihood_grows_up_to_the_saturation_and_little_beyond():
    log_prior = np.zeros(3)
    ratio = np.array([0.0, 4.0, 14.0])  # log evidence
    log_density = np.log(np.expm1(np.maximum(ratio, 1e-12))) - np.log(0.95 / 0.05)
    values = MODEL.log_likelihood(log_density, log_prior)
    np.testing.assert_allclose(values, 0.2 * np.array([0.0, 4.0, 4.0 + 0.06 * 10.0]), atol=1e-6)
    without = LikelihoodModel(temper=0.2).log_likelihood(log_density, log_prior)
    np.testing.assert_allclose(without, 0.2 * ratio, atol=1e-6)


def test_details_narrow_a_place_and_leave_its_share():
    rng = np.random.default_rng(0)
    tight = posterior_of(ORIGIN[0], (1.0,), num_samples=1000, rng=rng, std=0.05 * np.ones(6))
    there = Poses.exp(0.15 * rng.standard_normal((500, 6)))
    elsewhere = Poses(there.rotation, there.translation + np.array([0, 0, 30.0]))
    belief, _ = Particles.from_unnormalised(Poses.concatenate([there, elsewhere]), np.zeros(1000))
    label = np.repeat([0, 1], 500)
    detailed = belief.reweighted(tight.log_detail(belief.poses))
    assert detailed.weights[:500].sum() > 0.55  # uncut, the place with the details gains
    cut = detailed.keep_shares(belief, label)
    assert cut.weights[:500].sum() == pytest.approx(0.5)
    np.testing.assert_allclose(cut.weights[500:], 0.5 / 500)  # nothing is known of details there
    spread = [np.average(np.square(there.translation).sum(1), weights=w[:500]) for w in (belief.weights, cut.weights)]
    assert spread[1] < 0.85 * spread[0]


def test_a_hypothesis_whose_details_are_impossible_keeps_its_share():
    belief, _ = Particles.from_unnormalised(Poses.identity(5), np.log([0.2, 0.3, 0.1, 0.4, 1e-300]))
    detailed = belief.reweighted(np.array([np.log(3.0), 0.0, -np.inf, -np.inf, 0.0]))
    kept = detailed.keep_shares(belief, np.array([0, 0, 1, 1, -1]))
    np.testing.assert_allclose(kept.weights, [0.5 * 2 / 3, 0.5 / 3, 0.1, 0.4, 1e-300])


def test_a_posterior_without_places_has_no_details():
    assert PosteriorSamples(KernelDensity(ORIGIN, 0.1, 0.1)).log_detail(ORIGIN) is None
