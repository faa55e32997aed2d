"""Regimes of odometry: hypotheses for which it is right, biased or useless."""

from dataclasses import replace

import numpy as np
import pytest

from filtering.config import GapConfig, LocalizerConfig
from filtering.hypotheses import BIASED, RIGHT, USELESS, odometry_bias_of
from filtering.localizer import ParticleLocalizer
from filtering.measurement_noise import MeasurementNoise
from filtering.mixture_reduction import reduce_mixture
from filtering.motion import Odometry, OdometryBias
from filtering.posterior import PosePosterior
from filtering.prediction import leaps, moved, usual_speed, with_regimes
from filtering.se3 import Poses
from filtering.unchecked import unchecked_replace
from tests.filtering.test_hypotheses import bank

BIAS = OdometryBias(scale=0.05, relative_drift=0.6)
STEP = Odometry(Poses.exp(np.array([0.1, 0, 0, 0, 0, 0])), np.diag([1e-5] * 3 + [1e-6] * 3), 0.1)
VELOCITY = GapConfig().velocity


def switched(of, failures_per_s=0.1, failure_s=5.0):
    return with_regimes(of, STEP, BIAS, MeasurementNoise(), 0.1, failures_per_s, failure_s)


def weight(of, regime):
    return of.weights[of.regime == regime].sum()


def test_odometry_begins_to_fail_at_its_rate_in_one_of_two_ways():
    after = switched(bank(3, weights=[0.5, 0.499, 0.001]))
    assert after.weights.sum() == pytest.approx(1.0)
    part = 0.999 * -np.expm1(-0.01)  # the lightest one stays as it is
    assert weight(after, BIASED) == pytest.approx(part / 2)
    assert weight(after, USELESS) == pytest.approx(part / 2)
    assert len(after) == 7


def test_odometry_that_failed_is_right_again_with_the_bias_known_before():
    before = bank(2, weights=[0.4, 0.6])
    before = unchecked_replace(before, regime=np.array([RIGHT, USELESS]))
    again = switched(before, failures_per_s=1e-9, failure_s=0.1)
    last = len(again) - 1
    assert again.regime[last] == RIGHT
    assert again.weights[last] == pytest.approx(0.6 * -np.expm1(-1.0))
    assert again.mean[last, 1:7] == pytest.approx(before.mean[0, 1:7])
    known, covariance = odometry_bias_of(before)
    assert known == pytest.approx(before.mean[0, :7])
    assert covariance == pytest.approx(before.covariance[0, 6:13, 6:13])


def test_the_drift_is_unknown_where_odometry_is_right_for_no_hypothesis():
    failed = unchecked_replace(bank(2), regime=np.array([USELESS, BIASED]))
    mean, covariance = odometry_bias_of(failed)
    assert mean[1:] == pytest.approx(0.0)
    assert covariance[1:, 1:] == pytest.approx(np.eye(6))
    assert covariance[0, 1:] == pytest.approx(0.0)


def test_useless_odometry_is_not_obeyed():
    before = bank(2, offset=0.0)
    before = unchecked_replace(before, regime=np.array([RIGHT, USELESS]))
    jump = Odometry(Poses.exp(np.array([50.0, 0, 0, 0, 0, 0])), STEP.covariance, 0.1)
    after = moved(before, jump, BIAS, VELOCITY, [1.0])
    apart_m = before.poses.distance(after.poses)[0]
    assert apart_m[0] == pytest.approx(50.0, rel=0.3)  # by its scale error
    assert apart_m[1] < 1.0


def test_a_motion_moves_each_hypothesis_where_it_is():
    before = unchecked_replace(bank(3, offset=0.0), regime=np.array([USELESS, RIGHT, USELESS]))
    after = moved(before, Odometry.still(0.1), BIAS, VELOCITY, [0.0])
    assert after.regime.tolist() == [USELESS, RIGHT, USELESS]
    assert after.log_weights.tolist() == before.log_weights.tolist()


def test_a_motion_that_no_camera_makes_is_one_far_faster_than_usual():
    far = Odometry(Poses.exp(np.array([3.0, 0, 0, 0, 0, 0])), STEP.covariance, 0.1)
    assert leaps(far, 0.0, MeasurementNoise())
    assert not leaps(far, 4.0, MeasurementNoise())  # of a camera that is fast
    assert not leaps(STEP, 0.0, MeasurementNoise())
    assert not leaps(replace(STEP, duration_s=0.001), 0.0, MeasurementNoise())  # fast, but no further than a view
    assert not leaps(replace(far, duration_s=2.5), 0.0, MeasurementNoise())
    assert not leaps(replace(far, duration_s=0.0), 0.0, MeasurementNoise())  # nobody knows how fast


def test_the_usual_speed_is_learned():
    speed = 0.0
    for _ in range(100):
        speed = usual_speed(speed, STEP)
    assert speed == pytest.approx(0.1 / 0.1, rel=0.15)
    assert usual_speed(speed, replace(STEP, duration_s=0.0)) == speed


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("unit", [1 / 30, 1.0, 30.0])
def test_a_jump_of_odometry_to_another_place_that_looks_alike_is_not_obeyed(unit):
    localizer, noise = ParticleLocalizer(None, rng=np.random.default_rng(0)), MeasurementNoise().scaled(unit)
    covariance, identities = STEP.covariance * np.multiply.outer(*[np.repeat([unit, 1.0], 3)] * 2), []
    for i in range(60):
        both = np.zeros((2, 6))
        both[:, 0], both[1, 1] = 0.1 * unit * i, 8.0 * unit
        seen = Poses.exp(both[:1] if i < 30 else both)
        jump = unit * np.array([0.1, 8.0 if i == 40 else 0.0, 0, 0, 0, 0])
        posterior = PosePosterior.from_estimates(seen, 0.05 * unit, 0.03, noise)
        estimate = localizer.update(posterior, Odometry(Poses.exp(jump), covariance, 0.1) if i else None)
        identities.append(estimate.modes[0].identity)
    assert abs(estimate.modes[0].world_from_camera.translation[1]) < 0.3 * unit
    assert estimate.status == "converged"
    assert len(set(identities)) == 1


@pytest.mark.usefixtures("unchecked")
def test_a_car_is_followed_from_the_start():
    """Noise that is stated for a room: 30 m/s are 60 new views a second."""
    localizer, car = ParticleLocalizer(None, rng=np.random.default_rng(0)), np.array([3.0, 0, 0, 0, 0, 0])
    for i in range(60):
        posterior = PosePosterior.from_estimates(Poses.exp(i * car[None]), 0.05, 0.03, MeasurementNoise())
        estimate = localizer.update(posterior, Odometry(Poses.exp(car), STEP.covariance, 0.1) if i else None)
        if i >= 20:
            assert estimate.status == "converged"
            assert estimate.modes[0].world_from_camera.translation[0] == pytest.approx(3.0 * i, abs=0.2)


def test_no_rate_is_no_failure():
    before = bank(2)
    assert switched(before, failures_per_s=0.0) is before


def test_hypotheses_of_different_regimes_are_not_merged():
    def twins(regime):
        both = bank(1)[np.zeros(2, np.int64)].with_log_weights(np.zeros(2))
        return unchecked_replace(both, regime=np.array([RIGHT, regime]))

    merged = {k: len(reduce_mixture(twins(k), divergence=0.5, least_weight=1e-8)) for k in (RIGHT, USELESS)}
    assert merged == {RIGHT: 1, USELESS: 2}


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("failures_per_s", [0.005, 0.0])
def test_two_places_keep_their_weights_while_odometry_triples(failures_per_s):
    """Without regimes odometry carries the belief off: the control."""
    std = np.array([0.05] * 3 + [0.03] * 3)
    config = LocalizerConfig(odometry_failures_per_s=failures_per_s, birth_rate=0.0, max_birth_rate=0.0)
    rng, localizer = np.random.default_rng(0), ParticleLocalizer(None, config, rng=np.random.default_rng(0))
    for i in range(120):
        both = np.zeros((2, 6))
        both[:, 0], both[1, 1] = 0.1 * i, 8.0
        seen = Poses.exp(both) @ Poses.exp(std * rng.standard_normal((1, 6)))
        reported = 0.3 if 60 <= i < 110 else 0.1
        odometry = Odometry(Poses.exp(np.array([reported, 0, 0, 0, 0, 0])), STEP.covariance, 0.1)
        posterior = PosePosterior.from_estimates(seen, 0.05, 0.03, MeasurementNoise())
        estimate = localizer.update(posterior, odometry if i else None)
    at = [mode.world_from_camera.translation for mode in estimate.modes]
    found = [any(np.linalg.norm(each - [11.9, y, 0.0]) < 0.3 for each in at) for y in (0.0, 8.0)]
    assert all(found) == (failures_per_s > 0.0)


def test_a_gap_does_not_make_places_alike():
    """All hypotheses are wide after it, and none the less one place fits, and the other does not."""
    localizer = ParticleLocalizer(None, rng=np.random.default_rng(0))
    for i in range(30):
        only = Poses.exp(np.array([[0.1 * i, 0, 0, 0, 0, 0]]))
        localizer.update(PosePosterior.from_estimates(only, 0.05, 0.03, MeasurementNoise()), STEP if i else None)
    both = np.array([[3.0, 0, 0, 0, 0, 0], [3.0, 8.0, 0, 0, 0, 0]])
    alike = PosePosterior.from_estimates(Poses.exp(both), 0.05, 0.03, MeasurementNoise())
    for _ in range(4):
        estimate = localizer.update(alike, None, elapsed_s=2.0)
    wrong = sum(mode.weight for mode in estimate.modes if mode.world_from_camera.translation[1] > 4.0)
    assert wrong < 0.1
