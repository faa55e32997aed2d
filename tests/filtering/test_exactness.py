"""The filter against an exact answer: where all is linear and Gaussian it is the Kalman filter, done with filterpy."""

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter

from filtering.config import LocalizerConfig
from filtering.hypotheses import BIAS, POSE, correlated_error
from filtering.localizer import ParticleLocalizer
from filtering.measurement_noise import MeasurementNoise
from filtering.motion import Odometry, OdometryBias
from filtering.observation import View
from filtering.se3 import Poses
from tests.helpers.simulation import seen_at

ONE_PLACE = MeasurementNoise(
    degrees_of_freedom=1e6,
    outlier_probability=1e-9,
    log_clutter_density=-500.0,
    constant_fraction=0.0,
    correlated_fraction=0.7,
)
SLOWLY = OdometryBias(scale=0.05, drift=(0.01, 0.02, 0.015, 1e-7, 2e-7, 3e-7), time_s=4.0)
ALONE = LocalizerConfig(
    birth_rate=0.0, max_birth_rate=0.0, odometry_failures_per_s=0.0, adapt_errors=False, odometry_bias=SLOWLY
)
IMAGE_STD = np.array([0.03, 0.05, 0.04, 2e-6, 1e-6, 3e-6])
MOTION_STD = np.array([0.004, 0.003, 0.002, 2e-7, 3e-7, 1e-7])
STEP = np.array([0.08, -0.03, 0.05, 0.0, 0.0, 0.0])
SECONDS = 0.2


def skew(v):
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def kalman_filter(step, cameras=1):
    """State: position and rotation vector, scale error, drift, and each camera's correlated error; angles are tiny."""
    size = 13 + 6 * cameras
    kalman = KalmanFilter(size, 6)
    kalman.F = np.eye(size)
    kalman.F[:3, 3:6] = -skew(step[:3])  # a rotated camera goes another way
    kalman.F[:3, 6] = -step[:3]
    # The drift and its integral over a step: an Ornstein-Uhlenbeck process.
    times = SECONDS / SLOWLY.time_s
    kept = np.exp(-times)
    lasting = (1 - kept) / times
    drift = SECONDS * np.array(SLOWLY.drift)
    kalman.F[:6, 7:13] = -lasting * np.diag(drift)
    kalman.F[range(7, 13), range(7, 13)] = kept
    noise = np.concatenate([MOTION_STD**2, [0.0], np.full(6, 1 - kept**2), np.zeros(6 * cameras)])
    kalman.Q = np.diag(noise)
    kalman.Q[:6, :6] += np.diag(drift**2) * (2 * times - 3 + 4 * kept - kept**2) / times**2
    kalman.Q[:6, 7:13] = kalman.Q[7:13, :6] = -np.diag(drift) * lasting**2 * times
    kalman.x = np.zeros((size, 1))
    kalman.P = np.eye(size)
    kalman.P[:6, :6] *= 1e3  # nothing is known of the pose
    kalman.P[6, 6] = SLOWLY.scale**2
    kalman.R = (1 - ONE_PLACE.correlated_fraction) * np.diag(IMAGE_STD**2)
    return kalman


def fade(kalman, cameras):
    """Correlated errors fade along the distance, which the scale error found so far corrects."""
    faded = np.exp(-(1 - kalman.x[6, 0]) * np.linalg.norm(STEP[:3]) / ONE_PLACE.length_m)
    errors = range(13, 13 + 6 * cameras)
    kalman.F[errors, errors] = faded
    kalman.Q[errors, errors] = 1 - faded**2


def seen_by(camera, size):
    h = np.zeros((6, size))
    h[:, :6] = np.eye(6)
    h[:, 13 + 6 * camera : 19 + 6 * camera] = np.sqrt(ONE_PLACE.correlated_fraction) * np.diag(IMAGE_STD)
    return h


@pytest.mark.parametrize(("seed", "cameras"), [(0, 1), (1, 1), (2, 1), (5, 2)])
def test_with_one_place_and_gaussian_errors_the_state_is_that_of_the_kalman_filter(seed, cameras):
    """Pose, odometry bias, and the correlated errors of each camera, which are independent."""
    rng = np.random.default_rng(seed)
    localizer = ParticleLocalizer(None, ALONE, rng=rng)
    kalman = kalman_filter(STEP, cameras)
    size = len(kalman.x)
    control = np.zeros((size, 1))
    control[:6, 0] = STEP
    true = np.zeros(6)
    for t in range(60):
        measured = [true + rng.standard_normal(6) * IMAGE_STD for _ in range(cameras)]
        odometry = Odometry(Poses.exp(STEP), np.diag(MOTION_STD**2), SECONDS) if t else None
        views = [
            View(seen_at(Poses.exp(m[None]), std=IMAGE_STD, noise=ONE_PLACE), Poses.identity(), f"camera {i}")
            for i, m in enumerate(measured)
        ]
        estimate = localizer.update(views, odometry)
        if t:
            fade(kalman, cameras)
            kalman.predict()
            kalman.x = kalman.x + control
        for camera in range(cameras):
            kalman.update(measured[camera][:, None], H=seen_by(camera, size))
        true = true + 0.96 * STEP + rng.standard_normal(6) * MOTION_STD

        belief = localizer.belief.hypotheses
        assert len(belief) == 1
        std = np.sqrt(np.diag(kalman.P))
        state = np.concatenate([belief.poses[0].log(), belief.mean[0]])
        # The tolerance, in standard deviations, is for the curvature of SE(3).
        np.testing.assert_allclose(state / std, kalman.x[:, 0] / std, atol=1e-3)
        np.testing.assert_allclose(belief.covariance[0] / np.outer(std, std), kalman.P / np.outer(std, std), atol=1e-3)
        np.testing.assert_allclose(estimate.modes[0].covariance, belief.covariance[0, POSE, POSE])
    learned = np.sqrt(np.diag(belief.covariance[0]))
    assert learned[BIAS][0] < 0.5 * SLOWLY.scale  # precondition: there was something to learn
    assert (learned[correlated_error(0)][:3] < 0.95).all()
