"""How wrong odometry is, found from true poses."""

import json
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest

from filtering.motion import Odometry
from filtering.se3 import Poses
from sequences.errors import SequenceError
from sequences.odometry import OdometryNoise, simulate_odometry
from sequences.odometry_fit.fit import fit_odometry
from sequences.odometry_fit.pieces import OdometrySegment
from sequences.odometry_fit.result import OdometryFit
from sequences.trajectories.interpolation import interpolate
from sequences.trajectories.tum import read_tum
from tests.helpers.full import full

pytestmark = pytest.mark.usefixtures("unchecked")

NOISE = OdometryNoise()
WHITE = [0.008] * 3 + [0.003] * 3
SILENT = OdometryNoise(0.0, 0.0, 0.0, 30.0, 0.0, 0.0)
MOCAP = (0.001, 0.002)


def walk(times_ns: np.ndarray, seed: int) -> Poses:
    """A body that goes forward at 0.3 to 0.9 m/s, now left, now right."""
    phase = np.random.default_rng(seed).uniform(0, 2 * np.pi, 4)
    seconds, dt = times_ns[:-1] * 1e-9, np.diff(times_ns) * 1e-9
    twist = np.zeros((len(dt), 6))
    twist[:, 0] = 0.6 + 0.3 * np.sin(0.5 * seconds + phase[0])
    twist[:, 1] = 0.1 * np.sin(0.9 * seconds + phase[1])
    twist[:, 3] = 0.1 * np.sin(2.0 * seconds + phase[2])
    twist[:, 5] = 0.5 * np.sin(0.3 * seconds + phase[3])
    poses = [Poses.identity()]
    for step in Poses.exp(twist * dt[:, None]):
        poses.append(poses[-1] @ step)
    return Poses.stack(poses)


def segment(
    seed: int,
    noise: OdometryNoise = NOISE,
    *,
    every: int = 5,
    seconds: int = 30,
    jitter: tuple[float, float] = (0.0, 0.0),
    recording: int = 0,
) -> OdometrySegment:
    """Simulated odometry at 50 Hz, of which every so many messages are taken; true poses with independent noise."""
    times_ns = 20_000_000 * np.arange(seconds * 50 + 1)
    true, rng = walk(times_ns, seed), np.random.default_rng(seed + 1000)
    odometry, _ = simulate_odometry(times_ns, true, noise, rng=rng)
    at = np.arange(0, len(times_ns), every)
    measured = true[at] @ Poses.exp(rng.standard_normal((len(at), 6)) * np.repeat(jitter, 3))
    return of_poses(odometry[at], measured, 0.02 * every, recording)


def of_poses(odometry: Poses, truth: Poses, step_s: float, recording: int = 0) -> OdometrySegment:
    steps = odometry[:-1].inverse() @ odometry[1:]
    return OdometrySegment([Odometry(step, np.zeros((6, 6)), step_s) for step in steps], truth, recording)


def scale_drawn(seed: int) -> float:
    """The scale error of `segment`, the first number that the simulation draws."""
    return NOISE.scale * np.random.default_rng(seed + 1000).standard_normal()


SEEDS = range(4)  # of as many recordings


@pytest.fixture(scope="module")
def fit() -> OdometryFit:
    return fit_odometry([segment(s, seconds=40, jitter=MOCAP, recording=s) for s in SEEDS])


def test_white_noise_drift_and_scale_of_simulated_odometry_are_found(fit: OdometryFit) -> None:
    np.testing.assert_allclose(np.sqrt(fit.white_per_s), WHITE, rtol=0.2)
    assert not any(fit.white_per_m)
    # Four recordings are hardly more draws of a drift that changes over 30 s.
    drift = np.array(fit.drift)[[0, 1, 2, 5]] / [0.008, 0.008, 0.008, 0.0015]
    assert (drift > 0.4).all(), drift
    assert (drift < 2.0).all(), drift
    assert max(fit.drift[3:5]) < 0.001  # there is none: what could not be seen
    assert 10.0 < fit.time_s < 90.0
    np.testing.assert_allclose(fit.pose_noise[3:], MOCAP[1], rtol=0.15)
    assert abs(fit.scale - np.mean([scale_drawn(s) for s in SEEDS])) < 3 * fit.scale_error
    assert 0.005 < fit.scale_std < 0.04
    assert max(fit.white_error) < 0.2
    assert (fit.increments, fit.recordings) == (1600, 4)
    assert fit.seconds == pytest.approx(160)


def test_true_poses_that_jitter_do_not_pass_for_white_noise() -> None:
    jittering = segment(3, every=2, seconds=15, jitter=MOCAP)
    reported = Poses.stack([step.previous_from_current for step in jittering.odometry])
    errors = ((jittering.truth[:-1].inverse() @ jittering.truth[1:]).inverse() @ reported).log()
    naive = errors.std(axis=0) / np.sqrt(0.04)
    assert (naive[3:] > 4 * 0.003).all()  # precondition: as it looks
    fit = fit_odometry([jittering])
    np.testing.assert_allclose(np.sqrt(fit.white_per_s), WHITE, rtol=0.35)
    np.testing.assert_allclose(fit.pose_noise, np.repeat(MOCAP, 3), rtol=0.35)


@full
def test_white_noise_that_grows_with_distance_is_told_from_that_which_grows_with_time() -> None:
    rng, per_sqrt_m = np.random.default_rng(0), np.array([0.03, 0.03, 0.02, 0.02, 0.02, 0.01])
    times_ns = 100_000_000 * np.arange(601)
    seconds = times_ns[:-1] * 1e-9
    twist = np.zeros((600, 6))
    twist[:, 2] = np.where(seconds % 10 < 4, 0.0, 0.8) * 0.1  # it stops every now and then
    moved = np.linalg.norm(twist[:, :3], axis=1)
    reported = twist + rng.standard_normal((600, 6)) * (per_sqrt_m * np.sqrt(moved)[:, None] + 0.002 * np.sqrt(0.1))
    odometry = [Odometry(Poses.exp(step), np.zeros((6, 6)), 0.1) for step in reported]
    poses = [Poses.identity()]
    for step in twist:
        poses.append(poses[-1] @ Poses.exp(step))
    fit = fit_odometry([OdometrySegment(odometry, Poses.stack(poses))])
    np.testing.assert_allclose(np.sqrt(fit.white_per_m), per_sqrt_m, rtol=0.25)
    at_rest = fit.along(np.zeros(6), np.array(1.0))
    assert (np.sqrt(at_rest) < 0.008).all()


@full
def test_scale_errors_are_not_blurred_by_true_poses_that_jitter() -> None:
    """Errors and true motion share the noise of the true poses: plain regression finds 1.5 % too little here."""
    scaled = OdometryNoise(0.0, 0.0, 0.0, 30.0, 0.001, 0.001)
    segments = [segment(s, scaled, every=2, seconds=15, jitter=(0.003, 0.0)) for s in range(3)]
    v = np.concatenate([(s.truth[:-1].inverse() @ s.truth[1:]).log()[:, 0] for s in segments])
    odometry = np.concatenate([[o.previous_from_current.log()[0] for o in s.odometry] for s in segments])
    assert ((odometry - v) @ v) / (v @ v) < -0.01  # precondition
    fit = fit_odometry(segments)
    assert abs(fit.scale) < 0.005
    assert fit.scale_error < 0.005


def test_a_jump_is_cut_and_counted() -> None:
    usual = segment(5)
    jumping = list(usual.odometry)
    jumping[77] = replace(jumping[77], previous_from_current=Poses.exp(np.array([1.0, 0.5, 0, 0, 0, 1.0])))
    fit, without = fit_odometry([replace(usual, odometry=jumping)]), fit_odometry([usual])
    assert fit.clipped >= 2
    ratio = np.array(fit.white_per_s) / np.array(without.white_per_s)
    assert (ratio < 1.3).all(), ratio


def test_increments_that_take_no_time_are_put_together_with_the_next() -> None:
    usual = segment(7, seconds=15)
    split, truth = [], [0]
    for i, step in enumerate(usual.odometry):
        if i == 50:
            split.append(Odometry(Poses.identity(), np.zeros((6, 6)), 0.0))
            truth.append(i)
        split.append(step)
        truth.append(i + 1)
    fit = fit_odometry([OdometrySegment(split, usual.truth[truth])])
    np.testing.assert_allclose(fit.white_per_s, fit_odometry([usual]).white_per_s, rtol=1e-6)
    assert fit.increments == 151


def test_a_fit_survives_json_and_says_what_it_found(fit: OdometryFit) -> None:
    assert OdometryFit.from_dict(json.loads(json.dumps(asdict(fit)))) == fit
    text = str(fit)
    for word in ("1600 increments", "4 recordings", "white after 1 s", "drift", "scale", "±", "mm"):
        assert word in text


def test_what_is_no_fit_is_refused(fit: OdometryFit) -> None:
    values = asdict(fit)
    without_scale = {key: value for key, value in values.items() if key != "scale"}
    for changed, message in [
        (values | {"wheels": 4}, "with wheels missing or one too many, expected clipped, drift"),
        (without_scale, "with scale missing or one too many"),
        (values | {"drift": ["a"] * 6}, r"drift is \['a', .*, expected six numbers of 0 or more"),
        (values | {"white_per_s": [1.0] * 5}, "white_per_s is .*, expected six numbers"),
        (values | {"time_s": -1.0}, "time_s is -1.0, expected a number of 0 or more"),
        (values | {"scale": float("nan")}, "scale is nan, expected a number$"),
    ]:
        with pytest.raises(SequenceError, match=message):
            OdometryFit.from_dict(changed)


def test_the_filter_takes_drift_and_scale_and_restated_increments_compose(fit: OdometryFit) -> None:
    assert fit.odometry_bias.drift == fit.drift
    assert fit.odometry_bias.scale == fit.scale_std
    whole, half = Poses.exp(np.array([0.4, 0, 0.2, 0, 0.6, 0])), Poses.exp(np.array([0.2, 0, 0.1, 0, 0.3, 0]))
    part = fit.restated(Odometry(half, np.eye(6), 0.5))
    stated = fit.restated(Odometry(whole, np.eye(6), 1.0))
    np.testing.assert_allclose(part.then(part).covariance, stated.covariance, rtol=1e-9, atol=1e-15)
    still = fit.restated(Odometry(Poses.identity(), np.eye(6), 2.0))
    np.testing.assert_allclose(still.covariance, 2 * np.diag(fit.white_per_s))


def test_too_little_and_what_does_not_match_is_refused() -> None:
    usual = segment(8)
    with pytest.raises(SequenceError, match="99 increments of odometry, expected at least 100"):
        fit_odometry([OdometrySegment(usual.odometry[:99], usual.truth[:100])])
    with pytest.raises(SequenceError, match="segment 0: 300 true poses of 300 increments"):
        fit_odometry([replace(usual, truth=usual.truth[:300])])


def test_a_real_camera_tracker_errs_by_distance(shared_data: Path) -> None:
    folder = shared_data / "tum_fr1" / "rgbd_dataset_freiburg1_xyz"
    truth, odometry = read_tum(folder / "groundtruth.txt"), read_tum(folder / "rgbdslam.txt")
    real, covered = interpolate(truth.times_ns, truth.poses, odometry.times_ns, max_gap_s=0.1)
    at = np.flatnonzero(covered)
    at = at[at > at[np.argmax(np.diff(at))]] if np.diff(at).max() > 1 else at
    steps, seconds = odometry.poses[at[:-1]].inverse() @ odometry.poses[at[1:]], np.diff(odometry.times_ns[at]) * 1e-9
    increments = [Odometry(step, np.zeros((6, 6)), float(s)) for step, s in zip(steps, seconds, strict=True)]
    fit = fit_odometry([OdometrySegment(increments, real[at])], max_increments=400)
    white_m = np.sqrt(fit.along(np.array([0.3, 0, 0, 0, 0, 0]), np.array(1.0)))  # at the speed of the hand
    assert (white_m[:3] > 0.005).all(), fit
    assert (white_m[:3] < 0.03).all(), fit
    assert abs(fit.scale) < 0.05
