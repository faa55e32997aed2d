"""Whatever odometry says, nothing that comes out is wrong about itself."""

import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from filtering.config import LocalizerConfig
from filtering.errors import VaporTrackError
from filtering.estimate import Mode
from filtering.fixed_lag import FixedLagSmoother
from filtering.hindsight import FilterStep, trajectory_agreement
from filtering.kalman import KalmanLocalizer
from filtering.localizer import ParticleLocalizer
from filtering.moments import require_sound, settle
from filtering.motion import MotionNoise, Odometry
from filtering.observation import Observation
from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from filtering.smoothing import smooth
from tests.helpers.simulation import ERRORS, lifted, seen_at
from vapor.tracking.methods import gaussian_sum

NOISE = MotionNoise()
CENTURY_S = 3e9


def odometry(leap_m: float, turn_rad: float, duration_s: float, honest: bool) -> Odometry:
    moved = Poses.exp(np.array([leap_m, 0.3 * leap_m, 0.0, 0.0, turn_rad, 0.1 * turn_rad]))
    stated = NOISE.covariance(moved, duration_s) if honest else np.diag([1e-6] * 3 + [1e-8] * 3)
    return Odometry(moved, stated / max(1.0, stated.max() / 1e11), duration_s)


steps = st.lists(
    st.tuples(
        st.sampled_from(["image", "image", "image", "nothing", "gap", "elsewhere"]),
        st.sampled_from([0.0, 0.05, 3.0, 1e5, 1e8]),
        st.sampled_from([0.0, 0.02, 3.1]),
        st.sampled_from([0.0, 0.1, 60.0, CENTURY_S]),
        st.booleans(),
    ),
    min_size=3,
    max_size=7,
)


def correlation(covariances):
    """What is left of covariances, symmetric or not, without their units."""
    np.testing.assert_array_equal(covariances, np.swapaxes(covariances, -1, -2))
    std = np.sqrt(np.einsum("...ii->...i", covariances))
    return covariances / (std[..., :, None] * std[..., None, :])


def assert_sound(poses, covariances):
    assert poses.is_finite().all()
    assert np.isfinite(covariances).all()
    assert np.linalg.eigvalsh(correlation(covariances)).min() > 0.0
    rotation = poses.rotation
    np.testing.assert_allclose(rotation @ np.swapaxes(rotation, -1, -2), np.zeros_like(rotation) + np.eye(3), atol=1e-9)


def taken(found):
    """Images and odometry of steps as hypothesis found them."""
    place = Poses.identity()
    for kind, leap_m, turn_rad, duration_s, honest in found:
        odom = None if kind == "gap" else odometry(leap_m, turn_rad, duration_s, honest)
        if kind == "nothing":
            yield PosePosterior.uninformative(ERRORS), odom, duration_s
            continue
        place = place @ Poses.exp(np.array([0.05, 0, 0, 0, 0.01, 0]))
        at = Poses(place.rotation, place.translation + 7.0) if kind == "elsewhere" else place
        yield seen_at(lifted(at, [0.0, 3.0, 6.0]), [0.5, 0.3, 0.2]), odom, duration_s


@settings(max_examples=12, deadline=None)
@given(found=steps)
def test_whatever_odometry_says_poses_are_finite_and_covariances_positive_definite(found):
    config = LocalizerConfig()
    filters = [ParticleLocalizer(None, each, rng=np.random.default_rng(0)) for each in (config, gaussian_sum(config))]
    kalman = KalmanLocalizer()
    first = seen_at(lifted(Poses.identity(), [0.0, 3.0, 6.0]), [0.5, 0.3, 0.2])
    steps = []
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for posterior, odom, elapsed_s in [(first, None, 0.1), *taken(found)]:
            for each in filters:
                observation = Observation.of_posterior(posterior, odom, elapsed_s)
                estimate = each.advance(observation)
                assert_sound(estimate.particles, estimate.covariances)
                for mode in estimate.modes:
                    assert_sound(mode.world_from_camera, mode.covariance)
            mode = kalman.update(posterior, odom, elapsed_s=elapsed_s)
            assert_sound(mode.world_from_camera, mode.covariance)
            steps.append(FilterStep.of(observation, estimate))
        smoothed = smooth(steps, ERRORS).best
        assert_sound(smoothed.poses, smoothed.covariance)
        lagged = FixedLagSmoother(0.5, ERRORS)
        for found_later in [*(lagged.update(step) for step in steps), lagged.finish()]:
            for each in found_later:
                assert_sound(each.world_from_camera, each.covariance)
        fits = trajectory_agreement(smoothed.poses, np.arange(len(steps)) * 100_000_000, steps, ERRORS)
    assert ((fits >= 0.0) & (fits <= 1.0)).all()


@pytest.mark.parametrize("leap_m", [1e3, 1e5, 1e6])
def test_after_a_leap_that_odometry_calls_uncertain_the_camera_is_where_the_image_says(leap_m):
    localizer, kalman = ParticleLocalizer(None, rng=np.random.default_rng(0)), KalmanLocalizer()
    image = seen_at(Poses.identity())
    covariance = np.diag([leap_m**2] * 3 + [1.0] * 3)
    leap = Odometry(Poses.exp(np.array([leap_m, 0, 0, 0, 0.5, 0])), covariance, 1.0)
    for each in (localizer, kalman):
        each.update(image, None)
        found = each.update(image, leap)
        best = found if isinstance(found, Mode) else found.modes[0]
        assert best.world_from_camera.distance(Poses.identity())[0] < 1.0
        assert best.widest_std_m < 1.0


def test_the_longer_nothing_is_seen_the_less_is_known():
    for make in (lambda: ParticleLocalizer(None, rng=np.random.default_rng(0)), KalmanLocalizer):
        widest = []
        for duration_s in (0.1, 10.0, 1e3, 1e6, CENTURY_S):
            localizer = make()
            localizer.update(seen_at(Poses.identity()), None)
            still = Odometry(Poses.identity(), NOISE.covariance(Poses.identity(), duration_s), duration_s)
            found = localizer.update(PosePosterior.uninformative(ERRORS), still)
            widest.append((found if isinstance(found, Mode) else found.modes[0]).widest_std_m)
        assert (np.diff(widest) > 0.0).all()
        assert widest[-1] > 100.0


def test_rounding_is_settled_and_what_is_no_covariance_is_not_told():
    spread = np.diag([1e12, 1e12, 1e12, 1.0, 1e-3, 1e-3])
    turn = Poses.exp(np.array([1e5, 2e4, 0, 1.0, 2.0, 0.5])).adjoint()
    covariance = turn @ spread @ turn.T
    settle(covariance)
    assert np.linalg.eigvalsh(correlation(covariance)).min() > 0.0
    require_sound(Poses.identity(), np.eye(6))
    for wrong, told in (
        (np.full((6, 6), np.nan), "not finite"),
        (np.diag([1.0, 1, 1, 1, 1, -1e-9]), "eigenvalue -1e-09"),
    ):
        with pytest.raises(VaporTrackError, match=told):
            require_sound(Poses.identity(), wrong)
    with pytest.raises(VaporTrackError, match="1 of 1 poses to write are not finite"):
        require_sound(Poses(np.eye(3), np.array([np.nan, 0, 0])))
