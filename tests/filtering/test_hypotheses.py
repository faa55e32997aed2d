from dataclasses import replace

import numpy as np
import pytest

from filtering.config import GapConfig
from filtering.errors import VaporTrackError
from filtering.hypotheses import (
    BIAS,
    POSE,
    RIGHT,
    Hypotheses,
    birth,
    concatenate,
    correlated_error,
    log_sum,
    with_drift,
)
from filtering.measurement_noise import MeasurementNoise
from filtering.mixture_reduction import reduce_mixture, resample
from filtering.motion import Odometry, OdometryBias
from filtering.prediction import Gap, across_gap, motion_of_state, predict
from filtering.se3 import Poses
from tests.helpers.simulation import motion, seen_at

NEVER = OdometryBias(scale=0.0, relative_drift=0.0)


def random_covariances(count, size, *, seed, scale=1.0):
    root = np.random.default_rng(seed).normal(size=(count, size, size)) / np.sqrt(size)
    return scale**2 * (root @ np.swapaxes(root, 1, 2) + 0.1 * np.eye(size))


def bank(count, *, seed=0, offset=1e-3, scale=0.05, weights=None):
    """Hypotheses about one place, with all parts of a state correlated."""
    rng = np.random.default_rng(seed)
    poses = Poses.exp(np.array([3.0, 1, 2, 0.1, 0.2, 1.0])) @ Poses.exp(offset * rng.standard_normal((count, 6)))
    weights = rng.dirichlet(np.ones(count)) if weights is None else np.array(weights)
    covariance = random_covariances(count, 19, seed=seed, scale=scale)
    return Hypotheses(
        poses, offset * rng.standard_normal((count, 13)), covariance, np.log(weights), np.full(count, RIGHT)
    )


def mixture_moments(h, about):
    """Mean and covariance of the whole state of a mixture, poses in the tangent at one pose."""
    centre = np.concatenate([(about.inverse() @ h.poses).log(), h.mean], axis=1)
    mean = h.weights @ centre
    residual = centre - mean
    return mean, np.einsum("n,nij->ij", h.weights, h.covariance + residual[:, :, None] * residual[:, None, :])


# --- weights ----------------------------------------------------------------------------------------


def test_weights_are_normalised_and_zero_weights_are_fine_beside_others():
    h = bank(4).with_log_weights(np.array([900.0, 901.0, -np.inf, 900.0]))
    assert h.weights.sum() == pytest.approx(1.0)
    assert h.weights[2] == 0.0
    assert h.weights[1] / h.weights[0] == pytest.approx(np.e)


@pytest.mark.parametrize(
    ("log_weights", "message"),
    [
        ([0.0, 0, np.nan, 0], "hypothesis 2 is nan"),
        ([0.0, 0, np.inf, 0], "hypothesis 2 is inf"),
        ([-np.inf] * 4, "all 4 weights are zero"),
    ],
)
def test_weights_that_are_not_finite_or_all_zero_are_refused(log_weights, message):
    with pytest.raises(VaporTrackError, match=message):
        bank(4).with_log_weights(np.array(log_weights))


def test_the_log_of_a_sum_neither_overflows_nor_vanishes():
    assert log_sum(np.array([1000.0, 1000.0])) == pytest.approx(1000 + np.log(2))
    assert log_sum(np.array([-1000.0, -1000.0])) == pytest.approx(-1000 + np.log(2))
    assert log_sum(np.full(3, -np.inf)) == -np.inf


def test_a_newborn_knows_of_the_odometrys_errors_what_the_heaviest_hypothesis_knows():
    belief = bank(3, weights=[0.2, 0.7, 0.1])
    h = birth(seen_at(Poses.identity(1)), 0, 1, OdometryBias(), belief)
    np.testing.assert_array_equal(h.mean[0, :7], belief.mean[1, :7])
    np.testing.assert_array_equal(h.covariance[0, BIAS, BIAS], belief.covariance[1, BIAS, BIAS])
    assert not h.mean[0, 7:].any()
    assert not h.covariance[0, POSE, BIAS].any()


# --- motion -----------------------------------------------------------------------------------------


def test_what_moves_is_what_happens_to_draws_of_the_state():
    """40 000 draws of pose, odometry bias and correlated errors, moved one by one: mean and covariance within 4 %."""
    rng = np.random.default_rng(0)
    h = bank(1, weights=[1.0])
    slow = OdometryBias(scale=0.03, drift=(0.05, 0.04, 0.03, 0.02, 0.03, 0.04), time_s=5.0)
    covariance = random_covariances(1, 6, seed=1, scale=0.02)[0]
    step = Odometry(Poses.exp(np.array([0.4, -0.1, 0.2, 0.1, 0.3, -0.2])), covariance, 0.8)
    after = predict(h, step, slow, [0.6])

    count = 40_000
    draws = rng.standard_normal((count, 19)) @ np.linalg.cholesky(h.covariance[0]).T
    states = h.mean[0] + draws[:, 6:]
    drift, drifted, parts = states[:, 1:7], np.zeros((count, 6)), 50
    for _ in range(parts):  # it changes on the way
        before, kept = drift, np.exp(-0.8 / parts / 5.0)
        drift = kept * drift + np.sqrt(1 - kept**2) * rng.standard_normal((count, 6))
        drifted += (before + drift) / 2.0 * np.array(slow.drift) * 0.8 / parts
    scaled = np.hstack([states[:, :1] * step.previous_from_current.log()[:3], np.zeros((count, 3))])
    errs = -scaled - drifted
    white = rng.standard_normal((count, 6)) @ np.linalg.cholesky(covariance).T
    poses = h.poses[[0] * count] @ Poses.exp(draws[:, :6]) @ step.previous_from_current @ Poses.exp(errs + white)
    faded = np.exp(-0.6)
    correlated = faded * states[:, 7:] + np.sqrt(1 - faded**2) * rng.standard_normal((count, 6))
    states = np.hstack([states[:, :1], drift, correlated])

    drawn = np.hstack([(after.poses[0].inverse() @ poses).log(), states - after.mean[0]])
    std = np.sqrt(np.diag(after.covariance[0]))
    np.testing.assert_allclose(drawn.mean(axis=0) / std, 0.0, atol=0.03)
    np.testing.assert_allclose(
        np.cov(drawn.T) / np.outer(std, std), after.covariance[0] / np.outer(std, std), atol=0.04
    )


def test_many_hypotheses_move_as_the_transition_of_the_state_says():
    h, slow = bank(300), OdometryBias(scale=0.05, relative_drift=0.5)
    odometry = motion(0.3, 0.1, 0, 0.2, 0.1, 0.3)
    of_state = motion_of_state(odometry, slow, [0.7])
    transition, noise = of_state.transition, of_state.noise
    after = predict(h, odometry, slow, [0.7]).covariance
    np.testing.assert_allclose(after, transition @ h.covariance @ transition.T + noise, atol=1e-12)


def test_no_direction_is_known_less_than_none_after_an_unknown_motion():
    velocity = GapConfig(speed_m_per_s=1e3, turn_rad_per_s=300.0).velocity
    wide = across_gap(with_drift(bank(2), np.zeros(6), np.eye(6)), Gap.of(None, 1.0, velocity), [1.0])
    np.testing.assert_allclose(np.sqrt(wide.covariance[0, range(3, 6), range(3, 6)]), 2.0)
    assert np.linalg.eigvalsh(wide.covariance).min() > -1e-9


# --- fewer ------------------------------------------------------------------------------------------


def fewer(h, *, divergence=0.5, least_weight=0.0, most=100, seed=0):
    reduced = reduce_mixture(h, divergence=divergence, least_weight=least_weight)
    return reduced if len(reduced) <= most else resample(reduced, most, "optimal", rng=np.random.default_rng(seed))


def test_merging_keeps_weight_mean_and_covariance_of_the_mixture():
    h = bank(20, offset=0.02, scale=0.1)
    merged = fewer(h, divergence=100.0)
    assert len(merged) < 5  # precondition: most were merged
    assert merged.weights.sum() == pytest.approx(1.0)
    about = h.poses[0]
    (mean, covariance), (expected_mean, expected) = mixture_moments(merged, about), mixture_moments(h, about)
    std = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(mean / std, expected_mean / std, atol=0.01)  # but for the curvature of SE(3)
    np.testing.assert_allclose(covariance / np.outer(std, std), expected / np.outer(std, std), atol=0.02)


def test_merging_groups_apart_keeps_the_weight_of_each():
    here, there = bank(10, seed=1), bank(10, seed=2)
    far = Poses.exp(np.array([9.0, 0, 0, 0, 0, 0]))
    both = concatenate([here, replace(there, poses=far @ there.poses)])
    both = both.with_log_weights(both.log_weights + np.repeat(np.log([0.8, 0.2]), 10))
    at_far = both.poses.translation[:, 0] > 7.0
    merged = fewer(both, divergence=100.0)
    assert len(merged) < 6
    assert merged.weights[merged.poses.translation[:, 0] > 7.0].sum() == pytest.approx(both.weights[at_far].sum())


@pytest.mark.parametrize("weights", [(0.9, 0.1), (0.1, 0.9)])
def test_a_tight_hypothesis_and_a_wide_one_at_one_spot_stay_two(weights):
    h = bank(2, offset=0.0, weights=weights)
    covariance = h.covariance.copy()
    covariance[1] = covariance[0] * 9.0
    assert len(fewer(replace(h, covariance=covariance), divergence=0.5)) == 2
    covariance[1] = covariance[0] * 1.1
    assert len(fewer(replace(h, covariance=covariance), divergence=0.5)) == 1


def test_a_hypothesis_that_differs_by_more_than_its_covariance_stays_its_own():
    h = bank(2, offset=0.0, weights=(0.5, 0.5))
    covariance = np.repeat(h.covariance[:1], 2, 0)
    std = np.sqrt(covariance[0, 0, 0])
    for apart, expected in ((0.1, 1), (5.0, 2)):
        poses = Poses(h.poses.rotation, h.poses.translation + np.array([[0.0, 0, 0], [apart * std, 0, 0]]))
        assert len(fewer(replace(h, poses=poses, covariance=covariance))) == expected


def test_fewer_hypotheses_come_by_falling_weight_as_many_as_asked_and_normalised():
    h = bank(300, offset=3.0)
    for most in (1, 10, 100):
        few = fewer(h, divergence=0.0, most=most)
        assert len(few) == most
        assert few.weights.sum() == pytest.approx(1.0)
        assert (np.diff(few.log_weights) <= 0).all()


def test_what_is_lighter_than_the_least_weight_goes_but_the_heaviest_stays():
    h = bank(4, offset=3.0, weights=[0.9, 0.1 - 2e-9, 1e-9, 1e-9])
    assert len(fewer(h, divergence=0.0, least_weight=1e-8)) == 2
    even = bank(200, offset=3.0, weights=np.full(200, 1 / 200))
    assert len(fewer(even, divergence=0.0, least_weight=0.1, most=1000)) == 200


def test_measurement_noise_without_correlated_errors_ties_a_newborn_to_no_bias():
    h = birth(seen_at(Poses.identity(1), noise=MeasurementNoise(correlated_fraction=0.0)), 0, 1, NEVER, None)
    assert not h.covariance[0, POSE, correlated_error(0)].any()
