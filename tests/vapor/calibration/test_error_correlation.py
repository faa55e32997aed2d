"""How long errors and mistakes about the place last, found from posteriors along simulated walks."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from filtering.measurement_noise import MeasurementNoise
from filtering.se3 import Poses
from tests.helpers.erring_posteriors import TRUE, fit, posteriors, walk
from tests.helpers.full import full
from vapor.calibration.error_correlation import (
    ErrorCorrelation,
    Travel,
    along_map,
    fit_error_correlation,
)
from vapor.calibration.image_errors import fit_errors
from vapor.calibration.places import Observations
from vapor.checkpoints.scene_scale import default_errors, scene_extent

pytestmark = pytest.mark.usefixtures("unchecked", "widest_places")  # that is what is found here as well

STEP = 0.1


def correlated(count: int, length_m: float, fraction: float, *, rng: np.random.Generator) -> np.ndarray:
    """Errors (n, 6) in standard deviations of images along a walk, of which this fraction of the variance lasts."""
    fade = np.exp(-STEP / length_m)
    kept = rng.standard_normal((count, 6))
    for i in range(1, count):
        kept[i] = fade * kept[i - 1] + np.sqrt(1 - fade**2) * kept[i]
    return np.sqrt(fraction) * kept + np.sqrt(1 - fraction) * rng.standard_normal((count, 6))


def fit_walk(normal: np.ndarray, *, rng: np.random.Generator):
    """The fit of images along a straight walk with these errors (n, 6)."""
    truth = walk(len(normal), STEP, rng=rng)
    samples = posteriors(truth, replace(TRUE, outlier_probability=1e-9), normal, rng=rng)
    return fit(samples, truth, Travel.along(truth, np.zeros(len(normal), np.int64)))


@cache
def fit_lasting(length_m: float, fraction: float):
    """The fit of a walk whose errors last so long, and which never mistakes the place."""
    rng = np.random.default_rng(1)
    return fit_walk(correlated(500, length_m, fraction, rng=rng), rng=rng)


@pytest.mark.parametrize(("length_m", "fraction"), [(0.5, 0.65), (2.0, 0.6)])
def test_how_long_errors_last_is_found(length_m, fraction):
    found = fit_lasting(length_m, fraction)
    assert length_m / 2 < found.noise.length_m < length_m * 2
    assert found.noise.correlated_fraction == pytest.approx(fraction, abs=0.12)
    expected = 1 + STEP * 500 / (2 * found.noise.length_m)
    assert found.effective_images == pytest.approx(expected, rel=0.05)
    assert found.noise.outlier_probability == 0.05


@cache
def mistaking(
    lasts: float, *, errors_last: float = 0.5, count: int = 500, seed: int = 0, same_conditions: bool = False
) -> MeasurementNoise:
    """The fit of a walk of which two fifths of the images take one wall for another, over segments so long."""
    rng = np.random.default_rng(seed)
    truth = walk(count, STEP, rng=rng)
    fade = np.exp(-STEP / lasts) if lasts else 0.0
    mood = rng.standard_normal(count)
    for i in range(1, count):
        mood[i] = fade * mood[i - 1] + np.sqrt(1 - fade**2) * mood[i]
    seen = Poses(truth.rotation, truth.translation + np.outer(mood < -0.25, [0.0, 0.0, 45.0]))
    normal = correlated(count, errors_last, 0.6, rng=rng)
    samples = posteriors(seen, replace(TRUE, outlier_probability=1e-9), normal, rng=rng)
    scene = Poses.concatenate([truth, Poses(truth.rotation, truth.translation + np.array([0.0, 0.0, 45.0]))])
    travel = Travel.along(truth, np.zeros(count, np.int64))
    before = default_errors(scene)
    return fit_errors(Observations(samples, truth, None), travel, scene, before, same_conditions=same_conditions).noise


@full
def test_how_long_a_place_is_mistaken_for_another_is_found_apart_from_how_long_errors_last():
    by_chance, one, four = mistaking(0.0), mistaking(1.0), mistaking(4.0)
    assert by_chance.outlier_lengths == pytest.approx(4.0, abs=0.5)  # one length more is taken to be, three times
    assert 4.0 < one.outlier_lengths < four.outlier_lengths
    # Both ways of the correlation, and three times that.
    assert one.outlier_lengths * one.length_m == pytest.approx(3 * 2.0, rel=0.6)
    assert four.outlier_lengths * four.length_m > 3 * 3.0


def test_where_conditions_are_those_of_use_mistakes_last_as_long_as_on_held_out_images():
    elsewhere, here = mistaking(1.0), mistaking(1.0, same_conditions=True)
    assert here.outlier_lengths - 1.0 == pytest.approx((elsewhere.outlier_lengths - 1.0) / 3)
    assert replace(here, outlier_lengths=elsewhere.outlier_lengths) == elsewhere


def test_mistakes_that_fade_sooner_than_errors_are_votes_closer_than_a_length():
    noise = mistaking(0.2, errors_last=2.0, same_conditions=True)
    assert noise.outlier_lengths < 0.6
    assert noise.outlier_lengths * noise.length_m == pytest.approx(2 * 0.2, rel=0.6)
    new_each_time = mistaking(0.0, errors_last=4.0, count=150, same_conditions=True)
    assert new_each_time.outlier_lengths >= 0.25


def test_images_that_never_mistake_the_place_are_worth_one_a_length():
    assert fit_lasting(0.5, 0.65).noise.outlier_lengths == pytest.approx(1.0, abs=0.5)


def found_correlation(normal: np.ndarray, truth: Poses, passes: int = 1, extent: float = 20.0) -> ErrorCorrelation:
    """What is found of errors (n, 6) of images at these poses, in passes of equal numbers."""
    travel = Travel.along(truth, np.repeat(np.arange(passes), len(truth) // passes))
    return fit_error_correlation(normal, np.ones(len(normal), bool), travel, extent)


def test_what_lasts_long_beside_what_fades_soon_is_seen():
    rng = np.random.default_rng(0)
    truth = walk(1000, STEP, rng=rng)
    worth = []
    for _ in range(5):
        soon, long = (correlated(1000, length_m, 1.0, rng=rng) for length_m in (0.2, 2.0))
        found = found_correlation(np.sqrt(0.6) * soon + np.sqrt(0.4) * long, truth)
        worth.append(found.fraction * found.length_m)
    assert np.median(worth) == pytest.approx(0.6 * 0.2 + 0.4 * 2.0, rel=0.3)


@pytest.mark.parametrize(("passes", "count"), [(1, 20), (4, 25), (1, 100)])
def test_few_images_give_no_lengths_that_run_away(passes, count):
    rng = np.random.default_rng(0)
    truth = walk(passes * count, STEP, rng=rng)
    longest = 0.15 * 10.0
    found = []
    for _ in range(40):
        normal = np.concatenate([correlated(count, 0.5, 0.6, rng=rng) for _ in range(passes)])
        found.append(found_correlation(normal, truth, passes, extent=10.0))
    assert np.mean([each.length_m > 0.99 * longest for each in found]) <= 0.25
    assert {each.length_rad for each in found} == {0.4}  # of a camera that never turns nothing is learned


def test_errors_that_last_along_the_map_are_found_while_the_camera_turns():
    rng = np.random.default_rng(1)
    walked, normal = walk(500, STEP, rng=rng), correlated(500, 2.0, 0.65, rng=rng)
    turned = Rotation.from_rotvec(np.outer(0.3 * np.arange(500), [0.0, 0.0, 1.0])).as_matrix()
    truth = Poses(turned, walked.translation)
    normal[:, :3] = np.einsum("nji,nj->ni", turned, normal[:, :3])  # in the camera's frame
    samples = posteriors(truth, replace(TRUE, outlier_probability=1e-9), normal, rng=rng)
    travel = replace(Travel.along(truth, np.zeros(500, np.int64)), radians=np.zeros(500))
    noise = fit(samples, truth, travel).noise
    assert 1.0 < noise.length_m < 4.0
    assert noise.correlated_fraction > 0.55


def test_errors_of_position_are_along_the_map_and_those_of_rotation_along_the_camera():
    quarter = Rotation.from_rotvec([0.0, 0.0, np.pi / 2]).as_matrix()
    found = along_map(np.arange(1.0, 7.0)[None], Poses(quarter[None], np.zeros((1, 3))))
    np.testing.assert_allclose(found, [[-2.0, 1.0, 3.0, 4.0, 5.0, 6.0]], atol=1e-12)


def test_images_in_one_place_say_nothing_of_lengths():
    truth = Poses(np.tile(np.eye(3), (60, 1, 1)), np.repeat([[0.0, 0.0, 0.0], [9.0, 9.0, 9.0]], 30, axis=0))
    found = found_correlation(np.random.default_rng(0).standard_normal((60, 6)), truth, passes=2)
    assert np.isfinite([found.length_m, found.length_rad]).all()
    assert found.fraction == 0.5


def test_errors_that_fade_as_the_camera_turns_are_told_from_those_that_fade_on_the_way():
    rng = np.random.default_rng(3)
    count = 800
    turning = np.repeat(rng.random(count // 20) < 0.5, 20)
    step_m, step_rad = np.where(turning, 0.01, 0.1), np.where(turning, 0.1, 0.0)
    rotation = Rotation.from_rotvec(np.outer(np.cumsum(step_rad), [0.0, 0.0, 1.0])).as_matrix()
    truth = Poses(rotation, np.column_stack([np.cumsum(step_m), np.zeros((count, 2))]))
    lengths_rad = []
    for length_m, length_rad in ((20.0, 0.3), (0.5, 20.0)):
        fade = np.exp(-np.hypot(step_m / length_m, step_rad / length_rad))
        normal = rng.standard_normal((count, 6))
        for i in range(1, count):
            normal[i] = fade[i] * normal[i - 1] + np.sqrt(1 - fade[i] ** 2) * normal[i]
        lengths_rad.append(found_correlation(normal, truth).length_rad)
    assert lengths_rad[0] < 0.7
    assert lengths_rad[1] > 1.0


def test_a_segment_of_larger_errors_does_not_lengthen_how_long_they_last():
    """Images err more in one part of the scene than in another: that lasts, but is no error that does."""
    found = []
    for larger in (1.0, 5.0):
        rng = np.random.default_rng(8)
        normal = correlated(180, 0.5, 0.6, rng=rng)
        normal[60:120] *= larger
        found.append(fit_walk(normal, rng=rng).noise)
    step_of_the_search = 50 ** (1 / 9)
    assert found[1].length_m <= 1.01 * step_of_the_search * found[0].length_m
    assert found[1].length_m < 1.0
    assert max(found[1].noise_floor) > 1.1 * max(found[0].noise_floor)


def test_errors_of_independent_images_last_no_longer_than_they_must():
    rng = np.random.default_rng(2)
    truth = walk(300, 0.1, rng=rng)
    samples = posteriors(truth, replace(TRUE, outlier_probability=1e-9), rng.standard_normal((300, 6)), rng=rng)
    found = fit(samples, truth, Travel.along(truth, np.zeros(300, np.int64))).noise
    assert (found.correlated_fraction, found.length_m) == (0.5, pytest.approx(0.003 * scene_extent(truth)))


def test_travel_counts_metres_and_radians_from_the_beginning_of_each_pass():
    turned = Poses.exp(np.array([[0, 0, 0, 0, 0, a] for a in (0.0, 0.1, 0.3, 0.3, 0.4)]))
    poses = Poses(turned.rotation, np.array([[0.0, 0, 0], [1, 0, 0], [1, 2, 0], [9, 9, 9], [9, 9, 8]]))
    travel = Travel.along(poses, np.array([3, 3, 3, 4, 4]))
    np.testing.assert_allclose(travel.metres, [0, 1, 3, 0, 1], atol=1e-12)
    np.testing.assert_allclose(travel.radians, [0, 0.1, 0.3, 0, 0.1], atol=1e-6)
    some = travel[np.array([1, 4])]
    np.testing.assert_allclose(some.metres, [1, 1])
