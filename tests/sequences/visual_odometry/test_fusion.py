"""Recorded and visual odometry together, by simulated motions."""

from dataclasses import replace

import numpy as np
import pytest

from filtering.motion import Odometry
from filtering.se3 import Poses
from sequences.visual_odometry.fusion import OdometryFusion

STEP_S = 1 / 30
WHEELS_STD = np.array([0.002] * 3 + [0.001] * 3)
EYES_STD = np.array([0.002] * 3 + [0.0005] * 3)
AHEAD = np.array([0.5 * STEP_S, 0, 0, 0, 0, 0.3 * STEP_S])


def reported(tangent, std, rng):
    moved = Poses.exp(tangent) @ Poses.exp(std * rng.standard_normal(6))
    return Odometry(moved, np.diag(std**2), STEP_S)


def in_units(tangent, unit):
    return tangent / np.array([unit] * 3 + [1.0] * 3)


def run(seconds, *, unit=1.0, slip=lambda _: 0.0, eyes=lambda _: True, wheels=lambda _: True, seed=0):
    """Fused motions of a straight drive at half a metre a second."""
    rng, fusion, found = np.random.default_rng(seed), OdometryFusion(), []
    for i in range(round(seconds / STEP_S)):
        slipping = AHEAD + np.array([slip(i * STEP_S) * STEP_S, 0, 0, 0, 0, 0])
        by_wheels, by_eyes = reported(slipping, WHEELS_STD, rng), reported(in_units(AHEAD, unit), EYES_STD, rng)
        found.append(fusion.step(by_wheels if wheels(i) else None, by_eyes if eyes(i) else None))
    return fusion, found


@pytest.mark.parametrize("unit", [0.4, 1.0, 2.5])
def test_the_unit_of_the_images_is_found_by_the_wheels(unit):
    fusion, _ = run(5.0, unit=unit)
    assert fusion.unit == pytest.approx(unit, rel=0.05)


def test_both_together_err_less_than_either_and_as_stated():
    _, found = run(20.0, unit=2.0)
    errors = np.array([each.previous_from_current.between(Poses.exp(AHEAD)).log() for each in found[150:]])
    assert (errors.std(axis=0)[3:] < 1.05 * EYES_STD[3:]).all()
    assert errors.std(axis=0)[0] < WHEELS_STD[0]
    squared = [e @ np.linalg.solve(each.covariance, e) for e, each in zip(errors, found[150:], strict=True)]
    assert 4.0 < np.mean(squared) < 8.0


def test_a_slip_shows_in_the_covariance_and_the_images_carry_on():
    fusion, found = run(10.0, unit=2.0, slip=lambda t: 0.2 if t > 5.0 else 0.0)
    assert fusion.unit == pytest.approx(2.0, rel=0.06)
    before, during = found[90:150], found[180:]
    moved = np.mean([each.previous_from_current.translation[0] for each in during])
    assert moved == pytest.approx(AHEAD[0], rel=0.15)
    wider = np.mean([each.covariance[0, 0] for each in during])
    assert wider > 3.0 * np.mean([each.covariance[0, 0] for each in before])


def test_where_one_is_unknown_the_other_is_the_motion_and_where_both_are_it_is_unknown():
    fusion, found = run(6.0, unit=2.0, eyes=lambda i: i < 120, wheels=lambda i: i < 90 or i > 150)
    assert [i for i, each in enumerate(found) if each is None] == list(range(120, 151))
    alone = found[100]  # images alone, in metres
    assert alone.previous_from_current.translation[0] == pytest.approx(AHEAD[0], abs=4 * 2 * EYES_STD[0])
    np.testing.assert_allclose(found[170].covariance, np.diag(WHEELS_STD**2))
    assert fusion.unit == pytest.approx(2.0, rel=0.1)


def test_standing_still_teaches_no_unit():
    rng, fusion = np.random.default_rng(0), OdometryFusion()
    for _ in range(300):
        fusion.step(reported(np.zeros(6), WHEELS_STD, rng), reported(np.zeros(6), 0.2 * EYES_STD, rng))
    _, found = run(0.1)
    assert 0.3 < fusion.unit < 3.0
    assert found[0] is not None


@pytest.mark.parametrize("begins_s", [0.0, 5.0])
def test_wheels_that_are_stuck_teach_no_unit(begins_s):
    """For three seconds, or from the beginning; the images dropped out for a moment just before."""
    rng, fusion, moved, variance = np.random.default_rng(0), OdometryFusion(), 0.0, 0.0
    for i in range(600):
        t = i * STEP_S
        stuck = begins_s <= t < begins_s + 3.0
        by_wheels = reported(np.zeros(6) if stuck else AHEAD, WHEELS_STD, rng)
        by_eyes = None if begins_s - 0.1 <= t < begins_s else reported(in_units(AHEAD, 2.0), EYES_STD, rng)
        motion = fusion.step(by_wheels, by_eyes)
        if t >= begins_s + 4.0:
            moved += motion.previous_from_current.translation[0]
            variance += motion.covariance[0, 0]
    expected = (20.0 - begins_s - 4.0) * 0.5
    assert moved == pytest.approx(expected, rel=0.1)
    assert fusion.unit == pytest.approx(2.0, rel=0.2)


def test_the_unit_is_never_less_known_than_at_the_beginning():
    rng, fusion = np.random.default_rng(0), OdometryFusion()
    still = [reported(np.zeros(6), 0.1 * WHEELS_STD, rng) for _ in range(2)]
    for _ in range(100):
        fusion.step(replace(still[0], duration_s=900.0), replace(still[1], duration_s=900.0))
    moving = fusion.step(None, reported(AHEAD, EYES_STD, rng))
    assert moving.covariance[0, 0] < 1.1 * 30 * AHEAD[0] ** 2 + 10 * EYES_STD[0] ** 2


@pytest.mark.parametrize("wrong_m_per_s", [0.2, 0.4])
def test_a_disagreement_that_lasts_is_within_what_is_stated_over_seconds(wrong_m_per_s):
    _, found = run(12.0, unit=2.0, slip=lambda t: wrong_m_per_s if 5.0 < t < 9.0 else 0.0)
    whole = Odometry.still()
    for each in found[round(5.0 / STEP_S) : round(9.0 / STEP_S)]:
        whole = whole.then(each)
    true = Poses.identity()
    for _ in range(round(4.0 / STEP_S)):
        true = true @ Poses.exp(AHEAD)
    error = whole.previous_from_current.between(true).log()
    assert error @ np.linalg.solve(whole.covariance, error) < 16.8
