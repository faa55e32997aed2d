"""Whether images err more or less than modelled is found from odometry, and the filters use it."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from filtering.adaptation import ErrorScale
from filtering.cameras import Source
from filtering.config import LocalizerConfig
from filtering.kalman import KalmanConfig, KalmanLocalizer
from filtering.localizer import ParticleLocalizer
from filtering.motion import GapMotion
from filtering.se3 import Poses
from tests.helpers.modelled_walk import (
    AHEAD,
    APART,
    BIAS,
    ERRORS,
    observed,
    scale_along,
    shifted,
    simulated,
    understated,
)
from tests.helpers.simulation import lifted, motion, seen_at

pytestmark = pytest.mark.usefixtures("unchecked")


THERE = Poses.identity(1)


def compared(difference, *, noise=ERRORS, distance=APART, start=None):
    """The scale after two images, of which the second is so many standard deviations off along x."""
    scale = observed(start or ErrorScale(), seen_at(THERE, noise=noise)).predict(AHEAD, distance)
    pose = THERE @ AHEAD.previous_from_current @ Poses.exp(np.array([0.1 * difference, 0, 0, 0, 0, 0]))
    return observed(scale, seen_at(pose, noise=noise))


# --- how much larger or smaller -------------------------------------------------------------------


@pytest.mark.parametrize("per_image", [1, 3])
def test_errors_that_follow_the_model_are_taken_as_they_are(per_image):
    factors = [scale_along(simulated(seed, per_image=per_image)).factor for seed in range(3)]
    assert min(factors) > 0.75
    assert max(factors) < 1.25
    assert np.mean(factors) == pytest.approx(1.0, abs=0.15)


@pytest.mark.parametrize("per_image", [1, 3])
@pytest.mark.parametrize("factor", [0.25, 4.0])
def test_errors_of_a_quarter_and_of_four_times_the_variance_are_found_out_at_any_rate(factor, per_image):
    """As far as so many pairs tell: the model itself counts for five."""
    scales = [scale_along(understated(simulated(seed, per_image=per_image), factor)) for seed in range(3)]
    expected = [factor + (1.0 - factor) * 5.0 / scale.count for scale in scales]
    np.testing.assert_allclose([scale.factor for scale in scales], expected, rtol=0.35)
    assert np.mean([scale.factor for scale in scales]) == pytest.approx(np.mean(expected), rel=0.2)


def test_errors_are_never_taken_as_less_than_a_tenth_of_the_variance():
    assert replace(ErrorScale(), total=0.01, count=50.0).factor == 0.1
    assert replace(ErrorScale(adapts=False), total=0.01, count=50.0).factor == 1.0


def test_errors_that_become_as_modelled_again_are_taken_so_in_time():
    larger = scale_along(understated(simulated(0), 4.0))
    scale = replace(larger, place=None)
    for seed in (1, 2, 0, 1):
        scale = replace(scale_along(simulated(seed), scale), place=None)
    assert larger.factor > 3.0
    assert scale.factor < 1.4


# --- what is compared -----------------------------------------------------------------------------


def test_images_less_than_two_lengths_apart_are_not_compared():
    near, far = compared(5.0, distance=1.9), compared(5.0, distance=2.1)
    assert near.count == ErrorScale().count
    assert far.count == pytest.approx(ErrorScale().count + 1.0, abs=0.01)
    assert far.factor > near.factor == 1.0


@pytest.mark.parametrize("off", [12.0, 100.0, 1e6])
def test_outliers_and_other_places_do_not_change_it(off):
    start = compared(5.0)
    assert compared(off, start=replace(start, place=None)).factor == start.factor


def test_an_image_of_another_place_is_where_the_next_comparison_begins():
    scale = compared(90.0)
    assert scale.place.translation[0] == pytest.approx(9.5)
    following = Poses(scale.place.rotation[None], scale.place.translation[None]) @ AHEAD.previous_from_current
    later = observed(scale.predict(AHEAD, APART), seen_at(following))
    assert later.count == pytest.approx(ErrorScale().count + 1.0, abs=0.01)
    assert later.factor < 1.0


def test_a_scatter_of_outliers_among_errors_that_follow_the_model_does_not_raise_it():
    path, rng = simulated(1), np.random.default_rng(1)
    scattered = [shifted(p, 9.0 * rng.standard_normal(3)) if rng.random() < 0.2 else p for p in path.posteriors]
    assert scale_along(replace(path, posteriors=scattered)).factor < 1.25


@pytest.mark.parametrize("degrees_of_freedom", [3.0, 6.0, 1e6])
def test_heavy_tails_that_are_modelled_are_neither_larger_nor_smaller_errors(degrees_of_freedom):
    noise = replace(ERRORS, degrees_of_freedom=degrees_of_freedom, correlated_fraction=0.0)
    rng, scale, pose, factors = np.random.default_rng(2), ErrorScale(), THERE, []
    exact = motion(0.5, 0, 0, 0, 0, 0, std=np.zeros(6))
    for _ in range(400):
        pose = pose @ exact.previous_from_current
        error = (
            np.array([0.1] * 3 + [0.05] * 3)
            * rng.standard_normal(6)
            / np.sqrt(rng.chisquare(degrees_of_freedom) / degrees_of_freedom)
        )
        scale = observed(
            scale.predict(exact, APART), replace(seen_at(pose @ Poses.exp(error), noise=noise), calibrated=True)
        )
        factors.append(scale.factor)
    assert 0.8 < np.mean(factors) < 1.2


def test_of_several_places_the_one_nearest_to_what_odometry_expects_is_compared():
    scale = observed(ErrorScale(), seen_at(lifted(Poses.identity(), (0.0, 3.0)), (0.4, 0.6)))
    assert scale.place.translation[2] == pytest.approx(3.0)  # the heaviest begins
    ahead = AHEAD.previous_from_current
    scale = observed(scale.predict(AHEAD, APART), seen_at(lifted(ahead, (0.0, 3.1, 6.0)), (0.8, 0.1, 0.1)))
    assert scale.count == pytest.approx(ErrorScale().count + 1.0, abs=0.01)
    assert scale.place.translation[2] == pytest.approx(3.1)
    assert scale.factor < 1.0


def test_odometry_that_knows_little_of_the_way_raises_nothing():
    vague = motion(0.5, 0, 0, 0, 0, 0, std=np.full(6, 3.0))
    scale = observed(ErrorScale(), seen_at(THERE)).predict(vague, APART)
    assert observed(scale, seen_at(THERE @ Poses.exp(np.array([0.9, 0, 0, 0, 0, 0])))).factor == pytest.approx(
        1.0, abs=0.01
    )


def familiar_to(power_of_growth, *, noise=ERRORS):
    return replace(seen_at(THERE, noise=noise), growth=power_of_growth)


# --- scores of recent images ---------------------------------------------------------


@pytest.mark.parametrize("per_length", [1, 10])
def test_what_images_tell_is_followed_over_five_lengths_at_any_rate(per_length):
    scale = ErrorScale()
    for _ in range(5 * per_length):
        scale = observed(scale, familiar_to(0.25), 1.0 / per_length)
    assert scale.information == pytest.approx(4.0 - 3.0 / np.e)
    standing = scale
    for _ in range(50):
        standing = observed(standing, familiar_to(9.0), 0.0)
    assert standing.information == scale.information


def test_of_images_of_different_growth_the_harmonic_mean_counts():
    """One that tells much among others that tell little: what they tell adds up, not their variances."""
    scale = ErrorScale()
    for i in range(2000):
        scale = observed(scale, familiar_to((0.5, 8.0)[i % 2]), 0.05)
    assert 1.0 / scale.information == pytest.approx(1.0 / np.mean([2.0, 0.125]), rel=0.01)


def test_all_errors_that_the_model_states_are_multiplied_and_the_least_follow_what_images_tell():
    scale = replace(ErrorScale(), total=40.0, count=10.0, information=0.5)
    applied = scale.applied(ERRORS)
    assert applied.constant_fraction == pytest.approx(2.0 * ERRORS.constant_fraction)
    assert replace(applied, constant_fraction=ERRORS.constant_fraction) == ERRORS.inflated(4.0)
    np.testing.assert_allclose(
        applied.constant_covariance(np.zeros((6, 6))), 8.0 * ERRORS.constant_covariance(np.zeros((6, 6)))
    )
    assert ErrorScale().applied(ERRORS) == ERRORS.inflated(1.0)
    nothing = replace(ErrorScale(), information=0.0).applied(replace(ERRORS, constant_fraction=100.0))
    assert nothing.constant_fraction == 1e3  # the most that a model may state


def test_an_inflated_posterior_has_the_same_places_of_larger_errors():
    posterior = seen_at(lifted(Poses.identity(), (0.0, 3.0)), (0.3, 0.7), ood_score=0.4)
    inflated = posterior.inflated(4.0)
    np.testing.assert_allclose(inflated.covariances, 4.0 * posterior.covariances)
    np.testing.assert_allclose(inflated.factors, 2.0 * posterior.factors)
    noise, samples = posterior.noise, np.diag([0.3, 0.2, 0.1, 0.1, 0.2, 0.3])[None]
    np.testing.assert_allclose(inflated.noise.covariance(samples), 4.0 * noise.covariance(samples))
    np.testing.assert_allclose(inflated.noise.typical_std, 2.0 * np.array(noise.typical_std))
    same = {name: getattr(noise, name) for name in ("spread", "noise_floor", "typical_std")}
    assert replace(inflated.noise, **same) == noise
    assert inflated.means is posterior.means
    assert inflated.samples is posterior.samples
    assert (inflated.weights == posterior.weights).all()
    assert inflated.ood_score == 0.4
    assert posterior.inflated(1.0) is posterior


pytestmark = pytest.mark.usefixtures("unchecked")


NEVER_CARRIED_OFF = LocalizerConfig(birth_rate=0.0, max_birth_rate=0.0, odometry_failures_per_s=0.0, odometry_bias=BIAS)


def filtered(path):
    localizer = ParticleLocalizer(None, NEVER_CARRIED_OFF, rng=np.random.default_rng(0))
    return [
        localizer.update(posterior, odometry).modes[0]
        for posterior, odometry in zip(path.posteriors, path.odometry, strict=True)
    ]


def followed(path):
    kalman = KalmanLocalizer(KalmanConfig(odometry_bias=BIAS))
    return [
        kalman.update(posterior, odometry) for posterior, odometry in zip(path.posteriors, path.odometry, strict=True)
    ]


def regions(localize, paths, probability, monkeypatch):
    """How often regions hold the truth, and their mean widths, with and without adaptation."""
    found = []
    for adapts in (True, False):
        with monkeypatch.context() as patched:
            if not adapts:
                patched.setattr(ErrorScale, "factor", 1.0)
            modes = [mode for path in paths for mode in localize(path)[150::5]]
        truth = Poses.concatenate([path.truth[150::5] for path in paths])
        error = (Poses.stack([mode.world_from_camera for mode in modes]).inverse() @ truth).log()
        squared = np.einsum("ni,nij,nj->n", error, np.linalg.inv([mode.covariance for mode in modes]), error)
        held = (squared < chi2.ppf(probability, 6)).mean()
        found.append((held, np.mean([mode.widest_std_m for mode in modes])))
    return found


@pytest.mark.parametrize("localize", [filtered, followed])
def test_regions_grow_with_the_errors_and_hold_the_truth_more_often(localize, monkeypatch):
    paths = [understated(simulated(seed), 4.0) for seed in range(2)]
    (held, width), (held_without, width_without) = regions(localize, paths, 0.9, monkeypatch)
    assert held > 0.75
    assert held_without < held - 0.2
    assert width > 1.1 * width_without


def test_a_gap_forgets_the_place_compared_with_and_keeps_what_was_found():
    onward = motion(1.0, 0, 0, 0, 0, 0, std=np.zeros(6))  # two lengths
    source = Source.first_seen(ERRORS, 0, unknown=0.0, adapts=True).observe(seen_at(THERE))
    there = seen_at(THERE @ onward.previous_from_current @ Poses.exp(np.array([0.5, 0, 0, 0, 0, 0])))
    source = source.predict(onward)[0].observe(there)
    assert source.scale.factor > 1.0
    after, _ = source.across_gap(GapMotion(Poses.identity(), 0.1, 0.1))
    again = seen_at(there.means @ onward.previous_from_current)
    compared, kept = (each.predict(onward)[0].observe(again).scale for each in (source, after))
    assert compared.count > source.scale.count
    assert (kept.count, kept.factor) == (source.scale.count, source.scale.factor)
