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


@pytest.mark.parametrize("labelled", [True, False])
@pytest.mark.parametrize("share", [0.3, 1e-4])
def test_draws_carry_the_weights_that_make_them_the_belief_again(share, labelled):
    belief, label = two_places(share)
    sums = []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        drawn, log_weights = spread_draw(belief, 100, label=label if labelled else None, exponent=0.25, rng=rng)
        assert np.exp(log_weights).sum() == pytest.approx(1.0)
        sums.append(np.exp(log_weights[label[drawn] == 1]).sum())
    assert np.mean(sums) == pytest.approx(share, rel=0.02)


@pytest.mark.parametrize("exponent", [0.0, 0.25, 0.5, 1.0])
def test_a_hypothesis_is_drawn_by_a_power_of_its_weight(exponent):
    belief, label = two_places(0.001)
    drawn, _ = spread_draw(belief, 5000, label=label, exponent=exponent, rng=np.random.default_rng(0))
    expected = 0.001**exponent / (0.001**exponent + 0.999**exponent)
    assert np.mean(label[drawn] == 1) == pytest.approx(expected, rel=0.03, abs=0.0003)


def test_within_a_hypothesis_particles_are_drawn_by_the_root_of_their_weights():
    poses = place(0.0, 200, 0)
    belief, _ = Particles.from_unnormalised(poses, np.repeat([0.0, np.log(0.01)], 100))
    drawn, _ = spread_draw(belief, 5000, label=np.zeros(200, np.int64), exponent=0.25, rng=np.random.default_rng(0))
    assert np.mean(drawn >= 100) == pytest.approx(0.1 / 1.1, rel=0.03)


def test_particles_of_no_hypothesis_are_drawn_as_if_they_were_one():
    belief, label = two_places(0.0001)
    label = np.where(label == 1, -1, 0)
    drawn, _ = spread_draw(belief, 2200, label=label, exponent=0.25, rng=np.random.default_rng(0))
    assert np.mean(label[drawn] == -1) == pytest.approx(0.1 / 1.1, rel=0.03)


@pytest.mark.parametrize("scale", [0.5, 1.0])
def test_smoothed_kernels_have_the_mean_and_the_covariance_of_what_they_smooth(scale):
    """Weights and axes are skewed: neither an unweighted mean nor a shrinkage axis by axis would do."""
    lean = np.eye(6)
    lean[0, 1], lean[4, 0] = 1.5, 0.3
    n = 400
    tangent = np.random.default_rng(4).standard_normal((n, 6)) * SPREAD @ lean.T
    poses = Poses.exp(np.array([2.0, 0, 0, 0.5, 0, 0])) @ Poses.exp(tangent)
    log_weights = np.where(tangent[:, 0] > 0, 0.0, -1.5)
    log_weights -= np.logaddexp.reduce(log_weights)
    one = np.zeros(n, np.int64)
    centres, widths = regularise(poses, log_weights, one, np.arange(n), scale=scale)
    density = KernelDensity(centres, *widths.T)
    draws = density.draw(np.repeat(np.arange(n), 200), rng=np.random.default_rng(5))
    mean, covariance, _ = group_moments(poses, np.exp(log_weights), one, 1)
    repeated = np.repeat(np.exp(log_weights), 200), np.repeat(one, 200)
    drawn_mean, drawn_covariance, _ = group_moments(draws, *repeated, 1)
    assert float(drawn_mean.distance(mean)[0][0]) < 0.005
    unit = np.sqrt(np.diagonal(covariance[0]))
    np.testing.assert_allclose(
        drawn_covariance[0] / unit / unit[:, None], covariance[0] / unit / unit[:, None], atol=0.02
    )


def test_the_width_is_that_of_silverman_for_the_distinct_particles():
    poses = Poses.exp(0.1 * np.random.default_rng(6).standard_normal((5000, 6)))
    one, equal = np.zeros(5000, np.int64), np.zeros(5000)
    _, widths = regularise(poses, equal, one, np.arange(5000), scale=0.5)
    np.testing.assert_allclose(widths, 0.5 * 0.1 * (4 / (8 * 5000)) ** 0.1, rtol=0.06)
    twice = np.repeat(np.arange(2500), 2)
    _, of_duplicates = regularise(poses[twice], equal, one, twice, scale=0.5)
    np.testing.assert_allclose(of_duplicates, 0.5 * 0.1 * (4 / (8 * 2500)) ** 0.1, rtol=0.06)
    half = np.where(np.arange(5000) < 2500, 0.0, -50.0)
    _, of_half = regularise(poses, half, one, np.arange(5000), scale=0.5)
    np.testing.assert_allclose(of_half, of_duplicates, rtol=0.1)


def test_nothing_is_smoothed_across_hypotheses_and_what_belongs_to_none_stays():
    belief, label = two_places(0.5)
    label[-50:] = -1
    before = belief.poses.translation
    centres, widths = regularise(belief.poses, belief.log_weights, label, np.arange(400), scale=1.0)
    np.testing.assert_array_equal(centres.translation[-50:], before[-50:])
    np.testing.assert_allclose(widths[-50:], widths[:350].min(axis=0).repeat(50).reshape(2, 50).T)
    assert (np.abs(centres.translation[:200, 0]) < 2.0).all()
    assert (np.abs(centres.translation[200:, 0] - before[200:, 0]) < 1.0).all()
    assert widths[:, 0].max() < 0.3


def test_a_hypothesis_far_less_likely_than_another_is_smoothed_like_it():
    belief, label = two_places(0.5)
    _, equal = regularise(belief.poses, belief.log_weights, label, np.arange(400), scale=0.5)
    unlikely = belief.log_weights - 900.0 * (label == 1)
    _, widths = regularise(belief.poses, unlikely, label, np.arange(400), scale=0.5)
    np.testing.assert_allclose(widths, equal)


@pytest.mark.parametrize("count", [1, 2, 5])
def test_too_few_particles_for_a_covariance_are_left_where_they_are(count):
    poses, one = place(1.0, count, 6), np.zeros(count, np.int64)
    centres, widths = regularise(poses, np.full(count, -np.log(count)), one, np.arange(count), scale=1.0)
    np.testing.assert_allclose(centres.translation, poses.translation, atol=1e-6)
    np.testing.assert_allclose(widths, 0.0, atol=1e-6)


@pytest.mark.parametrize("gap", [700.0, 1450.0, 5000.0])
def test_a_belief_of_extreme_weights_is_drawn_without_overflow(gap):
    poses = Poses.concatenate([place(0.0, 200, 0), place(9.0, 200, 1)])
    belief, _ = Particles.from_unnormalised(poses, np.repeat([0.0, -gap], 200))
    _, log_weights = spread_draw(belief, 100, label=np.repeat([0, 1], 200), exponent=0.25, rng=np.random.default_rng(0))
    assert np.exp(log_weights).sum() == pytest.approx(1.0)


def test_the_same_belief_gives_the_same_kernels():
    belief, label = two_places(0.01)
    first, second = (belief_kernels(belief, label, 50, KernelConfig(), rng=np.random.default_rng(7)) for _ in range(2))
    np.testing.assert_array_equal(first.centres.translation, second.centres.translation)
    np.testing.assert_array_equal(first.log_weights, second.log_weights)
