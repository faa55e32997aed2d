"""The belief as kernels: nothing of it may be lost, moved or inflated by becoming a density."""

import numpy as np
import pytest

from filtering.density import KernelDensity
from filtering.moments import group_moments
from filtering.particles import Particles
from filtering.regularisation import KernelConfig, belief_kernels, regularise, spread_draw
from filtering.se3 import Poses

SPREAD = np.array([0.3, 0.1, 0.2, 0.05, 0.1, 0.08])


def place(x, n, seed):
    local = Poses.exp(SPREAD * np.random.default_rng(seed).standard_normal((n, 6)))
    return Poses.exp(np.array([x, 0, 0, 0, 0, x / 9])) @ local


def two_places(share):
    """200 particles at 0 and 200 at 9 m, which hold `share` of the belief."""
    poses = Poses.concatenate([place(0.0, 200, 0), place(9.0, 200, 1)])
    weights = np.repeat([1 - share, share], 200) / 200
    return Particles(poses, np.log(weights)), np.repeat([0, 1], 200)


def test_group_moments_are_those_of_every_group_alone():
    poses = Poses.concatenate([place(0.0, 50, 0), place(3.0, 70, 1)])
    weights = np.random.default_rng(2).random(120)
    means, covariances, tangent = group_moments(poses, weights, np.repeat([0, 1], [50, 70]), 2)
    for k, own in enumerate((slice(50), slice(50, 120))):
        mean = poses[own].mean(weights[own])
        np.testing.assert_allclose(means[k].as_matrix(), mean.as_matrix(), atol=1e-12)
        deviation = (mean.inverse() @ poses[own]).log()
        np.testing.assert_allclose(tangent[own], deviation, atol=1e-9)
        np.testing.assert_allclose(covariances[k], np.cov(deviation.T, aweights=weights[own], bias=True), atol=1e-3)


def test_a_group_without_weight_counts_its_poses_equally():
    poses = place(0.0, 20, 3)
    means, _, _ = group_moments(poses, np.zeros(20), np.zeros(20, np.int64), 1)
    np.testing.assert_allclose(means[0].as_matrix(), poses.mean().as_matrix(), atol=1e-12)


@pytest.mark.parametrize("share", [0.3, 1e-4])
def test_draws_carry_the_weights_that_make_them_the_belief_again(share):
    belief, label = two_places(share)
    sums = []
    for seed in range(20):
        drawn, log_weights = spread_draw(belief, 100, label=label, even_share=0.5, rng=np.random.default_rng(seed))
        assert np.exp(log_weights).sum() == pytest.approx(1.0)
        sums.append(np.exp(log_weights[label[drawn] == 1]).sum())
    assert np.mean(sums) == pytest.approx(share, rel=0.02)


def test_an_unlikely_hypothesis_gets_its_even_share_of_the_draws():
    belief, label = two_places(1e-8)
    for even_share, expected in [(0.0, 0.0001), (0.5, 0.25), (1.0, 0.5)]:
        drawn, _ = spread_draw(belief, 1000, label=label, even_share=even_share, rng=np.random.default_rng(0))
        assert np.mean(label[drawn] == 1) == pytest.approx(expected, abs=0.002)


def test_particles_of_no_hypothesis_are_drawn_too():
    belief, label = two_places(0.5)
    label = np.where(label == 1, -1, 0)
    drawn, _ = spread_draw(belief, 100, label=label, even_share=0.5, rng=np.random.default_rng(0))
    assert np.mean(label[drawn] == -1) == pytest.approx(0.25, abs=0.02)
    nobody = np.full(400, -1)
    drawn, _ = spread_draw(belief, 400, label=nobody, even_share=0.5, rng=np.random.default_rng(0))
    assert len(np.unique(drawn)) == 400


@pytest.mark.parametrize("scale", [0.3, 1.0])
def test_smoothed_kernels_have_the_mean_and_the_covariance_of_what_they_smooth(scale):
    poses = place(2.0, 300, 4)
    kernels = regularise(poses, np.full(300, -np.log(300)), np.zeros(300, np.int64), scale=scale)
    assert (kernels.widths > 0.05 * scale * SPREAD[[1, 3]]).all()
    density = KernelDensity(kernels.centres, *kernels.widths.T)
    draws = density.draw(np.repeat(np.arange(300), 200), rng=np.random.default_rng(5))
    mean, covariance, _ = group_moments(poses, np.ones(300), np.zeros(300, np.int64), 1)
    drawn_mean, drawn_covariance, _ = group_moments(draws, np.ones(60_000), np.zeros(60_000, np.int64), 1)
    assert float(drawn_mean.distance(mean)[0][0]) < 0.005
    np.testing.assert_allclose(
        np.sqrt(np.diagonal(drawn_covariance[0])), np.sqrt(np.diagonal(covariance[0])), rtol=0.03
    )


def test_nothing_is_smoothed_across_hypotheses_and_what_belongs_to_none_stays():
    belief, label = two_places(0.5)
    label[-50:] = -1
    kernels = regularise(belief.poses, belief.log_weights, label, scale=1.0)
    np.testing.assert_array_equal(kernels.centres.translation[-50:], belief.poses.translation[-50:])
    np.testing.assert_array_equal(kernels.widths[-50:], 0.0)
    assert (np.abs(kernels.centres.translation[:200, 0]) < 2.0).all()
    assert (np.abs(kernels.centres.translation[200:, 0] - belief.poses.translation[200:, 0]) < 1.0).all()
    assert kernels.widths[:, 0].max() < 0.3


@pytest.mark.parametrize("count", [1, 2, 5])
def test_too_few_particles_for_a_covariance_are_left_where_they_are(count):
    poses = place(1.0, count, 6)
    kernels = regularise(poses, np.full(count, -np.log(count)), np.zeros(count, np.int64), scale=1.0)
    np.testing.assert_allclose(kernels.centres.translation, poses.translation, atol=1e-6)
    np.testing.assert_allclose(kernels.widths, 0.0, atol=1e-6)


def test_the_same_belief_gives_the_same_kernels():
    belief, label = two_places(0.01)
    first, second = (belief_kernels(belief, label, 50, KernelConfig(), rng=np.random.default_rng(7)) for _ in range(2))
    np.testing.assert_array_equal(first.centres.translation, second.centres.translation)
    np.testing.assert_array_equal(first.log_weights, second.log_weights)
