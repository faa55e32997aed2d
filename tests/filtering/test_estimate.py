import numpy as np
import pytest

from filtering.estimate import Estimate, ModeConfig, describe_modes, posterior_modes
from filtering.hypotheses import birth
from filtering.motion import OdometryBias
from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from tests.helpers.simulation import ERRORS, STD, lifted, seen_at

CONFIG = ModeConfig()


def believed(poses, weights):
    h = birth(seen_at(poses, np.full(len(poses), 1 / len(poses))), 0, 1, OdometryBias(), None)
    return h.with_log_weights(np.log(weights))


def estimate_of(poses, weights, std=STD):
    covariances = np.repeat(np.diag(np.square(std))[None], len(poses), 0)
    return Estimate((), "ambiguous", poses, covariances, np.log(weights), 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)


def test_hypotheses_of_one_place_are_one_mode_with_their_mean_and_covariance():
    rng = np.random.default_rng(0)
    pose = Poses.exp(np.array([3.0, 1, 2, 0.1, 0.2, 1.0]))
    poses = pose @ Poses.exp(0.05 * rng.standard_normal((30, 6)))
    weights = rng.dirichlet(np.ones(30))
    (mode,) = describe_modes(believed(poses, weights), ERRORS, CONFIG)
    tangent = (mode.world_from_camera.inverse() @ poses).log()
    np.testing.assert_allclose(weights @ tangent, 0.0, atol=1e-3)
    expected = (
        np.cov(tangent.T, aweights=weights, bias=True) + np.diag(STD**2) + ERRORS.constant_covariance(np.zeros((6, 6)))
    )
    np.testing.assert_allclose(mode.covariance, expected, atol=1e-4)
    assert mode.weight == pytest.approx(1.0)


def test_places_a_storey_apart_are_modes_by_falling_weight_whose_covariance_does_not_bridge_them():
    modes = describe_modes(believed(lifted(Poses.identity(), [0.0, 3, 6]), [0.2, 0.5, 0.3]), ERRORS, CONFIG)
    assert [mode.weight for mode in modes] == pytest.approx([0.5, 0.3, 0.2])
    assert [mode.world_from_camera.translation[2] for mode in modes] == pytest.approx([3, 6, 0])
    assert all(mode.widest_std_m < 0.15 for mode in modes)


def test_two_ways_of_looking_from_one_spot_are_two_modes():
    poses = Poses.exp(np.array([[0.0, 0, 0, 0, 0, 0], [0, 0, 0, 0, 0, 1.5]]))
    assert len(describe_modes(believed(poses, [0.5, 0.5]), ERRORS, CONFIG)) == 2


def test_what_makes_a_place_scales_with_how_images_err():
    poses, weights = lifted(Poses.identity(), [0.0, 3]), [0.6, 0.4]
    assert len(describe_modes(believed(poses, weights), ERRORS, CONFIG)) == 2
    assert len(describe_modes(believed(poses, weights), ERRORS.scaled(10.0), CONFIG)) == 1


def test_light_modes_are_not_reported_and_never_more_than_asked():
    poses, weights = lifted(Poses.identity(), 3.0 * np.arange(6)), [0.5, 0.2, 0.15, 0.1, 0.04, 0.01]
    assert len(describe_modes(believed(poses, weights), ERRORS, CONFIG)) == 5
    assert len(describe_modes(believed(poses, weights), ERRORS, ModeConfig(max_modes=2))) == 2


def test_a_belief_spread_thinly_still_has_a_mode():
    count = 100
    poses = lifted(Poses.identity(), 3.0 * np.arange(count))
    modes = describe_modes(believed(poses, np.full(count, 1 / count)), ERRORS, CONFIG)
    assert len(modes) >= 1
    assert modes[0].weight == pytest.approx(1 / count)


def test_a_zero_weight_hypothesis_changes_no_mode():
    with np.errstate(divide="ignore"):
        h = believed(lifted(Poses.identity(), [0.0, 0.1]), [1.0, 0.0])
    (mode,) = describe_modes(h, ERRORS, CONFIG)
    np.testing.assert_allclose(mode.covariance, np.diag(STD**2) + ERRORS.constant_covariance(np.zeros((6, 6))))


def test_the_modes_of_an_image_are_its_places_by_falling_share_of_the_whole():
    modes = posterior_modes(seen_at(lifted(Poses.identity(), [0.0, 3, 6]), (0.2, 0.4, 0.2)))
    assert [mode.weight for mode in modes] == pytest.approx([0.5, 0.25, 0.25])
    assert modes[0].world_from_camera.translation[2] == 3.0
    assert posterior_modes(PosePosterior.uninformative()) == ()


def test_the_effective_sample_size_spans_one_to_n():
    poses = lifted(Poses.identity(), np.arange(8.0))
    assert estimate_of(poses, np.full(8, 1 / 8)).effective_sample_size == pytest.approx(8.0)
    assert estimate_of(poses, [1 - 7e-9] + [1e-9] * 7).effective_sample_size == pytest.approx(1.0)


def test_a_cloud_has_the_shares_and_the_covariance_of_the_belief_and_is_the_same_each_time():
    std = np.array([0.3, 0.1, 0.2, 0.05, 0.1, 0.08])
    estimate = estimate_of(lifted(Poses.identity(), [0.0, 50.0]), [0.7, 0.3], std)
    cloud = estimate.cloud(10_000)
    up = cloud.translation[:, 2] > 25.0
    assert up.mean() == pytest.approx(0.3, abs=1e-3)
    np.testing.assert_allclose(cloud[~up].log().std(axis=0), std, rtol=0.04)
    np.testing.assert_array_equal(estimate.cloud(10_000).translation, cloud.translation)
    assert len(estimate.cloud(1)) == 1
