import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.special import logsumexp

from filtering.density import KernelDensity
from filtering.errors import VaporTrackError
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
    expected = logsumexp(log_kernel, axis=1) - np.log(len(centres)) - density.log_normaliser[0]
    assert expected.min() < -30  # some are beyond the reach of all kernels
    np.testing.assert_allclose(density.log_density(queries), expected, atol=1e-3)  # float32 over 15 m


def test_many_kernels_count_though_a_single_one_is_nearer():
    one, many = shifted(Poses.identity(1), -0.5), shifted(Poses.identity(999), 0.6)
    density = KernelDensity(Poses.concatenate([one, many]), 0.1, 0.1)
    expected = np.log((np.exp(-0.5 * 5**2) + 999 * np.exp(-0.5 * 6**2)) / 1000) - density.log_normaliser[0]
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


def summed_one_by_one(density, queries, log_weights):
    widths_m, widths_rad = (np.broadcast_to(w, len(density.centres)) for w in
                            (density.bandwidth_translation_m, density.bandwidth_rotation_rad))  # fmt: skip
    d2 = np.sum((queries.translation[:, None] - density.centres.translation[None]) ** 2, -1) / widths_m**2
    trace = np.einsum("aij,bij->ab", queries.rotation, density.centres.rotation)
    log_kernel = -0.5 * d2 + ((trace - 1) / 2 - 1) / widths_rad**2
    return logsumexp(log_kernel - density.log_normaliser + log_weights, axis=1)


def test_kernels_of_different_widths_and_two_ways_to_weigh_them_agree_with_the_sum_one_by_one():
    rng = np.random.default_rng(7)
    centres = Poses.concatenate([cloud(8, 300), shifted(cloud(9, 300), 6.0)])
    density = KernelDensity(centres, rng.uniform(0.02, 0.5, 600), rng.uniform(0.02, 0.5, 600))
    steep = rng.uniform(-30.0, 0.0, 600)
    ways = [np.full(600, -np.log(600)), steep - logsumexp(steep)]
    queries = Poses.concatenate([cloud(10, 400), shifted(cloud(11, 400), 6.0), shifted(cloud(12, 20), 40.0)])
    for values, log_weights in zip(density.log_densities(queries, *ways), ways, strict=True):
        np.testing.assert_allclose(values, summed_one_by_one(density, queries, log_weights), atol=2e-3, rtol=1e-5)


def test_draws_from_kernels_of_different_widths_have_them():
    density = KernelDensity(Poses.identity(2), np.array([0.1, 0.4]), np.array([0.15, 0.05]))
    draws = density.draw(np.repeat([0, 1], 20_000), rng=np.random.default_rng(0)).log()
    np.testing.assert_allclose(draws[:20_000].std(axis=0), [0.1] * 3 + [0.15] * 3, rtol=0.03)
    np.testing.assert_allclose(draws[20_000:].std(axis=0), [0.4] * 3 + [0.05] * 3, rtol=0.03)


def test_above_its_floor_a_density_is_exact_and_below_it_stays_below():
    density = KernelDensity(cloud(13, 200), 0.3, 0.3)
    queries = Poses.concatenate([cloud(14, 300), shifted(cloud(15, 300), 3.0)])
    exact, floored = density.log_density(queries), density.log_density(queries, log_floor=-7.0)
    above = exact > -7.0
    assert 50 < above.sum() < 550
    np.testing.assert_allclose(floored[above], exact[above], atol=1e-3)
    assert (floored[~above] < -7.0 + 1e-3).all()


def test_near_its_centres_a_density_is_the_same_without_a_second_look_however_wide_or_unlikely_they_are():
    places = [cloud(16, 150), shifted(cloud(18, 50), 20.0)]
    weight, width = np.repeat([1 / 150, 1e-20 / 50], [150, 50]), np.repeat([0.02, 0.4], [150, 50])
    density = KernelDensity(Poses.concatenate(places), width, width, np.log(weight))
    queries = Poses.concatenate([places[0][:100], shifted(cloud(17, 100), 20.0), shifted(cloud(19, 10), 100.0)])
    exact, near_only = density.log_density(queries), density.log_density(queries, near_only=True)
    np.testing.assert_allclose(near_only[:200], exact[:200], atol=1e-3)
    assert exact[100:200].max() < exact[:100].min() - 40
    assert np.isfinite(exact).all()
    assert (near_only[200:] == -np.inf).all()


def test_a_floor_far_below_the_peak_is_kept_too():
    density = KernelDensity(Poses.identity(2), 0.01, 0.01)
    there = Poses(np.eye(3)[None], np.array([[0.082, 0.0, 0.0]]))
    assert density.log_density(there, log_floor=-30.0)[0] == pytest.approx(density.log_density(there)[0], abs=1e-3)
    assert density.log_density(there)[0] > -30.0


@pytest.mark.parametrize("width", [0.0, -1.0, float("nan")])
def test_a_bandwidth_that_is_not_positive_is_refused(width):
    with pytest.raises(VaporTrackError, match="bandwidths must be positive"):
        KernelDensity(Poses.identity(1), width, 0.1)


def test_an_empty_posterior_is_refused():
    with pytest.raises(VaporTrackError, match="empty"):
        KernelDensity(Poses.identity(0), 0.1, 0.1)


@pytest.mark.parametrize("width", [1e-2, 1.001e-3, 0.999e-3, 1e-5, 1e-8])
def test_a_narrow_rotation_kernel_is_a_gaussian(width):
    density = KernelDensity(Poses.identity(1), 1.0, width)
    gaussian = 1.5 * np.log(2 * np.pi) + 1.5 * np.log(2 * np.pi * width**2)
    np.testing.assert_allclose(density.log_normaliser, gaussian, atol=width**2 + 1e-5)
