import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.special import logsumexp

from filtering.errors import VaporTrackError
from filtering.posterior import KernelDensity, LikelihoodModel, PosteriorSamples
from filtering.se3 import Poses


def cloud(seed, n, scale=1.0):
    return Poses.exp(scale * np.random.default_rng(seed).uniform(-1, 1, (n, 6)))


def shifted(poses, x, y=0.0):
    return Poses(poses.rotation, poses.translation + np.array([x, y, 0.0]))


@pytest.mark.parametrize("bandwidths", [(0.3, 0.5), (0.5, 1.5)])
def test_density_integrates_to_one_over_space_and_rotations(bandwidths):
    density = KernelDensity(cloud(0, 5, 0.3), *bandwidths)
    n, half = 400_000, 3.0
    rotation = Rotation.random(n, rng=np.random.default_rng(1)).as_matrix()
    translation = np.random.default_rng(2).uniform(-half, half, (n, 3))
    volume = (2 * half) ** 3 * 8 * np.pi**2
    integral = volume * np.exp(density.log_density(Poses(rotation, translation))).mean()
    assert integral == pytest.approx(1.0, abs=0.05)  # Monte Carlo, standard error about 0.015


@pytest.mark.parametrize("places", [1, 5])
def test_log_density_agrees_with_the_kernels_summed_one_by_one(places):
    """Also where most kernels are out of reach, and where the last queries lie between places."""
    centres = Poses.concatenate([shifted(cloud(3, 150), 3.0 * k) for k in range(places)])
    between = shifted(cloud(5, 40), 1.5, 3.0)
    queries = Poses.concatenate([*[shifted(cloud(4, 100), 3.0 * k) for k in range(places)], between])
    density = KernelDensity(centres, 0.2, 0.3)
    d2 = np.sum((queries.translation[:, None] - centres.translation[None]) ** 2, -1) / 0.2**2
    trace = np.einsum("aij,bij->ab", queries.rotation, centres.rotation)
    log_kernel = -0.5 * d2 + ((trace - 1) / 2 - 1) / 0.3**2
    expected = logsumexp(log_kernel, axis=1) - np.log(len(centres)) - density.log_normaliser
    assert expected.min() < -30  # some are beyond the reach of all kernels
    np.testing.assert_allclose(density.log_density(queries), expected, atol=1e-3)  # float32 over 15 m


def test_many_kernels_count_though_a_single_one_is_nearer():
    one, many = shifted(Poses.identity(1), -0.5), shifted(Poses.identity(999), 0.6)
    density = KernelDensity(Poses.concatenate([one, many]), 0.1, 0.1)
    expected = np.log((np.exp(-0.5 * 5**2) + 999 * np.exp(-0.5 * 6**2)) / 1000) - density.log_normaliser
    assert density.log_density(Poses.identity(1))[0] == pytest.approx(expected, abs=1e-3)


def test_a_far_pose_gets_its_true_log_density_and_not_minus_infinity():
    density = KernelDensity(Poses.identity(1), 0.1, 0.1)
    far = Poses(np.eye(3)[None], np.array([[5.0, 0, 0]]))
    expected = density.log_density(Poses.identity(1))[0] - 0.5 * (5.0 / 0.1) ** 2
    assert density.log_density(far)[0] == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("bandwidth_rad", [0.05, 0.4, 1.5])
def test_draws_from_a_kernel_follow_its_density(bandwidth_rad):
    density = KernelDensity(Poses.identity(1), 0.2, bandwidth_rad)
    n = 50_000
    draws = density.sample(n, rng=np.random.default_rng(5))
    np.testing.assert_allclose(draws.translation.std(axis=0), 0.2, rtol=0.02)
    # E[cos θ] of the kernel, by quadrature over its angle.
    angle = np.linspace(0, np.pi, 20001)
    p = np.exp((np.cos(angle) - 1) / bandwidth_rad**2) * (1 - np.cos(angle))
    expected = np.sum(p * np.cos(angle)) / p.sum()
    measured = (np.trace(draws.rotation, axis1=1, axis2=2) - 1) / 2
    assert measured.mean() == pytest.approx(expected, abs=4 * measured.std() / np.sqrt(n))


def test_narrow_kernels_in_a_wide_scene_lose_no_precision():
    centres = Poses(np.eye(3)[None].repeat(2, 0), np.array([[0.0, 0, 0], [400.0, 0, 0]]))
    density = KernelDensity(centres, 0.01, 0.01)
    near = Poses(np.eye(3)[None], np.array([[400.01, 0, 0]]))
    expected = density.log_density(KernelDensity(centres[:1], 0.01, 0.01).centres)[0] - 0.5
    assert density.log_density(near)[0] == pytest.approx(expected, abs=1e-4)


def test_weighted_centres_are_drawn_and_weighed_by_their_weights():
    centres = Poses.stack([Poses.exp(np.zeros(6)), Poses.exp(np.array([9.0, 0, 0, 0, 0, 0]))])
    density = KernelDensity(centres, 0.1, 0.1, np.log([0.9, 0.1]))
    share = np.mean(density.sample(20_000, rng=np.random.default_rng(6)).translation[:, 0] > 4)
    assert share == pytest.approx(0.1, abs=0.01)
    log_density = density.log_density(centres)
    assert log_density[0] - log_density[1] == pytest.approx(np.log(9), abs=1e-4)


def test_the_prior_divides_the_posterior():
    """A place with twice the training poses is no likelier when the posterior merely repeats that."""
    twice_as_dense = Poses(np.eye(3)[None].repeat(3, 0), np.array([[0.0, 0, 0], [0.01, 0, 0], [9.0, 0, 0]]))
    prior = KernelDensity(twice_as_dense, 0.2, 0.2)
    places = twice_as_dense[[0, 2]]
    with_prior = PosteriorSamples(prior, LikelihoodModel(prior, 0.05, 1.0, 1e-9)).log_likelihood(places)
    assert with_prior[0] == pytest.approx(with_prior[1], abs=1e-3)
    without = PosteriorSamples(prior, LikelihoodModel(None, 0.05, 1.0, 1e-9)).log_likelihood(places)
    assert without[0] - without[1] == pytest.approx(np.log(2), abs=0.01)


def test_the_outlier_floor_bounds_the_likelihood_from_below_and_the_temper_scales_it():
    posterior = KernelDensity(Poses.identity(1), 0.1, 0.1)
    nowhere = Poses(np.eye(3)[None], np.array([[50.0, 0, 0]]))
    sharp = PosteriorSamples(posterior, LikelihoodModel(None, 0.05, 1.0, 1e-4))
    soft = PosteriorSamples(posterior, LikelihoodModel(None, 0.05, 0.3, 1e-4))
    assert sharp.log_likelihood(nowhere)[0] == pytest.approx(0.0, abs=1e-9)
    here = Poses.identity(1)
    assert soft.log_likelihood(here)[0] == pytest.approx(0.3 * sharp.log_likelihood(here)[0])


@pytest.mark.parametrize("width", [0.0, -1.0, float("nan")])
def test_a_bandwidth_that_is_not_positive_is_refused(width):
    with pytest.raises(VaporTrackError, match="bandwidths must be positive"):
        KernelDensity(Poses.identity(1), width, 0.1)


def test_an_empty_posterior_is_refused():
    with pytest.raises(VaporTrackError, match="empty"):
        KernelDensity(Poses.identity(0), 0.1, 0.1)
