"""Odometry that drops out in a turn while a gyroscope goes on: the filter's rotation, velocity and hindsight."""

from functools import cache

import numpy as np
import pytest

from filtering.config import GapConfig, LocalizerConfig
from filtering.hindsight import FilterStep
from filtering.kalman import KalmanConfig, KalmanLocalizer
from filtering.localizer import ParticleLocalizer
from filtering.motion import Odometry, joined, measured
from filtering.observation import Observation
from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from filtering.smoothing import SmoothingConfig, smooth
from sequences.inertial.gyroscope import GyroscopeFusion
from sequences.inertial.samples import InertialSamples
from sequences.inertial.simulation import InertialNoise, simulate_inertial
from tests.helpers.simulation import ERRORS, RNG, STD, image_errors, seen_at

pytestmark = pytest.mark.usefixtures("unchecked")

HZ, IMAGE_NS, BEGIN_NS = 200, 100_000_000, 10**18
BEFORE, DROPS_OUT = 120, 20  # images: 12 s, in which the bias is found, and 2 s
TURN_RAD_PER_S = np.radians(45.0)


@cache
def turning():
    """Poses of a camera that walks and turns, at the samples of a simulated small unit, and the samples."""
    count = (BEFORE + DROPS_OUT + 20) * HZ // 10
    t = np.arange(count) / HZ
    rate = np.where(t < 0.1 * BEFORE, 0.3 * np.sin(0.7 * t), TURN_RAD_PER_S)
    steps = np.zeros((count - 1, 6))
    steps[:, 2], steps[:, 4] = 1.0 / HZ, rate[:-1] / HZ
    poses = [Poses.from_matrix(np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 1.5], [0, 0, 0, 1]]))]
    for step in Poses.exp(steps):
        poses.append(poses[-1] @ step)
    poses, times_ns = Poses.stack(poses), BEGIN_NS + (t * 1e9).round().astype(np.int64)
    force, turn_rate = simulate_inertial(times_ns, poses, InertialNoise(), rng=RNG(0))
    return InertialSamples(times_ns, force, turn_rate), poses[:: HZ // 10]


def walked(localizer, *, gyroscope, sees=False, seed=0):
    """Estimates of each image, with what was observed, and the true pose at the end.

    In the dropout images show places, or nothing.
    """
    samples, poses = turning()
    fusion, rng, found = GyroscopeFusion(samples), RNG(seed), []
    errors = image_errors(np.full(BEFORE + DROPS_OUT, 0.3), ERRORS, rng=rng)
    for i in range(BEFORE + DROPS_OUT + 1):
        motion = None
        if i and i <= BEFORE:
            error = 0.003 * rng.standard_normal(6)
            motion = Odometry(poses[i - 1].between(poses[i]) @ Poses.exp(error), 9e-6 * np.eye(6), 0.1)
        if i and gyroscope:
            motion = fusion.step(BEGIN_NS + (i - 1) * IMAGE_NS, BEGIN_NS + i * IMAGE_NS, motion)
        shows = sees or i <= BEFORE
        seen = seen_at(poses[i] @ Poses.exp(STD * errors[i])) if shows else PosePosterior.uninformative(ERRORS)
        observation = Observation.of_posterior(seen, motion, 0.1)
        found.append((localizer.advance(observation), observation))
    return found, poses[BEFORE + DROPS_OUT]


def off_deg(pose, truth):
    return float(np.degrees(pose.distance(truth)[1]))


def new_filter():
    return ParticleLocalizer(None, LocalizerConfig(), rng=RNG(0))


def test_the_rotation_is_known_after_two_seconds_in_a_turn_and_its_error_is_stated():
    off, stated = {}, {}
    for gyroscope in (False, True):
        found, truth = walked(new_filter(), gyroscope=gyroscope)
        best = found[-1][0].modes[0]
        off[gyroscope] = off_deg(best.world_from_camera, truth)
        stated[gyroscope] = float(np.degrees(np.sqrt(best.covariance[4, 4])))
    assert off[False] > 60.0  # it turned by 90°
    assert stated[False] > 30.0
    assert off[True] < 3.0
    assert off[True] < 3.0 * stated[True] < 15.0


def test_how_far_the_camera_went_stays_as_unknown_as_without():
    stds = []
    for gyroscope in (False, True):
        found, _ = walked(new_filter(), gyroscope=gyroscope)
        stds.append(np.sqrt(np.trace(found[-1][0].modes[0].covariance[:3, :3])))
    assert stds[1] == pytest.approx(stds[0], rel=0.3)
    assert stds[1] > 3.0  # a brisk walk of two seconds along each axis


def test_images_find_the_velocity_as_they_do_without():
    """The last image is predicted by the velocity that those before it showed."""
    for gyroscope in (False, True):
        off = []
        for seed in range(3):
            found, truth = walked(new_filter(), gyroscope=gyroscope, sees=True, seed=seed)
            before = turning()[1][BEFORE + DROPS_OUT - 1]
            gap = found[-1][0].gap_motion
            assert gap is not None
            moved = gap.likely.translation @ np.array([0, 0, 1.0])
            off.append(abs(moved - before.between(truth).translation[2]))
        assert np.mean(off) < 0.06, "of a step of 0.1 m; nothing is known beforehand"


def test_hindsight_turns_along():
    found, truth = walked(new_filter(), gyroscope=True)
    best = smooth([FilterStep.of(observation, estimate) for estimate, observation in found], ERRORS).best
    assert off_deg(best.poses[-1], truth) < 3.0
    assert off_deg(best.poses[BEFORE], turning()[1][BEFORE]) < 3.0
    assert np.degrees(np.sqrt(best.covariance[-1, 4, 4])) < 5.0


def test_hindsight_allows_for_the_speed_of_a_gap_where_the_turn_is_known():
    """A fast camera whose odometry drops out was not carried off."""
    config, pose, steps = LocalizerConfig(gap=GapConfig(speed_m_per_s=20.0)), Poses.identity(), []
    localizer, rng = ParticleLocalizer(None, config, rng=RNG(0)), RNG(1)
    for i in range(30):
        moved = Poses.exp(np.array([0, 0, 20.0 if i == 15 else 0.1, 0, 0.02, 0]))
        known = Odometry(moved, 1e-6 * np.eye(6), 0.1) if i != 15 else Odometry.turn(moved, 1e-6 * np.eye(3), 1.0)
        pose = pose @ moved if i else pose
        seen = seen_at(pose @ Poses.exp(0.3 * STD * rng.standard_normal(6)))
        observation = Observation.of_posterior(seen, known if i else None, 0.1)
        steps.append(FilterStep.of(observation, localizer.advance(observation)))
    hindsight = smooth(steps, ERRORS, SmoothingConfig.of_filter(config))
    assert not hindsight.carried_off.any()
    assert hindsight.best.poses[-1].distance(pose)[0] < 0.1


def test_the_kalman_baseline_turns_along():
    found, truth = walked(KalmanLocalizer(KalmanConfig()), gyroscope=True)
    assert off_deg(found[-1][0].world_from_camera, truth) < 3.0


def test_turns_compose_and_make_a_whole_motion_of_unknown_length():
    samples, _ = turning()
    fusion = GyroscopeFusion(samples)
    parts = [
        fusion.step(BEGIN_NS + i * IMAGE_NS, BEGIN_NS + (i + 1) * IMAGE_NS, None)
        for i in range(BEFORE, BEFORE + DROPS_OUT)
    ]
    known = Odometry(Poses.exp(np.array([0, 0, 0.1, 0, 0, 0])), 1e-6 * np.eye(6), 0.1)
    whole, with_known = joined(parts), joined([known, *parts])
    assert measured(whole) is None
    assert measured(with_known) is None
    assert with_known.duration_s == pytest.approx(2.1)
    assert np.degrees(np.linalg.norm(whole.tangent[3:])) == pytest.approx(90.0, abs=2.0)
    np.testing.assert_array_equal(whole.previous_from_current.translation, np.zeros(3))
    part = whole.part(0.5)
    again = part.then(whole.after(part))
    np.testing.assert_allclose(again.tangent, whole.tangent, atol=1e-9)
    assert not again.knows_translation
