import numpy as np
import pytest

from filtering.errors import VaporTrackError
from filtering.se3 import Poses
from sequences.errors import SequenceError
from sequences.odometry import OdometryNoise, simulate_odometry

pytestmark = pytest.mark.usefixtures("unchecked")

TIMES_NS = 20_000_000 * np.arange(1501, dtype=np.int64)  # 30 s at 50 Hz
SILENT = OdometryNoise(0.0, 0.0, 0.0, 30.0, 0.0, 0.0)


def walk(speed: float = 0.6, turn: float = 0.3) -> Poses:
    seconds = TIMES_NS * 1e-9
    tangent = np.zeros((len(seconds), 6))
    tangent[:, 0], tangent[:, 5] = speed * seconds, turn * seconds
    start = Poses.exp(np.array([3.0, -2.0, 1.0, 0.2, 0.1, 2.0]))
    return start @ Poses.exp(tangent)


def errors_over(step: int, seeds: int, noise: OdometryNoise) -> tuple[np.ndarray, np.ndarray]:
    """Tangent errors (m, 6) of increments over `step` messages and the covariances stated for them (m, 6, 6)."""
    true = walk()
    at = np.arange(0, len(TIMES_NS) - step, step)
    real = true[at].inverse() @ true[at + step]
    errors, stated = [], []
    for seed in range(seeds):
        odom, twist = simulate_odometry(TIMES_NS, true, noise, rng=np.random.default_rng(seed))
        measured = odom[at].inverse() @ odom[at + step]
        errors.append((real.inverse() @ measured).log())
        stated.append(np.add.reduceat(twist[1:], at)[: len(at)] * 0.02**2)
    return np.concatenate(errors), np.concatenate(stated)


def test_odometry_without_noise_is_the_true_motion_from_the_identity():
    true = walk()
    odom, covariance = simulate_odometry(TIMES_NS, true, SILENT, rng=np.random.default_rng(0))
    expected = true[:1].inverse() @ true
    np.testing.assert_allclose(odom.as_matrix(), expected.as_matrix(), atol=1e-9)
    assert np.abs(covariance).max() == 0
    np.testing.assert_array_equal(odom.as_matrix()[0], np.eye(4))


def test_a_given_error_of_scale_makes_odometry_too_long_by_just_that_and_changes_no_other_error():
    true = walk(turn=0.0)
    silent = OdometryNoise(0.02, 0.0, 0.0, 30.0, 0.0, 0.0, fixed_scale=0.02)
    odom, covariance = simulate_odometry(TIMES_NS, true, silent, rng=np.random.default_rng(0))
    length = np.linalg.norm(true.translation[-1] - true.translation[0])
    assert np.linalg.norm(odom.translation[-1]) == pytest.approx(1.02 * length, rel=1e-6)
    noisy = [
        simulate_odometry(TIMES_NS, true, noise, rng=np.random.default_rng(0))
        for noise in (OdometryNoise(), OdometryNoise(fixed_scale=0.0), OdometryNoise(fixed_scale=0.02))
    ]
    for _, stated in noisy[1:]:
        np.testing.assert_array_equal(stated, noisy[0][1])
    np.testing.assert_array_equal(noisy[1][0].rotation, noisy[0][0].rotation)
    extra = np.linalg.norm(noisy[2][0].translation[-1] - noisy[1][0].translation[-1])
    assert extra == pytest.approx(0.02 * length, rel=0.02)
    assert (covariance[:, 0, 0] > 0).all()


@pytest.mark.parametrize("fixed_scale", [-1.5, 11.0, float("nan")])
def test_a_given_error_of_scale_that_cannot_be_is_refused(fixed_scale):
    with pytest.raises(VaporTrackError, match="fixed_scale is"):
        OdometryNoise(fixed_scale=fixed_scale)


def test_errors_over_a_tenth_of_a_second_are_slightly_smaller_than_stated():
    errors, stated = errors_over(5, 60, OdometryNoise())
    nees = np.einsum("ni,nij,nj->n", errors, np.linalg.inv(stated), errors)
    assert 0.5 * 6 < nees.mean() < 0.95 * 6
    # and in each direction by itself
    ratio = (errors**2).mean(axis=0) / stated.diagonal(axis1=1, axis2=2).mean(axis=0)
    assert (ratio < 1.0).all(), ratio
    assert (ratio > 0.4).all(), ratio


def test_drift_after_a_walk_is_some_per_cent_of_it_and_some_degrees():
    true = walk(turn=0.05)
    relative, turned = [], []
    for seed in range(60):
        odom, _ = simulate_odometry(TIMES_NS, true, OdometryNoise(), rng=np.random.default_rng(seed))
        away, angle = (true[0].inverse() @ true[-1]).distance(odom[-1])
        relative.append(away / (0.6 * 30))
        turned.append(np.degrees(angle))
    assert 0.01 < np.median(relative) < 0.06
    assert 1.0 < np.median(turned) < 5.0


def test_stamps_that_do_not_increase_or_are_not_as_many_as_the_poses_are_refused():
    times_ns = TIMES_NS.copy()
    times_ns[7] = times_ns[6]
    with pytest.raises(SequenceError, match=r"120000000 ns follows 120000000 ns, expected to increase"):
        simulate_odometry(times_ns, walk(), SILENT, rng=np.random.default_rng(0))
    with pytest.raises(SequenceError, match=r"1500 stamps for 1501 poses"):
        simulate_odometry(TIMES_NS[:-1], walk(), SILENT, rng=np.random.default_rng(0))
