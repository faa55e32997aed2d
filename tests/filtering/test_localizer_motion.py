"""Odometry, its unit of length, and steps without any."""

from dataclasses import replace

import numpy as np
import pytest

from filtering.config import GapConfig, LocalizerConfig
from filtering.errors import VaporTrackError
from filtering.localizer import ParticleLocalizer
from filtering.motion import Odometry, OdometryBias
from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from tests.helpers.simulation import (
    AHEAD,
    ERRORS,
    OUT_OF_DISTRIBUTION,
    RNG,
    STAY,
    STD,
    assert_same_belief,
    image_errors,
    lifted,
    motion,
    new_localizer,
    seen_at,
    walk,
    weight_near,
)

# --- odometry -------------------------------------------------------------------------------------


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("too_long", [0.05, -0.05])
def test_odometry_that_is_5_percent_off_is_found_out(too_long):
    localizer = new_localizer(odometry_bias=OdometryBias(scale=0.05, relative_drift=0.1))
    rng, true = RNG(0), Poses.identity()
    step = motion(0.2, 0, 0, 0, 0, 0, std=[2e-3] * 3 + [1e-3] * 3)
    reported = motion(0.2 * (1 + too_long), 0, 0, 0, 0, 0, std=[2e-3] * 3 + [1e-3] * 3)
    for error in image_errors([0.4] * 149, ERRORS, rng=rng):
        true = true @ step.previous_from_current
        estimate = localizer.update(seen_at(true @ Poses.exp(error)), reported)
    assert estimate.status == "converged"
    far = localizer.predict(motion(20 * (1 + too_long), 0, 0, 0, 0, 0, duration_s=10.0)).modes[0].world_from_camera
    assert far.translation[0] == pytest.approx(true.translation[0] + 20.0, abs=0.5)  # not 1 m off
    begin = estimate.modes[0].world_from_camera.translation[0]
    assert far.translation[0] - begin == pytest.approx(20.0, abs=20 * 0.015)  # the scale is found as well


def test_the_normalized_distance_is_that_since_the_last_image_however_it_was_predicted():
    def forward(metres):
        return motion(metres, 0, 0, 0, 0, 0)

    seen = [seen_at(Poses.exp(np.array([[x, 0.0, 0, 0, 0, 0]]))) for x in (0.0, 0.4, 0.8)]
    whole, parts = (ParticleLocalizer(None, rng=RNG(0)) for _ in range(2))
    for localizer in (whole, parts):
        assert localizer.update(seen[0], None).normalized_distance == 0.0
        assert localizer.update(seen[1], forward(0.4)).normalized_distance == pytest.approx(0.4 / ERRORS.length_m)
    assert parts.predict(forward(0.3)).normalized_distance == pytest.approx(0.3 / ERRORS.length_m)
    assert parts.predicted(forward(0.1)).normalized_distance == pytest.approx(0.4 / ERRORS.length_m)
    assert parts.update(seen[2], forward(0.1)).normalized_distance == pytest.approx(0.4 / ERRORS.length_m)
    assert whole.update(seen[2], forward(0.4)).normalized_distance == pytest.approx(0.4 / ERRORS.length_m)


def test_what_is_predicted_changes_no_belief():
    localizer = ParticleLocalizer(None, rng=RNG(0))
    localizer.update(seen_at(Poses.identity(1)), None)
    belief = localizer.belief
    later = localizer.predicted(AHEAD)
    assert localizer.belief is belief
    np.testing.assert_array_equal(localizer.predict(AHEAD).particles.translation, later.particles.translation)


# --- unit of length -------------------------------------------------------------------------------


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("factor", [0.1, 30.0, 1000.0])
def test_nothing_depends_on_the_unit_of_length(factor):
    """Another place every ten images, outliers, a gap: the same weights and statuses, and poses times the factor."""

    def scaled(pose):
        return Poses(pose.rotation, factor * pose.translation)

    lengths = np.array([factor] * 3 + [1.0] * 3)
    config = LocalizerConfig(max_hypotheses=20)
    localizers = [
        ParticleLocalizer(None, used, rng=RNG(0))
        for used in (config, replace(config, gap=GapConfig(speed_m_per_s=1.5 * factor)))
    ]
    rng, pose, noise = RNG(2), Poses.identity(), replace(ERRORS, weight_power=0.5)
    models = noise, noise.scaled(factor)
    statuses = set()
    for i in range(60):
        pose = pose @ AHEAD.previous_from_current
        seen = lifted(pose @ Poses.exp(STD * rng.standard_normal(6)), (0.0, 3.0, 6.0))
        if i % 9 == 8:
            seen = Poses(seen.rotation, seen.translation + rng.uniform(-20, 20, 3))
        shares = (0.5, 0.3, 0.1) if i < 30 else (0.9, 0.05, 0.01)
        odometry = None if i == 20 else AHEAD
        grown = odometry and Odometry(
            scaled(AHEAD.previous_from_current), AHEAD.covariance * np.outer(lengths, lengths), AHEAD.duration_s
        )
        one = localizers[0].update(seen_at(seen, shares, noise=models[0]), odometry, elapsed_s=0.5)
        other = localizers[1].update(
            seen_at(scaled(seen), shares, std=STD * lengths, noise=models[1]), grown, elapsed_s=0.5
        )
        assert one.status == other.status
        statuses.add(one.status)
        np.testing.assert_allclose(other.log_weights, one.log_weights, rtol=1e-6, atol=1e-6)
        np.testing.assert_allclose(
            other.particles.translation / factor, one.particles.translation, rtol=1e-6, atol=1e-6
        )
        np.testing.assert_allclose(
            [other.agreement, other.novelty, other.normalized_distance],
            [one.agreement, one.novelty, one.normalized_distance],
            rtol=1e-6,
            atol=1e-9,
        )
        for mode, larger in zip(one.modes, other.modes, strict=True):
            assert larger.weight == pytest.approx(mode.weight, rel=1e-6)
            std = np.sqrt(np.diag(mode.covariance))
            np.testing.assert_allclose(np.sqrt(np.diag(larger.covariance)), std * lengths, rtol=1e-6)
    assert statuses == {"ambiguous", "converged"}  # precondition: something happened


@pytest.mark.parametrize("factor", [0.4, 2.5])
def test_odometry_in_an_unknown_unit_is_measured_by_the_images(factor):
    localizer = new_localizer(odometry_bias=OdometryBias(scale=1.0))
    errors, distances = image_errors([0.1 / ERRORS.length_m] * 200, ERRORS, rng=RNG(1)), []
    for i, error in enumerate(errors):
        true = Poses.exp(np.array([0.1 * i, 0, 0, 0, 0, 0]))
        estimate = localizer.update(seen_at(true @ Poses.exp(error)), motion(factor * 0.1, 0, 0, 0, 0, 0))
        distances.append(estimate.normalized_distance)
    assert (1.0 - estimate.odometry_scale_error) * factor == pytest.approx(1.0, abs=0.1)
    assert estimate.modes[0].contains(true, 0.999)
    assert np.mean(distances[50:]) == pytest.approx(0.1 / ERRORS.length_m, rel=0.1)


def test_a_scale_error_that_changes_is_forgotten_in_its_time():
    localizer = new_localizer(odometry_bias=OdometryBias(scale=0.5, scale_time_s=100.0))
    localizer.update(seen_at(Poses.identity()), None)
    for i in range(100):
        there = Poses.exp(np.array([0.2 * (i + 1), 0, 0, 0, 0, 0]))
        found = localizer.update(seen_at(there), motion(0.1, 0, 0, 0, 0, 0, duration_s=0.01)).odometry_scale_error
    assert found == pytest.approx(-1.0, abs=0.1)
    assert localizer.predict(motion(*[0.0] * 6, duration_s=100.0)).odometry_scale_error == pytest.approx(found / np.e)


# --- gaps -----------------------------------------------------------------------------------------


def test_without_odometry_the_belief_widens_by_the_stated_motion_and_keeps_its_hypotheses():
    localizer = new_localizer(gap=GapConfig(speed_m_per_s=2.0, turn_rad_per_s=0.1))
    before = localizer.update(seen_at(lifted(Poses.identity(), (0.0, 30.0)), (0.6, 0.4)), None)
    after = localizer.update(PosePosterior.uninformative(), None, elapsed_s=1.5)
    assert len(after.particles) == len(before.particles) == 2
    np.testing.assert_allclose(after.log_weights, before.log_weights)
    np.testing.assert_allclose(after.particles.translation, before.particles.translation)
    grown = np.diag([3.0**2] * 3 + [0.15**2] * 3)  # less what the velocity changed within 1.5 s
    np.testing.assert_allclose(after.covariances, before.covariances + 0.91 * grown, rtol=0.01, atol=1e-3)


@pytest.mark.parametrize("steps", [1, 7, 60])
def test_a_gap_is_as_wide_however_often_it_is_asked_about(steps):
    localizer = new_localizer()
    localizer.update(seen_at(Poses.identity(1), std=[1e-3] * 6), None)
    for _ in range(steps):
        estimate = localizer.predict(None, elapsed_s=2.0 / steps)
    speed = localizer.config.gap.speed_m_per_s
    assert np.sqrt(estimate.covariances[0, 0, 0]) == pytest.approx(0.94 * 2.0 * speed, rel=0.01)


def test_images_alone_follow_a_velocity_that_no_odometry_reports():
    """One metre a second and 30 images a second: each of them shows 3 cm of motion, in 7 cm of noise."""
    localizer, rng, distances = new_localizer(), RNG(0), []
    speed_m, error = 1.0, image_errors([1 / 15] * 300, ERRORS, rng=RNG(1))
    del rng
    for i in range(300):
        true = Poses.exp(np.array([speed_m * i / 30, 0, 0, 0, 0, 0]))
        estimate = localizer.update(seen_at(true @ Poses.exp(error[i])), None, elapsed_s=1 / 30)
        found = estimate.modes[0].world_from_camera.translation[0] - true.translation[0]
        distances.append(found / np.sqrt(estimate.modes[0].covariance[0, 0]))
    assert abs(np.mean(distances[60:])) < 1.0  # without lag
    assert np.square(distances[60:]).mean() < 2.0


@pytest.mark.parametrize("hz", [3, 30])
def test_images_alone_of_a_standing_camera_buy_no_certainty_about_the_place(hz):
    localizer, noise = new_localizer(), replace(ERRORS, weight_power=0.5)
    errors, weights = image_errors([0.0] * 10 * hz, ERRORS, rng=RNG(1)), []
    for error in errors:
        seen = seen_at(lifted(Poses.exp(error), (0.0, 5.0)), (0.6, 0.4), noise=noise)
        estimate = localizer.update(seen, None, elapsed_s=1 / hz)
        weights.append(weight_near(estimate, (0.0, 0.0, 0.0)))
    assert weights[0] == pytest.approx(0.57, abs=0.05)
    assert max(weights) < weights[0] + 0.1
    assert estimate.status == "ambiguous"


def test_images_alone_of_a_walking_camera_decide_by_what_they_show():
    localizer, noise = new_localizer(), replace(ERRORS, weight_power=0.5)
    errors = image_errors([0.1 / 0.5] * 100, ERRORS, rng=RNG(1))
    for i, error in enumerate(errors):
        there = Poses.exp(np.array([0.1 * i, 0, 0, 0, 0, 0])) @ Poses.exp(error)
        heights = (0.0, 5.0) if i < 50 else (0.0,)  # from then on only one place looks like it
        seen = seen_at(lifted(there, heights), (0.5, 0.5)[: len(heights)], noise=noise)
        estimate = localizer.update(seen, None, elapsed_s=0.1)
    assert estimate.status == "converged"


def test_a_view_is_new_after_a_gap_longer_than_a_velocity_lasts_however_often_it_is_asked_about():
    for steps in (1, 40):
        localizer = new_localizer()
        localizer.update(seen_at(Poses.identity(1)), None)
        for _ in range(steps):
            localizer.predict(None, elapsed_s=6.0 / steps)
        assert localizer.update(seen_at(Poses.identity(1)), None).novelty == 1.0


def test_the_drift_of_odometry_is_remembered_across_a_gap():
    bias = OdometryBias(scale=0.0, drift=(0.1,) * 3 + (0.01,) * 3, time_s=1e6)
    localizer = ParticleLocalizer(None, LocalizerConfig(odometry_bias=bias), rng=np.random.default_rng(0))
    moved = motion(0.2, 0, 0, 0, 0, 0, std=[1e-3] * 6)
    for i in range(100):  # it goes ahead by a tenth of a metre less each second than odometry reports
        seen = Poses.exp(np.array([[0.19 * i, 0, 0, 0, 0, 0]]))
        localizer.update(seen_at(seen, std=[0.01] * 6), moved if i else None)
    learned = localizer.belief.hypotheses.mean[0, 1]
    assert learned > 0.5  # of 0.1 m/s
    localizer.update(PosePosterior.uninformative(), None, elapsed_s=1.0)
    assert abs(localizer.belief.hypotheses.mean[0, 1]) < 0.1  # the velocity of the camera
    localizer.predict(moved)
    assert localizer.belief.hypotheses.mean[0, 1] == pytest.approx(learned, rel=0.01)


@pytest.mark.parametrize(
    "nothing", [PosePosterior.uninformative(), OUT_OF_DISTRIBUTION, seen_at(Poses.identity(1), ood_score=2.0), []]
)
def test_a_belief_that_forgets_is_lost_until_an_image_says_something(nothing):
    localizer = new_localizer(gap=GapConfig(action="forget"))
    estimates, _ = walk(localizer, 30)
    there = seen_at(Poses.exp(np.array([[40.0, 3, 0, 0, 0, 2]])))
    after = localizer.update(nothing, None, elapsed_s=1.0)
    assert after.status == "lost"
    assert after.modes[0].world_from_camera.distance(estimates[-1].modes[0].world_from_camera)[0] < 0.01
    assert after.modes[0].widest_std_m > 1.4
    assert localizer.predict(AHEAD).status == "lost"
    assert localizer.update(nothing, AHEAD).status == "lost"
    assert_same_belief(localizer.update(there, AHEAD), new_localizer().update(there, None), atol=0)
    assert localizer.update(there, STAY).status == "converged"


@pytest.mark.parametrize("elapsed_s", [-1.0, float("nan"), float("inf")])
def test_an_elapsed_time_that_is_none_is_refused(elapsed_s):
    localizer = new_localizer()
    localizer.update(seen_at(Poses.identity(1)), None)
    with pytest.raises(VaporTrackError, match="since the previous step, expected a finite time"):
        localizer.update(seen_at(Poses.identity(1)), None, elapsed_s=elapsed_s)


def test_without_odometry_a_drift_that_was_learned_moves_no_pose():
    """Drift is an error of increments; in a gap there are none."""
    bias = OdometryBias(scale=0.05, drift=(0.05,) * 3 + (0.01,) * 3)
    localizer = ParticleLocalizer(None, LocalizerConfig(odometry_bias=bias), rng=np.random.default_rng(0))
    localizer.update(seen_at(Poses.identity(1)), None)
    hypotheses = localizer.belief.hypotheses
    assert hypotheses is not None
    learned = replace(hypotheses, mean=np.full_like(hypotheses.mean, 2.0))
    localizer.belief = replace(localizer.belief, hypotheses=learned)
    localizer.predict(None, elapsed_s=10.0)
    assert np.abs(localizer.belief.hypotheses.poses.log()).max() < 1e-12
