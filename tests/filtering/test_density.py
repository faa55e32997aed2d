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


def test_log_density_is_the_sum_of_kernels_of_different_weights_and_widths():
    rng = np.random.default_rng(7)
    centres = Poses.concatenate([cloud(8, 300), shifted(cloud(9, 300), 6.0)])
    widths_m, widths_rad, log_weights = (
        rng.uniform(0.02, 0.5, 600),
        rng.uniform(0.02, 0.5, 600),
        rng.uniform(-9, 0, 600),
    )
    log_weights -= logsumexp(log_weights)
    density = KernelDensity(centres, widths_m, widths_rad, log_weights)
    queries = Poses.concatenate([cloud(10, 400), shifted(cloud(11, 400), 6.0), shifted(cloud(12, 20), 40.0)])
    d2 = np.sum((queries.translation[:, None] - centres.translation[None]) ** 2, -1) / widths_m**2
    trace = np.einsum("aij,bij->ab", queries.rotation, centres.rotation)
    log_kernel = -0.5 * d2 + ((trace - 1) / 2 - 1) / widths_rad**2
    expected = logsumexp(log_kernel - density.log_normaliser + log_weights, axis=1)
    np.testing.assert_allclose(density.log_density(queries), expected, atol=2e-3, rtol=1e-5)


def test_narrow_kernels_in_a_wide_scene_lose_no_precision():
    centres = Poses(np.eye(3)[None].repeat(2, 0), np.array([[0.0, 0, 0], [400.0, 0, 0]]))
    density = KernelDensity(centres, 0.01, 0.01)
    near = Poses(np.eye(3)[None], np.array([[400.01, 0, 0]]))
    expected = density.log_density(KernelDensity(centres[:1], 0.01, 0.01).centres)[0] - 0.5
    assert density.log_density(near)[0] == pytest.approx(expected, abs=1e-4)


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
