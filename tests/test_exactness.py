"""The filter against exact answers: a Kalman filter where that is optimal, and modes whose weights are known."""

from dataclasses import dataclass

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter

from filtering.density import KernelDensity
from filtering.localizer import LocalizerConfig, ParticleLocalizer
from filtering.motion import Odometry
from filtering.posterior import LikelihoodModel, PosteriorSamples
from filtering.recovery import RecoveryConfig
from filtering.regularisation import KernelConfig
from filtering.se3 import Poses

NEVER_KIDNAPPED = RecoveryConfig(min_kidnap_probability=0.0, max_kidnap_probability=0.0)
JITTER_M, JITTER_RAD = 0.01, 0.003


class NoImages:
    """Posteriors are handed to `update`; no image is ever looked at."""

    def observe(self, image, *, rng):
        raise AssertionError("no image is looked at")


# --- one Gaussian mode: filterpy's Kalman filter is exact ----------------------------------------------

MEASUREMENT_STD_M = np.array([0.05, 0.08, 0.12])
ODOMETRY_STD_M = 0.03
STEP_M = np.array([0.05, 0.02, -0.03])
UPRIGHT = KernelDensity(Poses.identity(1), 1.0, 0.01)
LOG_FLAT_PRIOR = -5.0


@dataclass(frozen=True)
class GaussianPosterior:
    """Exactly Gaussian in translation, tight about one known rotation, under a flat prior: L is p̂, untempered."""

    measured_m: np.ndarray

    def sample(self, num_samples, *, rng):
        rotation = UPRIGHT.sample(num_samples, rng=rng).rotation
        return Poses(rotation, self.measured_m + MEASUREMENT_STD_M * rng.standard_normal((num_samples, 3)))

    def log_density(self, poses):
        log_rotation = UPRIGHT.log_density(Poses(poses.rotation, np.zeros((len(poses), 3)))) + 1.5 * np.log(2 * np.pi)
        squared = np.square((poses.translation - self.measured_m) / MEASUREMENT_STD_M).sum(axis=1)
        return log_rotation - 0.5 * squared - np.log(MEASUREMENT_STD_M).sum() - 1.5 * np.log(2 * np.pi)

    def log_likelihood(self, poses):
        return self.log_density(poses) - LOG_FLAT_PRIOR


def beside_a_kalman_filter(seed, injection_fraction, num_steps=30):
    """Both filters over the same measurements: standardised differences of the means (t, 3), of all particles and of
    the best mode; ratios of the variances (t, 3), of both; effective sample sizes (t,); and the gain (3,)."""
    rng = np.random.default_rng(seed)
    config = LocalizerConfig(
        num_particles=600,
        injection_fraction=injection_fraction,
        kernels=KernelConfig(max_kernels=300, jitter_m=JITTER_M, jitter_rad=JITTER_RAD),
        recovery=NEVER_KIDNAPPED,
    )
    localizer = ParticleLocalizer(NoImages(), config, rng=rng)
    covariance = np.diag([ODOMETRY_STD_M**2] * 3 + [0.0] * 3)
    kalman = KalmanFilter(3, 3)
    kalman.H, kalman.R = np.eye(3), np.diag(MEASUREMENT_STD_M**2)
    kalman.Q = (ODOMETRY_STD_M**2 + JITTER_M**2) * np.eye(3)  # the jitter is noise like any other
    true_m, rows = np.zeros(3), []
    for t in range(num_steps):
        if t:
            true_m = true_m + STEP_M + ODOMETRY_STD_M * rng.standard_normal(3)
        measured_m = true_m + MEASUREMENT_STD_M * rng.standard_normal(3)
        odometry = Odometry(Poses(np.eye(3), STEP_M), covariance) if t else None
        estimate = localizer.update(GaussianPosterior(measured_m), odometry)
        if t == 0:
            kalman.x, kalman.P = measured_m[:, None].copy(), kalman.R.copy()
        else:
            kalman.predict(u=STEP_M[:, None], B=np.eye(3))
            kalman.update(measured_m[:, None])
        variance = np.diag(kalman.P)
        weights, mode = np.exp(estimate.log_weights), estimate.modes[0]
        mean_m = weights @ estimate.particles.translation
        spread = weights @ np.square(estimate.particles.translation - mean_m)
        means = [mean_m, mode.world_from_camera.translation]
        rows.append(
            [*((mean - kalman.x[:, 0]) / np.sqrt(variance) for mean in means),
             spread / variance, np.diag(mode.covariance)[:3] / variance,
             np.full(3, estimate.effective_sample_size)]
        )  # fmt: skip
    steady = np.array(rows)[8:]
    return *np.moveaxis(steady, 1, 0), variance / MEASUREMENT_STD_M**2


@pytest.mark.parametrize("injection_fraction", [0.0, 0.1, 0.5])
def test_on_a_linear_gaussian_case_mean_and_covariance_are_those_of_the_kalman_filter(injection_fraction):
    """A step draws twice, centres and then particles, so it moves the mean by √(2/ESS) standard deviations, and the
    next ones forget that as the Kalman filter does, by 1 − K each. The covariance about a mean that strays lacks what
    the mean strays: E[P] + E[(difference of means)²] is the Kalman filter's P (law of total variance).
    """
    runs = [beside_a_kalman_filter(seed, injection_fraction) for seed in range(6 if injection_fraction else 10)]
    gain = runs[0][-1]
    difference, of_mode, ratio, ratio_of_mode, ess = (np.array([run[i] for run in runs]) for i in range(5))
    np.testing.assert_allclose(of_mode, difference, atol=1e-3)  # one mode: it holds all particles
    np.testing.assert_allclose(ratio_of_mode, ratio, atol=0.01)
    expected_square = 2 / ess.mean() / (1 - (1 - gain) ** 2)
    square = np.square(difference).mean(axis=(0, 1))
    assert (np.sqrt(square / expected_square) < 1.5).all()
    num_independent = difference.shape[0] * difference.shape[1] * gain / (2 - gain)
    assert (np.abs(difference.mean(axis=(0, 1))) < 4 * np.sqrt(expected_square / num_independent)).all()
    total = (ratio + np.square(difference)).mean(axis=1)
    standard_error = total.std(axis=0, ddof=1) / np.sqrt(len(total))
    assert (standard_error < 0.04).all()
    assert (np.abs(total.mean(axis=0) - 1) < np.maximum(4 * standard_error, 0.03)).all()


# --- modes that look alike: their weights may stray, but not one way ------------------------------------

GAP_M = 3.0
MOTION_STD = np.array([0.005] * 3 + [0.003] * 3)
DELTA = Poses.exp(np.array([0.04, 0, 0.01, 0, 0, 0.02]))


def alike(true, shares):
    """A posterior of modes of the same shape, one above the other, with these shares."""
    lift = GAP_M * np.flatnonzero(shares)[:, None] * np.array([0.0, 0, 1])
    poses = Poses(np.broadcast_to(true.rotation, (len(lift), 3, 3)), true.translation + lift)
    log_shares = np.log(np.array(shares)[np.flatnonzero(shares)])
    return PosteriorSamples(KernelDensity(poses, 0.15, 0.1, log_shares), LikelihoodModel(temper=0.1))


def walk_among_modes(seed, shares_per_step):
    """Weights of the modes (t, k) over a walk, and height of the best mode over the lowest, in floors (t,)."""
    rng = np.random.default_rng(seed)
    config = LocalizerConfig(num_particles=300, kernels=KernelConfig(max_kernels=150))
    localizer = ParticleLocalizer(NoImages(), config, rng=rng)
    true, weights, best = Poses.identity(), [], []
    for t, shares in enumerate(shares_per_step):
        odometry = None
        if t:
            true = true @ DELTA
            odometry = Odometry(DELTA @ Poses.exp(MOTION_STD * rng.standard_normal(6)), np.diag(MOTION_STD**2))
        estimate = localizer.update(alike(true, shares), odometry)
        floor = np.rint((estimate.particles.translation[:, 2] - true.translation[2]) / GAP_M).astype(np.int64)
        weights.append(np.bincount(floor.clip(0, len(shares) - 1), np.exp(estimate.log_weights), len(shares)))
        best.append((estimate.modes[0].world_from_camera.translation[2] - true.translation[2]) / GAP_M)
    return np.array(weights), np.array(best)


@pytest.mark.parametrize(
    ("first", "later"), [((0.5, 0.5), (0.5, 0.5)), ((0.8, 0.2), (0.5, 0.5)), ((0.25,) * 4, (0.25,) * 4)]
)
def test_images_that_tell_no_modes_apart_change_their_weights_on_average_by_nothing(first, later):
    """Neither the greater nor the lesser mode gains: weights are a martingale, whatever resampling and injection do.

    (Evaluating a smoother density than the one drawn from lets the greater of two modes of 80 and 20 % have all of it.)
    """
    weights = np.array([walk_among_modes(seed, [first] + [later] * 15)[0] for seed in range(12)])
    standard_error = weights[:, -1].std(axis=0, ddof=1) / np.sqrt(len(weights))
    assert (standard_error < 0.05).all()
    assert (np.abs(weights[:, -1].mean(axis=0) - first) < 4 * standard_error).all()
    assert weights[:, -1].min() > 0.3 * min(first)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("unique", [(1.0, 0.0), (0.0, 1.0)])
def test_once_a_unique_image_arrives_the_right_one_of_two_equal_modes_wins(seed, unique):
    weights, best = walk_among_modes(seed, [(0.5, 0.5)] * 8 + [unique] * 6)
    right = unique.index(1.0)
    assert (weights[:8] > 0.2).all()
    assert weights[-1, right] > 0.95
    assert best[-1] == pytest.approx(right, abs=0.1)
