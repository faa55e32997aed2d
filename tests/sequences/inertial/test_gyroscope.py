"""Turns by a gyroscope: exact, less a bias that is found, and odometry whose rotation they correct."""

from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from filtering.motion import Odometry
from filtering.se3 import Poses
from sequences.inertial.gyroscope import GyroscopeFusion
from sequences.inertial.samples import InertialSamples
from sequences.inertial.sequence import InertialSequence
from sequences.inertial.simulation import InertialNoise, simulate_inertial
from sequences.reading.counts import ImageCounts
from tests.helpers.simulation import RNG, frames_of

HZ, FRAME_NS = 100, 100_000_000
BEGIN_NS = 10**18


def walk(seconds, *, rng, bias=(0.0, 0.0, 0.0), white=0.0, turning=1.0):
    """Samples of a camera that turns about all axes, and its poses at them, by the samples' own rates."""
    count = round(seconds * HZ)
    t = np.arange(count) / HZ
    rate = turning * np.stack([0.5 * np.sin(0.7 * t), 0.3 * np.cos(1.1 * t), 0.6 * np.sin(0.4 * t + 1)], axis=1)
    middle = (rate[:-1] + rate[1:]) / 2
    rotation = [np.eye(3)]
    for each in Poses.exp(np.column_stack([np.zeros((count - 1, 3)), middle / HZ])):
        rotation.append(rotation[-1] @ each.rotation)
    measured = rate + np.array(bias) + white * np.sqrt(HZ) * rng.standard_normal((count, 3))
    times_ns = BEGIN_NS + (t * 1e9).round().astype(np.int64)
    poses = Poses(np.stack(rotation), np.column_stack([t, 0 * t, 0 * t]))
    return InertialSamples(times_ns, np.full((count, 3), np.nan), measured), poses


def motions(poses, *, rng, std, every=HZ // 10):
    """Odometry from frame to frame that errs by so many radians and metres about each axis."""
    at = poses[::every]
    for i in range(1, len(at)):
        true = at[i - 1].between(at[i])
        error = std * rng.standard_normal(6)
        yield i, true, Odometry(true @ Poses.exp(error), std**2 * np.eye(6), FRAME_NS * 1e-9)


def fused(samples, poses, *, rng, std, change=lambda i, odometry: odometry):
    """The fusion, and the errors of the rotation of each motion before and after it, radians."""
    fusion, before, after, stated = GyroscopeFusion(samples), [], [], []
    for i, true, odometry in motions(poses, rng=rng, std=std):
        odometry = change(i, odometry)
        found = fusion.step(BEGIN_NS + (i - 1) * FRAME_NS, BEGIN_NS + i * FRAME_NS, odometry)
        for each, errors in ((odometry, before), (found, after)):
            errors.append(each.previous_from_current.between(true).log()[3:])
        stated.append(np.sqrt(np.diag(found.covariance)[3:]))
    return fusion, np.array(before), np.array(after), np.array(stated)


def rms(errors):
    return float(np.sqrt(np.mean(np.square(errors))))


def test_a_turn_between_any_two_times_is_that_of_the_rates():
    samples, poses = walk(3.0, rng=RNG(0))
    fusion = GyroscopeFusion(samples)
    turned = fusion.turned(BEGIN_NS + 500_000_000, BEGIN_NS + 2_000_000_000)
    np.testing.assert_allclose(turned.rotation, poses[50].between(poses[200]).rotation, atol=1e-5)
    halfway = fusion.turned(BEGIN_NS + 505_000_000, BEGIN_NS + 2_003_000_000)
    first, last = poses[50].interpolate(poses[51], 0.5), poses[200].interpolate(poses[201], 0.3)
    np.testing.assert_allclose(halfway.rotation, first.between(last).rotation, atol=1e-4)


def test_odometry_turns_as_exactly_as_the_gyroscope_and_says_so():
    samples, poses = walk(20.0, rng=RNG(0), white=3e-4)
    _, before, after, stated = fused(samples, poses, rng=RNG(1), std=0.01)
    assert rms(after[50:]) < 0.2 * rms(before[50:])
    assert rms(after[50:] / stated[50:]) < 1.0


def test_the_bias_is_found_against_odometry_and_taken_away():
    bias = np.array([0.02, -0.015, 0.01])
    samples, poses = walk(60.0, rng=RNG(0), bias=bias)
    fusion, before, after, _ = fused(samples, poses, rng=RNG(1), std=0.002)
    np.testing.assert_allclose(fusion.bias, bias, atol=0.003)
    assert rms(after[300:]) < 0.6 * rms(before[300:])


def test_an_error_of_the_translation_that_comes_with_the_rotations_is_corrected_with_it():
    samples, poses = walk(1.0, rng=RNG(0))
    lever = np.eye(6)
    lever[1, 5] = 0.5  # what turns too far about z is too far along y
    covariance = lever @ np.diag([1e-8] * 3 + [1e-4] * 3) @ lever.T
    true = poses[0].between(poses[10])
    wrong = Odometry(true @ Poses.exp(lever @ np.array([0, 0, 0, 0, 0, 0.01])), covariance, 0.1)
    found = GyroscopeFusion(samples).step(BEGIN_NS, BEGIN_NS + FRAME_NS, wrong)
    left = found.previous_from_current.between(true).log()
    assert abs(left[5]) < 0.005
    assert abs(left[1]) < 0.0025
    assert abs(wrong.previous_from_current.between(true).log()[1]) > 0.0045


def test_exact_odometry_stays_as_it_is():
    samples, poses = walk(5.0, rng=RNG(0), bias=(0.02, 0.02, 0.02))
    _, before, after, _ = fused(samples, poses, rng=RNG(1), std=1e-6)
    np.testing.assert_allclose(after, before, atol=1e-5)


def test_where_odometry_slips_in_a_turn_the_gyroscope_counts_and_the_report_says_so():
    samples, poses = walk(20.0, rng=RNG(0))

    def slips(i, odometry):
        if 100 <= i < 110:
            turned = odometry.previous_from_current @ Poses.exp(np.array([0, 0, 0, 0, 0, 0.2]))
            return replace(odometry, previous_from_current=turned)
        return odometry

    fusion, before, after, _ = fused(samples, poses, rng=RNG(1), std=0.005, change=slips)
    assert rms(before[99:109]) > 0.1
    assert rms(after[99:109]) < 0.005
    assert fusion.num_disputed == 10
    assert "in 10 of 199 motions" in fusion.notices[0]


@pytest.mark.parametrize("wrong", [lambda rate: np.degrees(rate), lambda rate: -rate, lambda rate: rate[:, [2, 0, 1]]])
def test_a_gyroscope_in_degrees_or_of_other_axes_is_soon_not_used_and_said(wrong):
    samples, poses = walk(60.0, rng=RNG(0))
    samples = replace(samples, turn_rate=wrong(samples.turn_rate))
    fusion, before, after, _ = fused(samples, poses, rng=RNG(1), std=0.002)
    np.testing.assert_allclose(after[60:], before[60:])
    assert "not those of the odometry" in fusion.notices[0]


def test_across_a_gap_and_without_rates_odometry_stays_as_it_is():
    samples, poses = walk(5.0, rng=RNG(0))
    rates = samples.turn_rate.copy()
    rates[200:260] = np.nan
    kept = np.delete(np.arange(500), range(200, 260))
    missing = InertialSamples(samples.times_ns[kept], samples.force[kept], samples.turn_rate[kept])
    for broken in (replace(samples, turn_rate=rates), missing):
        _, before, after, _ = fused(broken, poses, rng=RNG(1), std=0.01)
        np.testing.assert_allclose(after[21:25], before[21:25])
        assert rms(after[:15]) < 0.7 * rms(before[:15])


def test_without_odometry_the_turn_is_known_and_the_way_is_not():
    bias = np.array([0.02, -0.015, 0.01])
    samples, poses = walk(60.0, rng=RNG(0), bias=bias, white=3e-4)
    fusion, *_ = fused(samples, poses, rng=RNG(1), std=0.002)
    found = fusion.step(BEGIN_NS + 30 * 10**9, BEGIN_NS + 32 * 10**9, None)
    assert not found.knows_translation
    error = found.previous_from_current.between(poses[3000].between(poses[3200])).log()[3:]
    stated = np.sqrt(np.diag(found.covariance)[3:])
    assert (np.abs(error) < 3 * stated).all()
    assert stated.max() < 0.05
    assert "only the turns are known of 1 motion without odometry" in fusion.notices[0]
    blind = replace(samples, turn_rate=np.full_like(samples.turn_rate, np.nan))
    assert GyroscopeFusion(blind).step(BEGIN_NS, BEGIN_NS + FRAME_NS, None) is None


def test_a_gyroscope_that_is_wrong_does_not_say_how_it_turned_without_odometry():
    samples, poses = walk(60.0, rng=RNG(0))
    fusion, *_ = fused(replace(samples, turn_rate=-samples.turn_rate), poses, rng=RNG(1), std=0.002)
    assert fusion.step(BEGIN_NS + 30 * 10**9, BEGIN_NS + 32 * 10**9, None) is None


def test_a_simulated_unit_measures_the_motion_to_within_its_errors():
    count, noise = 500, InertialNoise(0.0, 0.0, 0.0, 0.0, 0.0)
    t = np.arange(count) * 0.02
    tangent = np.column_stack([np.sin(t), 0.3 * t, 0 * t, 0 * t, 0 * t, 0 * t])
    turned = Poses.exp(np.column_stack([np.zeros((count, 3)), 0.2 * np.sin(t), 0.1 * np.cos(t), 0.5 * t]))
    poses = Poses(turned.rotation, tangent[:, :3])
    times_ns = BEGIN_NS + (t * 1e9).round().astype(np.int64)
    force, rate = simulate_inertial(times_ns, poses, noise, rng=RNG(0))
    samples = InertialSamples(times_ns, force, rate)
    whole = GyroscopeFusion(samples).turned(int(times_ns[50]), int(times_ns[450]))
    np.testing.assert_allclose(whole.rotation, poses[50].between(poses[450]).rotation, atol=2e-3)
    up = np.einsum("kji,j->ki", poses.rotation, [0, 0, 1.0])
    expected = 9.80665 * up - np.einsum("kji,kj->ki", poses.rotation, np.column_stack([np.sin(t), 0 * t, 0 * t]))
    np.testing.assert_allclose(force[5:-5], expected[5:-5], atol=2e-3)


class ImagesOnly:
    """A sequence of frames at hand."""

    path, camera, image_description, odometry_description = Path("frames"), None, None, None
    odometry_origin, no_odometry, notices, skipped, resolved = "recorded", "", [], Counter(), {}

    def __init__(self, frames):
        self.frames, self.num_images, self.counts = frames, len(frames), ImageCounts(len(frames))

    def __iter__(self):
        return iter(self.frames)


def test_a_sequence_is_read_twice_alike():
    source = ImagesOnly(frames_of(20))
    samples, _ = walk(3.0, rng=RNG(0))
    samples = replace(samples, times_ns=samples.times_ns - BEGIN_NS)
    sequence = InertialSequence(source, samples, [])
    first, second = ([frame.odometry for frame in sequence] for _ in range(2))
    assert first[0] is None
    for one, other, recorded in zip(first[1:], second[1:], source.frames[1:], strict=True):
        np.testing.assert_array_equal(one.covariance, other.covariance)
        assert not np.array_equal(one.covariance, recorded.odometry.covariance)
