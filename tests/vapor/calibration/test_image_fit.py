"""The fit of an MeasurementNoise, on posteriors that err as one says."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from filtering.measurement_noise import MeasurementNoise
from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from tests.helpers.erring_posteriors import TRUE, UNIT, anywhere, fit, fitted, posteriors, simulated, student, walk
from vapor.calibration.error_correlation import Travel
from vapor.calibration.image_errors import fit_errors
from vapor.calibration.places import Observations
from vapor.checkpoints.scene_scale import default_errors, log_clutter_density, scene_extent

pytestmark = pytest.mark.usefixtures("unchecked")


def test_spread_noise_floor_tail_and_outliers_of_known_errors_are_found():
    noise = fitted().noise
    assert noise.spread == pytest.approx(TRUE.spread, rel=0.35)
    np.testing.assert_allclose(noise.noise_floor, TRUE.noise_floor, rtol=0.3)
    assert 3.0 < noise.degrees_of_freedom < 10.0
    assert noise.outlier_probability == pytest.approx(TRUE.outlier_probability, abs=0.05)  # three standard deviations
    spread = 0.06 * UNIT * np.sqrt(TRUE.spread)
    np.testing.assert_allclose(noise.typical_std, np.hypot(spread, TRUE.noise_floor), rtol=0.25)
    assert noise.log_clutter_density == log_clutter_density(simulated()[1])
    assert noise.possible_fraction == 0.05
    assert 0.1 < noise.constant_fraction < 0.2  # a little more than by default: the images are many
    assert fitted().effective_images == len(simulated()[1])


def test_regions_of_single_images_hold_as_many_true_poses_as_they_say_but_for_outliers():
    right = np.array([0.5, 0.9, 0.95]) * (1 - TRUE.outlier_probability)
    np.testing.assert_allclose(fitted().coverage, right, atol=0.08)


def test_what_changed_is_told_with_its_gain():
    image, correlated = fitted().changes
    for change in (image, correlated):
        assert change.after == {name: getattr(fitted().noise, name) for name in change.before}
    assert image.before["degrees_of_freedom"] == MeasurementNoise().degrees_of_freedom
    assert image.gain is not None
    assert image.gain > 0.5
    again = fit(*simulated(100), before=fitted(100).noise).changes[0]
    assert again.gain == pytest.approx(0.0, abs=1e-6)


def test_the_fit_is_the_same_in_a_scene_thirty_times_as_large():
    samples, truth = simulated(100)
    larger = [Poses(poses.rotation, 30.0 * poses.translation) for poses in (*samples, truth)]
    found, expected = fit(larger[:-1], larger[-1]).noise, fitted(100).noise.scaled(30.0)
    for name in (
        "radius_m",
        "spread",
        "degrees_of_freedom",
        "outlier_probability",
        "length_m",
        "correlated_fraction",
        "log_clutter_density",
    ):
        assert getattr(found, name) == pytest.approx(getattr(expected, name), rel=0.02), name
    np.testing.assert_allclose(found.noise_floor, expected.noise_floor, rtol=0.02)
    np.testing.assert_allclose(found.typical_std, expected.typical_std, rtol=0.02)


@pytest.mark.usefixtures("widest_places")
def test_a_posterior_that_cannot_decide_between_two_places_is_measured_by_the_right_one():
    samples, truth = simulated()
    elsewhere = Poses.exp(np.array([4.0, 1.0, 0.0, 0.0, 0.0, 1.5]))
    half = len(samples[0]) // 2
    both = [Poses.concatenate([poses[:half], (elsewhere @ poses)[half:]]) for poses in samples]
    found = fit(both, truth)
    np.testing.assert_allclose(found.noise.noise_floor, fitted().noise.noise_floor, rtol=0.2)
    assert found.noise.outlier_probability == pytest.approx(TRUE.outlier_probability, abs=0.05)
    np.testing.assert_allclose(found.coverage, fitted().coverage, atol=0.04)


# --- errors that grow with the score of an image ----------------------------------------------


@cache
def graded(power: float, count: int = 240):
    """Held-out images of scores .1 to .9 and some trained on at .1: standard deviations go with a power of the score.

    At a score of a half they are those of `TRUE`.
    """
    rng = np.random.default_rng(6)
    score = rng.uniform(0.1, 0.9, count)
    of_trained = np.full(count // 2, 0.1)
    seen = []
    for scores in (score, of_trained):
        truth = anywhere(len(scores), rng=rng)
        normal = student(len(scores), TRUE.degrees_of_freedom, rng=rng) * ((scores / 0.5) ** power)[:, None]
        seen.append(Observations(posteriors(truth, TRUE, normal, rng=rng, num_samples=40), truth, scores))
    return seen


AT_A_HALF = np.hypot(0.06 * UNIT * np.sqrt(TRUE.spread), TRUE.noise_floor)


def fit_graded(power: float, trained: bool = True, before: MeasurementNoise | None = None) -> MeasurementNoise:
    held_out, trained_on = graded(power)
    return fit(
        held_out.samples,
        held_out.truth,
        before=before,
        score=held_out.score,
        trained=trained_on if trained else None,
    ).noise


@pytest.mark.usefixtures("widest_places")
def test_errors_that_grow_with_the_score_are_found_to_with_their_size_at_its_median():
    noise = fit_graded(1.0)
    assert noise.ood_power == pytest.approx(1.0, abs=0.25)
    assert noise.typical_ood_score == pytest.approx(np.median(graded(1.0)[0].score))
    np.testing.assert_allclose(noise.typical_std, AT_A_HALF, rtol=0.25)


@pytest.mark.usefixtures("widest_places")
def test_errors_that_do_not_depend_on_the_score_do_not_grow():
    assert fit_graded(0.0).ood_power <= 0.125


@pytest.mark.usefixtures("widest_places")
def test_without_images_trained_on_the_power_stays_and_the_errors_follow_it():
    before = replace(default_errors(graded(1.0)[0].truth), ood_power=1.0, typical_ood_score=0.25)
    noise = fit_graded(1.0, trained=False, before=before)
    assert (noise.ood_power, noise.typical_ood_score) == (1.0, 0.25)
    np.testing.assert_allclose(noise.typical_std, 0.5 * AT_A_HALF, rtol=0.25)


@pytest.mark.usefixtures("widest_places")
def test_where_nobody_knows_how_unfamiliar_images_are_nothing_grows():
    held_out, trained = (replace(seen, score=None) for seen in graded(0.0))
    assert fit(held_out.samples, held_out.truth, trained=trained).noise.ood_power == 0.0


# --- little, flat and bad data ---------------------------------------------------------------------


def usable(noise: MeasurementNoise, samples) -> bool:
    posterior = PosePosterior.from_samples(samples, noise)
    return bool(np.isfinite(posterior.covariances).all()) and len(posterior.weights) > 0


def test_sixty_images_of_one_pass_are_worth_few_and_the_fit_is_cautious():
    rng = np.random.default_rng(3)
    truth = walk(60, 0.05, rng=rng)
    noise = replace(TRUE, outlier_probability=1e-9, noise_floor=(0.05, 0.2, 0.05, 0.02, 0.02, 0.02))
    samples = posteriors(truth, noise, np.tile(rng.standard_normal(6), (60, 1)), rng=rng)
    scene = Poses.concatenate([truth, anywhere(100, rng=rng)])
    travel = Travel.along(truth, np.zeros(60, np.int64))
    found = fit_errors(Observations(samples, truth), travel, scene, default_errors(scene))
    assert found.effective_images < 10
    lengths, angles = np.array(found.noise.noise_floor[:3]), np.array(found.noise.noise_floor[3:])
    assert lengths.max() < 3 * lengths.min()
    assert angles.max() < 3 * angles.min()
    assert usable(found.noise, samples[0])


@pytest.mark.usefixtures("widest_places")
def test_images_that_are_all_wrong_leave_nothing_to_be_believed():
    rng = np.random.default_rng(4)
    truth = anywhere(100, rng=rng)
    samples = posteriors(truth, replace(TRUE, outlier_probability=0.999999), rng.standard_normal((100, 6)), rng=rng)
    found = fit(samples, truth).noise
    assert found.outlier_probability > 0.4 or min(found.typical_std[:3]) > 0.05 * scene_extent(truth)
    assert usable(found, samples[0])


@pytest.mark.usefixtures("widest_places")
@pytest.mark.parametrize("num_samples", [150, 1])
def test_cameras_that_move_in_a_plane_get_positive_covariances(num_samples):
    rng = np.random.default_rng(5)
    turned = np.zeros((80, 6))
    turned[:, 5] = rng.uniform(-3, 3, 80)
    truth = Poses(Poses.exp(turned).rotation, rng.uniform(0, 1, (80, 3)) * [10, 6, 0])
    flat = np.array([0.1, 0.1, 0, 0, 0, 0.05])
    offsets = truth @ Poses.exp(rng.standard_normal((80, 6)) * flat)
    samples = [offsets[i] @ Poses.exp(rng.standard_normal((num_samples, 6)) * flat) for i in range(80)]
    found = fit(samples, truth).noise
    assert usable(found, samples[0])
    assert 0.0 < found.noise_floor[2] < 0.2
    assert 0.05 < found.typical_std[0] < 0.3


def test_cameras_that_all_stand_at_one_place_are_no_division_by_zero():
    truth = Poses.identity(60)
    samples = [Poses.identity(20)] * 60
    assert usable(fit(samples, truth).noise, samples[0])
