"""The single-hypothesis baseline: as good as one hypothesis can be."""

from dataclasses import replace

import numpy as np
import pytest

from filtering.config import GapConfig, LocalizerConfig
from filtering.errors import VaporTrackError
from filtering.kalman import KalmanConfig, KalmanLocalizer
from filtering.localizer import ParticleLocalizer
from filtering.motion import Odometry
from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from tests.helpers.modelled_walk import BIAS, ERRORS, walk

CONFIG = KalmanConfig(odometry_bias=BIAS)


def follow(kalman, posteriors, odometry):
    modes = [kalman.update(posterior, motion) for posterior, motion in zip(posteriors, odometry, strict=True)]
    return Poses.stack([mode.world_from_camera for mode in modes]), np.stack([mode.covariance for mode in modes])


def lifted(posterior, metres):
    means = Poses(posterior.means.rotation, posterior.means.translation + np.array([0.0, 0.0, metres]))
    return replace(posterior, means=means, samples=means)


def test_with_one_place_per_image_it_is_the_particle_filter_with_one_hypothesis():
    path = walk(
        60, rng=np.random.default_rng(0), noise=replace(ERRORS, degrees_of_freedom=5.0, outlier_probability=1e-9)
    )
    certain = LocalizerConfig(birth_rate=0.0, max_birth_rate=0.0, odometry_failures_per_s=0.0, odometry_bias=BIAS)
    filtered = ParticleLocalizer(None, certain, rng=np.random.default_rng(0))
    kalman = KalmanLocalizer(replace(CONFIG, gate_probability=0.999999))
    for i, (posterior, motion) in enumerate(zip(path.posteriors, path.odometry, strict=True)):
        motion = None if i == 30 else motion
        seen = PosePosterior.uninformative(ERRORS) if i % 7 == 3 else posterior
        estimate = filtered.update(seen, motion, elapsed_s=0.1)
        mode = kalman.update(seen, motion, elapsed_s=0.1)
        assert len(estimate.particles) == 1
        np.testing.assert_allclose(
            mode.world_from_camera.as_matrix(), estimate.modes[0].world_from_camera.as_matrix(), atol=1e-9
        )
        np.testing.assert_allclose(mode.covariance, estimate.modes[0].covariance, atol=1e-12)


def test_of_like_places_the_nearest_corrects_it_whatever_their_shares():
    path = walk(60, rng=np.random.default_rng(1), lifts=lambda i: (0.0,) if i == 0 else (-3.0, 0.0, 3.0))
    uneven = [
        replace(posterior, weights=np.array([0.6, 0.1, 0.3])) if i else posterior
        for i, posterior in enumerate(path.posteriors)
    ]
    alone = [
        replace(p, means=p.means[k : k + 1], covariances=p.covariances[:1], weights=np.ones(1))
        for p, k in zip(path.posteriors, [0] + 59 * [1], strict=True)
    ]
    poses, _ = follow(KalmanLocalizer(CONFIG), uneven, path.odometry)
    expected, _ = follow(KalmanLocalizer(CONFIG), alone, path.odometry)
    np.testing.assert_allclose(poses.translation, expected.translation, rtol=0.0, atol=1e-12)


def test_it_starts_at_the_heaviest_place_and_a_wrong_one_stays_wrong():
    path = walk(60, rng=np.random.default_rng(2), lifts=lambda i: (0.0, 3.0))
    path.posteriors[0] = replace(path.posteriors[0], weights=np.array([0.4, 0.6]))
    poses, _ = follow(KalmanLocalizer(CONFIG), path.posteriors, path.odometry)
    assert (poses.distance(path.truth)[0] > 2.0).all()


@pytest.mark.parametrize("every", [1, 5])
def test_places_far_off_are_rejected_and_after_seconds_of_them_it_starts_anew(every):
    """Seconds, not images: at a fifth of the rate it waits as long."""
    path = walk(100, rng=np.random.default_rng(3))
    wrong = [lifted(p, 9.0) if 20 <= i < 30 or i >= 50 else p for i, p in enumerate(path.posteriors)]
    kalman, error_m = KalmanLocalizer(CONFIG), np.full(100, np.nan)
    motion = None
    for i in range(100):
        motion = path.odometry[i] if motion is None else motion.then(path.odometry[i])
        if i % every == 0:
            mode = kalman.update(wrong[i], motion)
            error_m[i], motion = float(mode.world_from_camera.distance(path.truth[i])[0]), None
    assert np.nanmax(error_m[:70]) < 0.4
    assert np.nanmin(error_m[70:]) > 8.0


def test_images_that_say_nothing_only_predict_and_the_first_of_them_is_refused():
    path = walk(30, rng=np.random.default_rng(4))
    kalman = KalmanLocalizer(CONFIG)
    with pytest.raises(VaporTrackError, match="the first image has no place"):
        kalman.update(PosePosterior.uninformative(ERRORS), None)
    unlike = lifted(replace(path.posteriors[0], ood_score=2.0), 50.0)
    assert kalman.update(unlike, None).world_from_camera.translation[2] > 40.0
    first = kalman.update(path.posteriors[1], path.odometry[1])  # what an out-of-distribution image said is forgotten
    assert float(first.world_from_camera.distance(path.truth[1])[0]) < 0.5
    mode = kalman.update(PosePosterior.uninformative(ERRORS), path.odometry[2])
    assert mode.widest_std_m > first.widest_std_m
    np.testing.assert_allclose(
        mode.world_from_camera.as_matrix(),
        (first.world_from_camera @ path.odometry[2].previous_from_current).as_matrix(),
        atol=1e-12,
    )


def test_missing_odometry_widens_the_belief_or_forgets_it():
    path = walk(30, rng=np.random.default_rng(5))
    far = lifted(path.posteriors[29], 2.0)
    results = {}
    for action in ("widen", "forget"):
        kalman = KalmanLocalizer(replace(CONFIG, gap=GapConfig(action)))
        follow(kalman, path.posteriors[:20], path.odometry[:20])
        results[action] = kalman.update(far, None, elapsed_s=3.0).world_from_camera.distance(path.truth[29])[0]
    assert results["widen"] > 1.7
    assert results["forget"] > 1.7
    strict = KalmanLocalizer(replace(CONFIG, gap=GapConfig(speed_m_per_s=0.01, turn_rad_per_s=0.01)))
    follow(strict, path.posteriors[:20], path.odometry[:20])
    assert strict.update(far, None, elapsed_s=3.0).world_from_camera.distance(path.truth[19])[0] < 0.4


def test_where_odometry_is_missing_and_the_image_is_uninformative_the_next_one_begins():
    path = walk(21, rng=np.random.default_rng(5))
    kalman = KalmanLocalizer(replace(CONFIG, gap=GapConfig("forget")))
    poses, _ = follow(kalman, path.posteriors[:20], path.odometry[:20])
    mode = kalman.update(PosePosterior.uninformative(), None, elapsed_s=1.0)
    assert mode.world_from_camera.distance(poses[-1])[0] < 0.01
    assert mode.widest_std_m > 1.4
    far = lifted(path.posteriors[20], 30.0)
    begun = kalman.update(far, path.odometry[20])
    np.testing.assert_array_equal(begun.world_from_camera.translation, far.means.translation[0])


def test_bad_odometry_is_refused_and_changes_nothing():
    path = walk(20, rng=np.random.default_rng(6))
    poses = []
    for bad in (False, True):
        kalman = KalmanLocalizer(CONFIG)
        follow(kalman, path.posteriors[:10], path.odometry[:10])
        if bad:
            with pytest.raises(VaporTrackError, match="not finite"):
                kalman.update(path.posteriors[10], Odometry(Poses.identity(), np.full((6, 6), np.nan), 0.1))
            with pytest.raises(VaporTrackError, match="expected a finite time"):
                kalman.update(path.posteriors[10], None, elapsed_s=-1.0)
        poses.append(follow(kalman, path.posteriors[10:], path.odometry[10:])[0])
    np.testing.assert_array_equal(poses[0].translation, poses[1].translation)


@pytest.mark.parametrize("unit", [30.0, 1.0 / 30.0])
def test_lengths_in_another_unit_give_the_same_times_that(unit):
    plain = walk(40, rng=np.random.default_rng(7))
    scaled = walk(40, rng=np.random.default_rng(7), unit=unit)
    poses, _ = follow(KalmanLocalizer(CONFIG), plain.posteriors, plain.odometry)
    others, _ = follow(KalmanLocalizer(CONFIG), scaled.posteriors, scaled.odometry)
    np.testing.assert_allclose(others.translation, unit * poses.translation, atol=1e-6 * unit)
