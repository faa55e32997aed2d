from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_t

from filtering.hypotheses import birth, log_sum
from filtering.motion import OdometryBias
from filtering.se3 import Poses
from tests.helpers.simulation import ERRORS, STD, associate, lifted, seen_at

NEVER = OdometryBias(scale=0.0, relative_drift=0.0)
GAUSSIAN = replace(ERRORS, degrees_of_freedom=1e6, outlier_probability=1e-6, log_clutter_density=-100.0)


def believed(heights_m, shares, *, std=STD, noise=ERRORS):
    """Hypotheses one above the other whose uncertainty has nothing to do with the next image's errors."""
    h = birth(seen_at(lifted(Poses.identity(), heights_m), shares, std=std, noise=noise), 0, 1, NEVER, None)
    covariance = h.covariance.copy()
    covariance[:, :6, 13:] = covariance[:, 13:, :6] = 0.0
    return replace(h, covariance=covariance).with_log_weights(np.log(shares))


def at(x, *, noise=ERRORS, share=1.0, std=STD):
    return seen_at(Poses.exp(np.array([[x, 0.0, 0, 0, 0, 0]])), (share,), noise=noise, std=std)


def mass_at(hypotheses, height_m, within=1.0):
    near = np.abs(hypotheses.poses.translation[:, 2] - height_m) < within
    return hypotheses.weights[near].sum()


def test_hypotheses_go_on_with_the_weight_they_had_times_the_evidence_to_the_power_of_the_novelty():
    belief = believed([0.0, 5.0], [0.6, 0.4])
    posterior = seen_at(lifted(Poses.identity(), [0.0, 9.0]), (0.8, 0.2))
    for novelty in (0.0, 0.3, 1.0):
        result = associate(belief, posterior, 0, novelty=novelty, distance=2.0)
        expected = belief.log_weights + novelty * result.log_evidence
        for height_m, log_weight in zip((0.0, 5.0), expected, strict=True):
            near = np.abs(result.hypotheses.poses.translation[:, 2] - height_m) < 1.0
            assert log_sum(result.hypotheses.log_weights[near]) == pytest.approx(log_weight, abs=2e-3)


def test_evidence_lies_between_the_outlier_share_and_one():
    belief = believed([0.0, 5.0], [0.6, 0.4])
    result = associate(belief, seen_at(Poses.identity(1)), 0, novelty=1.0, distance=2.0)
    np.testing.assert_allclose(result.log_evidence, [0.0, np.log(0.05 / 10)], atol=1e-12)


def test_the_agreement_is_how_possible_the_belief_is_by_the_image():
    belief = believed([0.0, 5.0], [0.6, 0.4])
    assert associate(belief, seen_at(Poses.identity(1)), 0, novelty=0.0, distance=2.0).agreement == pytest.approx(0.6)
    both = seen_at(lifted(Poses.identity(), [0.0, 5.0]), (0.5, 0.5))
    assert associate(belief, both, 0, novelty=1.0, distance=2.0).agreement == pytest.approx(1.0)
    assert associate(belief, seen_at(lifted(Poses.identity(), [80.0])), 0, novelty=1.0, distance=2.0).agreement == 0.0


def test_details_finer_than_the_error_do_not_tell_one_place_from_another():
    """Two like places, of which the image puts one 15 cm off: the errors alone would make the other likelier by far."""
    belief = believed([0.0, 5.0], [0.5, 0.5])
    means = lifted(Poses.identity(), [0.0, 5.0])
    means.translation[1, 0] = 0.15
    after = associate(belief, seen_at(means, (0.5, 0.5)), 0, novelty=1.0, distance=2.0).hypotheses
    assert 0.48 < mass_at(after, 5.0) / after.weights.sum() < 0.5


def test_an_image_with_two_places_near_one_wide_hypothesis_makes_two_of_it_by_their_shares():
    belief = believed([0.0], [1.0], std=np.array([2.0, 2, 2, 0.05, 0.05, 0.05]))
    after = associate(
        belief, seen_at(lifted(Poses.identity(), [-1.0, 1.0]), (0.3, 0.6)), 0, novelty=1.0, distance=2.0
    ).hypotheses
    up, down = (mass_at(after, height_m, within=0.2) for height_m in (1.0, -1.0))
    assert up / down == pytest.approx(2.0, rel=0.01)
    assert up + down > 0.8 * after.weights.sum()


def test_a_share_of_each_hypothesis_goes_on_as_it_was_by_how_likely_the_image_is_uninformative():
    noise = replace(ERRORS, outlier_probability=0.2, log_clutter_density=9.0)
    belief = believed([0.0], [1.0], noise=noise)
    after = associate(belief, at(0.0, noise=noise), 0, novelty=0.0, distance=2.0).hypotheses
    assert len(after) == 2
    same = int(np.argmin(np.abs(after.covariance - belief.covariance[0]).sum(axis=(1, 2))))
    np.testing.assert_array_equal(after.covariance[same], belief.covariance[0])
    density = multivariate_t(shape=2 * np.diag(STD**2), df=noise.degrees_of_freedom).pdf(np.zeros(6))
    unseen = 0.2 * np.exp(9.0)
    assert after.weights[same] == pytest.approx(unseen / (unseen + 0.8 * density), rel=1e-6)
    assert 0.1 < after.weights[same] < 0.9


def test_a_place_far_off_for_its_error_pulls_less_than_a_gaussian_would_and_convinces_less():
    heavy = replace(ERRORS, degrees_of_freedom=4.0, outlier_probability=1e-9)
    belief = believed([0.0], [1.0], noise=heavy)
    pulls, stds = [], []
    for x in (0.05, 0.7):
        results = [
            associate(belief, at(x, noise=noise), 0, novelty=1.0, distance=2.0).hypotheses
            for noise in (heavy, GAUSSIAN)
        ]
        tails, gaussian = (h[np.argsort(-h.log_weights)[:1]] for h in results)
        pulls.append(tails.poses.translation[0, 0] / gaussian.poses.translation[0, 0])
        stds.append(np.sqrt(tails.covariance[0, 0, 0] / gaussian.covariance[0, 0, 0]))
    assert pulls[0] == pytest.approx(1.0, abs=0.01)
    assert stds[0] == pytest.approx(1.0, abs=0.01)
    assert pulls[1] < 0.7
    assert stds[1] > 1.2


def test_a_hypothesis_wider_than_the_map_believes_an_image_as_one_that_knows_the_map():
    """Else an image that is clear would be taken for an outlier, since nothing was expected of it anywhere."""
    belief = believed([0.0], [1.0], std=np.array([900.0, 900, 900, 2, 2, 2]))
    after = associate(belief, seen_at(lifted(Poses.identity(), [300.0])), 0, novelty=1.0, distance=2.0).hypotheses
    assert mass_at(after, 300.0) / after.weights.sum() == pytest.approx(0.95, abs=0.01)


def test_hypotheses_of_a_large_belief_see_what_each_would_see_alone():
    heights = np.linspace(-1.0, 1.0, 300)
    belief = believed(heights, np.full(300, 1 / 300))
    posterior = seen_at(lifted(Poses.identity(), [-0.8, 0.0, 0.9]), (0.2, 0.5, 0.3))
    together = associate(belief, posterior, 0, novelty=0.5, distance=1.0)
    uneven = together.hypotheses.covariance - np.swapaxes(together.hypotheses.covariance, 1, 2)
    assert not uneven.any()  # what rounding leaves would grow from image to image
    for i in (0, 150, 299):
        alone = associate(belief[i : i + 1], posterior, 0, novelty=0.5, distance=1.0)
        assert alone.log_evidence[0] == pytest.approx(together.log_evidence[i], abs=1e-12)
        for pose, covariance in zip(alone.hypotheses.poses.translation, alone.hypotheses.covariance, strict=True):
            apart = np.abs(together.hypotheses.poses.translation - pose).max(axis=1)
            same = np.abs(together.hypotheses.covariance - covariance).max(axis=(1, 2))
            assert np.maximum(apart, same).min() < 1e-12
