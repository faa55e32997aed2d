"""What the weights of places are worth, by images whose network is right as often as it states, or is not."""

from dataclasses import replace

import numpy as np
import pytest

from filtering.measurement_noise import MeasurementNoise
from filtering.se3 import Poses
from vapor.calibration.error_correlation import Travel
from vapor.calibration.image_errors import fit_errors
from vapor.calibration.place_weights import PlaceWeights
from vapor.calibration.places import Observations
from vapor.checkpoints.scene_scale import default_errors

pytestmark = pytest.mark.usefixtures("unchecked", "widest_places")

NOISE = MeasurementNoise(radius_m=0.5, radius_rad=0.5, outlier_probability=0.05)
SAMPLES, APART_M = 40, 5.0


def seen(count: int, worth: float, seed: int = 0) -> Observations:
    """Images of two places. The odds of the true one are those of the samples to the power `worth`."""
    rng = np.random.default_rng(seed)
    first = rng.integers(4, SAMPLES - 3, count)  # samples of the first place
    odds = (first / (SAMPLES - first)) ** worth
    true_first = rng.random(count) < odds / (1.0 + odds)
    samples = []
    for number in first:
        offsets = 0.03 * rng.standard_normal((SAMPLES, 6))
        offsets[number:, 0] += APART_M
        samples.append(Poses.exp(offsets))
    truth = np.zeros((count, 6))
    truth[:, 0] = np.where(true_first, 0.0, APART_M)
    return Observations(samples, Poses.exp(truth + 0.03 * rng.standard_normal((count, 6))))


def power(observed: Observations, worth: float = 1.0) -> float:
    return PlaceWeights.of(observed, NOISE, None).fitted_power(NOISE, worth)[0]


def test_weights_that_are_probabilities_count_nearly_in_full_and_a_preference_for_nothing_not_at_all():
    assert power(seen(300, 1.0)) > 0.7
    assert 0.3 < power(seen(300, 0.5, seed=1)) < 0.6
    assert power(seen(300, 0.0, seed=2)) < 0.1
    assert power(seen(300, -1.0)) == 0.0  # a network that prefers what is wrong


def test_the_fewer_independent_images_the_less_weights_count():
    observed = seen(300, 1.0)
    powers = [power(observed, worth) for worth in (1.0, 0.05, 0.005)]
    assert powers[0] > powers[1] > powers[2]
    assert powers[2] == 0.0  # three images show nothing


def test_images_of_one_place_say_nothing_about_weights():
    one = Observations([Poses.exp(0.03 * np.random.default_rng(0).standard_normal((20, 6)))] * 50, Poses.identity(50))
    assert power(one) == 0.0


def test_the_evidence_is_that_of_the_filter():
    weights = PlaceWeights.of(seen(50, 1.0), NOISE, None)
    even, trusting = (weights.evidence(replace(NOISE, weight_power=value)) for value in (0.0, 1.0))
    assert np.exp(even) == pytest.approx(np.ones(50), abs=0.05)  # either place is possible
    heavier = trusting > -0.1
    assert 0.5 < heavier.mean() < 1.0
    assert (trusting[~heavier] < even[~heavier]).all()


def test_a_reliable_network_is_on_the_diagonal_and_one_that_guesses_is_not():
    trusted = replace(NOISE, weight_power=1.0, possible_fraction=1e-9)
    reliable, guess = (PlaceWeights.of(seen(400, worth), NOISE, None).reliability(trusted, 0.5) for worth in (1.0, 0.0))
    assert reliable.expected_error < 0.08
    assert guess.expected_error > 0.15
    highest = guess.bins[-1]
    assert highest.stated > 0.8
    assert highest.right < 0.65
    assert sum(each.images for each in guess.bins) == 400
    assert highest.effective_images == 0.5 * highest.images


def test_a_fit_divides_the_training_out_before_it_trusts_weights():
    observed = seen(300, 1.0)
    # The network has seen the second place nine times as often, and prefers it.
    biased = [
        Poses.concatenate([samples, *[samples[np.flatnonzero(samples.translation[:, 0] > 1.0)]] * 8])
        for samples in observed.samples
    ]
    trained = Poses.exp(np.repeat([[0.0] * 6, [APART_M, 0, 0, 0, 0, 0]], [20, 180], axis=0))
    scene = Poses.concatenate([trained, observed.truth])
    travel = Travel(np.arange(300), np.zeros(300), np.zeros(300))
    plain, divided = (
        fit_errors(Observations(biased, observed.truth), travel, scene, default_errors(scene), training_poses=poses)
        for poses in (None, trained)
    )
    assert divided.weight_power > plain.weight_power + 0.2
    assert divided.noise.weight_power == 0.4 * divided.weight_power  # of a walk less is known by single images
