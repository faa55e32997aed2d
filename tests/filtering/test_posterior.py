from dataclasses import replace

import numpy as np
import pytest

from filtering.errors import VaporTrackError
from filtering.posterior import PosePosterior, find_places
from filtering.se3 import Poses
from tests.helpers.simulation import ERRORS, STD, seen_at

RADIUS_M, RADIUS_RAD = ERRORS.radius_m, ERRORS.radius_rad
NARROW = np.array([0.05] * 3 + [0.08] * 3)


def cluster(centre, count, *, seed, std=NARROW):
    return Poses.exp(np.array(centre, np.float64)) @ Poses.exp(
        np.random.default_rng(seed).standard_normal((count, 6)) * std
    )


def two_clusters():
    """700 samples at one place and 300 at another, ten radii away, in a mixed order; and which is of which."""
    first = cluster([0, 0, 0, 0, 0, 0], 700, seed=0)
    second = cluster([10 * RADIUS_M, 0, 0, 0, 0, 1.0], 300, seed=1)
    order = np.random.default_rng(2).permutation(1000)
    return Poses.concatenate([first, second])[order], order >= 700


# --- places -----------------------------------------------------------------------------------------


def test_two_clusters_ten_radii_apart_are_two_places_with_their_shares_means_and_covariances():
    samples, second = two_clusters()
    posterior = PosePosterior.from_samples(samples, replace(ERRORS, spread=2.0))
    assert len(posterior.weights) == 2
    for own, k in ((~second, int(np.argmax(posterior.weights))), (second, int(np.argmin(posterior.weights)))):
        assert posterior.weights[k] == pytest.approx(own.mean(), abs=0.01)  # a few stray beyond a radius
        mean = samples[own].mean()
        assert (np.abs((mean.inverse() @ posterior.means[k]).log()) < 0.005).all()
        tangent = (mean.inverse() @ samples[own]).log()
        expected = 2.0 * np.cov(tangent.T, bias=True) + np.diag(np.square(ERRORS.noise_floor))
        scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
        np.testing.assert_allclose(posterior.covariances[k] / scale, expected / scale, atol=0.06)


def test_two_clusters_at_one_spot_that_look_apart_are_two_places():
    samples = Poses.concatenate(
        [cluster([0, 0, 0, 0, 0, 0], 500, seed=0), cluster([0, 0, 0, 0, 0, np.pi], 500, seed=1)]
    )
    label, count = find_places(samples, RADIUS_M, RADIUS_RAD)
    assert count == 2
    assert label[:500].max() == label[:500].min() != label[500:].max() == label[500:].min()


def test_far_strays_are_no_place_and_count_against_the_shares():
    rng = np.random.default_rng(3)
    strays = Poses.exp(np.concatenate([rng.uniform(20, 5000, (50, 3)), rng.uniform(-1, 1, (50, 3))], axis=1))
    samples = Poses.concatenate([cluster([0, 0, 0, 0, 0, 0], 950, seed=0), strays])
    label, count = find_places(samples, RADIUS_M, RADIUS_RAD)
    assert count == 1
    assert (label[950:] == -1).all()
    posterior = PosePosterior.from_samples(samples, ERRORS)
    assert posterior.weights.sum() == pytest.approx(0.95, abs=0.005)
    assert np.abs(posterior.means.translation).max() < 0.01


def test_two_places_inside_one_and_a_half_radii_are_one_and_beyond_three_are_two():
    for apart, expected in ((0.8, 1), (3.5, 2)):
        tight = 0.2 * NARROW
        samples = Poses.concatenate(
            [cluster([0] * 6, 500, seed=0, std=tight), cluster([apart * RADIUS_M] + [0] * 5, 500, seed=1, std=tight)]
        )
        assert find_places(samples, RADIUS_M, RADIUS_RAD)[1] == expected


@pytest.mark.parametrize("count", [1, 2, 1000])
def test_equal_samples_are_one_place_as_wide_as_the_noise_floor(count):
    pose = Poses.exp(np.array([100.0, -50, 3, 0.1, 0.2, 3.0]))
    samples = Poses(np.repeat(pose.rotation[None], count, 0), np.repeat(pose.translation[None], count, 0))
    posterior = PosePosterior.from_samples(samples, ERRORS)
    assert posterior.weights.tolist() == [1.0]
    assert posterior.means[0].distance(pose)[0] < 1e-9
    np.testing.assert_allclose(posterior.covariances[0], np.diag(np.square(ERRORS.noise_floor)), atol=1e-12)


@pytest.mark.parametrize("offset", [0.0, 1e4])
@pytest.mark.parametrize("factor", [0.125, 32.0, 1024.0])
def test_places_do_not_depend_on_the_unit_of_length_or_where_the_map_begins(factor, offset):
    samples, _ = two_clusters()
    moved = Poses(samples.rotation, factor * samples.translation + offset)
    (label, count), expected = (
        find_places(moved, factor * RADIUS_M, RADIUS_RAD),
        find_places(samples, RADIUS_M, RADIUS_RAD),
    )
    assert count == expected[1]
    assert (label != expected[0]).mean() < 0.003  # single precision moves a sample or two across the border


def test_places_kilometres_apart_are_told_from_their_neighbours():
    """Squared distances of places far from the middle are the small difference of large numbers."""
    near = [cluster([x, 0, 0, 0, 0, 0], 250, seed=seed) for seed, x in enumerate((-9000.0, -8998.0, 9000.0, 9002.0))]
    label, count = find_places(Poses.concatenate(near), RADIUS_M, RADIUS_RAD)
    assert count == 4
    for k in range(4):
        own = label[250 * k : 250 * (k + 1)]
        assert (own == own[0]).mean() > 0.98


def test_shares_never_exceed_one_and_every_place_has_samples():
    rng = np.random.default_rng(5)
    for _ in range(20):
        samples = Poses.exp(rng.uniform(-2, 2, (rng.integers(1, 400), 6)) * rng.uniform(0.01, 3))
        label, count = find_places(samples, RADIUS_M, RADIUS_RAD)
        assert set(label) - {-1} == set(range(count))
        PosePosterior.from_samples(samples, ERRORS)


# --- other posteriors -------------------------------------------------------------------------------


def test_estimates_of_several_methods_are_equally_likely_places_with_the_stated_stds():
    estimates = Poses.exp(np.array([[0.0, 0, 0, 0, 0, 0], [5, 0, 0, 0, 0, 1]]))
    posterior = PosePosterior.from_estimates(estimates, np.array([0.1, 0.2]), 0.05, ERRORS)
    np.testing.assert_allclose(posterior.weights, 0.5)
    np.testing.assert_allclose(posterior.covariances[1], np.diag([0.04] * 3 + [0.0025] * 3))
    np.testing.assert_array_equal(posterior.means.translation, estimates.translation)


def test_estimates_without_any_or_with_other_numbers_are_refused():
    with pytest.raises(VaporTrackError, match="no estimate, expected at least one"):
        PosePosterior.from_estimates(Poses.identity(0), 0.1, 0.1, ERRORS)
    weighed = PosePosterior.from_estimates(Poses.identity(2), 0.1, 0.05, ERRORS, weights=np.array([0.7, 0.1]))
    assert weighed.weights.tolist() == [0.7, 0.1]
    for wrong in ([0.7, 0.4], [-0.1, 0.5], [0.5, np.nan]):
        with pytest.raises(VaporTrackError, match="posterior: weights"):
            PosePosterior.from_estimates(Poses.identity(2), 0.1, 0.05, ERRORS, weights=np.array(wrong))
    with pytest.raises(VaporTrackError, match=r"std_rad has shape \(3,\), expected one number or \(2,\)"):
        PosePosterior.from_estimates(Poses.identity(2), 0.1, np.ones(3), ERRORS)
    for std in (0.0, float("nan")):
        with pytest.raises(VaporTrackError, match=r"singular|not finite"):
            PosePosterior.from_estimates(Poses.identity(2), std, 0.1, ERRORS)


def test_an_image_that_is_uninformative_has_no_place_and_a_foreign_one_is_uninformative_though_it_has():
    assert PosePosterior.uninformative().is_uninformative
    assert len(PosePosterior.uninformative().samples) == 0
    shown = Poses.identity(7)
    assert PosePosterior.uninformative(ERRORS, shown).samples is shown
    assert not seen_at(Poses.identity(1), ood_score=1.0).is_uninformative
    assert seen_at(Poses.identity(1), ood_score=1.01).is_uninformative


def test_a_place_with_few_samples_is_as_possible_as_one_with_many_unless_weights_are_calibrated():
    posterior = seen_at(Poses.identity(4), (0.9, 0.05, 0.009, 0.0))
    np.testing.assert_allclose(posterior.possible, [1.0, 1.0, 0.2, 0.0])
    calibrated = replace(posterior, noise=replace(posterior.noise, weight_power=1.0, possible_fraction=1e-9))
    np.testing.assert_allclose(calibrated.shares, posterior.weights / posterior.weights.sum())


def any_covariances(count=4):
    root = np.random.default_rng(0).normal(size=(count, 6, 6))
    return root @ np.swapaxes(root, 1, 2) + 0.1 * np.eye(6)


def with_covariances(covariances, noise=ERRORS):
    means = Poses.identity(len(covariances))
    return PosePosterior(means, covariances, np.full(len(covariances), 1.0 / len(covariances)), noise, means)


def test_factors_are_square_roots_of_the_covariances_symmetric_in_ordinary_errors():
    covariances, unit = any_covariances(), np.asarray(ERRORS.typical_std)
    factors = with_covariances(covariances).factors
    np.testing.assert_allclose(factors @ np.swapaxes(factors, 1, 2), covariances, atol=1e-9)
    relative = factors / unit[:, None]
    np.testing.assert_allclose(relative, np.swapaxes(relative, 1, 2), atol=1e-9)
    diagonal = np.diag(np.square(STD))[None]
    np.testing.assert_allclose(with_covariances(diagonal).factors[0], np.diag(STD / unit) * unit, atol=1e-12)


# --- images unlike the training ---------------------------------------------------------------------

GROWING = replace(ERRORS, ood_power=1.0, typical_ood_score=0.5)


def test_an_image_unlike_the_training_has_larger_errors_at_the_same_places():
    samples, _ = two_clusters()
    plain, grown = (PosePosterior.from_samples(samples, noise, ood_score=0.9) for noise in (ERRORS, GROWING))
    assert (plain.growth, grown.growth) == (1.0, pytest.approx(3.24))
    np.testing.assert_allclose(grown.covariances, 3.24 * plain.covariances)
    np.testing.assert_allclose(grown.weights, plain.weights)
    assert grown.noise == GROWING
    assert PosePosterior.from_samples(samples, GROWING, ood_score=0.1).growth == pytest.approx(0.04)
    assert PosePosterior.from_samples(samples, GROWING).growth == 1.0  # no score


def test_growth_of_variances_outlasts_another_frame_and_larger_errors():
    posterior = PosePosterior.from_samples(two_clusters()[0], GROWING, ood_score=0.9)
    assert posterior.inflated(4.0).growth == posterior.growth
    assert posterior.seen_from(Poses.exp(np.array([0.1, 0, 0, 0, 0, 0.3]))).growth == posterior.growth


def test_errors_seen_from_another_frame_are_the_same_errors():
    """Poses drawn about the camera, carried to the other frame, have the mean and covariance that it states."""
    rng = np.random.default_rng(1)
    pose = Poses.exp(np.array([[3.0, 1, 2, 0.3, -0.2, 1.0]]))
    reference_from_camera = Poses.exp(np.array([0.5, -0.3, 0.2, 0.4, 1.0, -0.7]))
    posterior = seen_at(pose)
    carried = posterior.seen_from(reference_from_camera)
    drawn = pose[[0] * 40_000] @ Poses.exp(rng.standard_normal((40_000, 6)) * STD) @ reference_from_camera.inverse()
    tangent = (carried.means[0].inverse() @ drawn).log()
    expected = carried.covariances[0]
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    np.testing.assert_allclose(np.cov(tangent.T) / scale, expected / scale, atol=0.03)  # six standard errors
    back = carried.seen_from(reference_from_camera.inverse())
    np.testing.assert_allclose(back.covariances, posterior.covariances, atol=1e-12)
    np.testing.assert_allclose(back.means.as_matrix(), posterior.means.as_matrix(), atol=1e-12)


# --- bad input --------------------------------------------------------------------------------------


def test_no_samples_and_samples_that_are_not_finite_make_no_posterior():
    with pytest.raises(VaporTrackError, match="at least one sample"):
        PosePosterior.from_samples(Poses.identity(0), ERRORS)
    samples = Poses.identity(5)
    samples.translation[3, 1] = np.nan
    with pytest.raises(VaporTrackError, match="samples 3 of 5 is not finite"):
        PosePosterior.from_samples(samples, ERRORS)


def infinite_pose():
    pose = Poses.identity(2)
    pose.translation[1, 0] = np.inf
    return pose


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"weights": np.array([0.5, -0.1])}, r"weights are \[0.5, -0.1\], expected at least 0"),
        ({"weights": np.array([0.8, 0.3])}, "1 in all"),
        ({"weights": np.array([0.5, np.nan])}, "weights 1 of 2 is not finite"),
        ({"covariances": np.stack([np.eye(6), np.diag([1.0, 1, 1, 1, 1, 0])])}, "a covariance is singular"),
        ({"covariances": np.stack([np.eye(6), np.diag([1.0, 1, 1, 1, 1, -1])])}, "has a negative eigenvalue"),
        ({"covariances": np.full((2, 6, 6), np.nan)}, "covariances 0 of 2 is not finite"),
        ({"means": infinite_pose()}, "means 1 of 2 is not finite"),
        (
            {"covariances": np.stack([np.eye(6), np.eye(6) + np.eye(6, k=2)])},
            "covariance 1 of 2 is not symmetric",
        ),
        ({"ood_score": float("nan")}, "ood_score is nan"),
        ({"ood_score": -0.1}, "ood_score is -0.1"),
    ],
)
def test_what_is_no_posterior_is_refused_with_what_is_wrong(change, message):
    good = seen_at(Poses.identity(2), (0.5, 0.5))
    with pytest.raises(VaporTrackError, match=message):
        replace(good, **change)
