"""The fit of an ErrorModel, on posteriors that err as one says."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from filtering.error_model import ErrorModel
from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from vapor.calibration.image_errors import fit_errors
from vapor.calibration.kernel_widths import fit_widths
from vapor.calibration.lasting_errors import LastingErrors, lasting_errors
from vapor.calibration.observations import Observations
from vapor.calibration.travel import Travel
from vapor.checkpoints.scene_scale import default_errors, flat_log_density, scene_extent

pytestmark = pytest.mark.usefixtures("unchecked")

ROOM = np.array([10.0, 6.0, 2.0])
TRUE = ErrorModel(spread=2.0, floor=(0.05, 0.1, 0.03, 0.02, 0.03, 0.02), tail=5.0, outlier_share=0.1)
UNIT = np.repeat([1.0, 0.5], 3)


def anywhere(count: int, *, rng: np.random.Generator) -> Poses:
    turned = rng.uniform(-1, 1, (count, 6)) * [0, 0, 0, 0.3, 0.3, 3.0]
    return Poses(Poses.exp(turned).rotation, rng.uniform(0, 1, (count, 3)) * ROOM)


def apart(count: int) -> Travel:
    """The way between images of a pass each."""
    return Travel(np.arange(count), np.zeros(count), np.zeros(count))


def posteriors(
    truth: Poses, errors: ErrorModel, normal: np.ndarray, *, rng: np.random.Generator, num_samples: int = 80
):
    """Samples of each image whose places are off by these errors (n, 6) in standard deviations."""
    samples = []
    for i, own in enumerate(normal):
        spread = 0.06 * UNIT * np.exp(rng.normal(0.0, 0.8))  # of the samples
        xi = np.sqrt(errors.spread * np.square(spread) + np.square(errors.floor)) * own
        centre = anywhere(1, rng=rng)[0] if rng.random() < errors.outlier_share else truth[i] @ Poses.exp(-xi)
        samples.append(centre @ Poses.exp(spread * rng.standard_normal((num_samples, 6))))
    return samples


def student(count: int, tail: float, *, rng: np.random.Generator) -> np.ndarray:
    return rng.standard_normal((count, 6)) * np.sqrt(tail / rng.chisquare(tail, (count, 1)))


@cache
def simulated(count: int = 400):
    rng = np.random.default_rng(0)
    truth = anywhere(count, rng=rng)
    return posteriors(truth, TRUE, student(count, TRUE.tail, rng=rng), rng=rng), truth


def fit(samples, truth, way=None, before=None, *, score=None, trained=None):
    before = before or default_errors(truth)
    return fit_errors(Observations(samples, truth, score), way or apart(len(truth)), truth, before, trained=trained)


@cache
def fitted():
    return fit(*simulated())


def test_spread_floor_tail_and_outliers_of_known_errors_are_found():
    errors = fitted().errors
    assert errors.spread == pytest.approx(TRUE.spread, rel=0.35)
    np.testing.assert_allclose(errors.floor, TRUE.floor, rtol=0.3)
    assert 3.0 < errors.tail < 10.0
    assert errors.outlier_share == pytest.approx(TRUE.outlier_share, abs=0.05)  # three standard deviations
    spread = 0.06 * UNIT * np.sqrt(TRUE.spread)
    np.testing.assert_allclose(errors.typical_std, np.hypot(spread, TRUE.floor), rtol=0.25)
    assert errors.flat_log_density == flat_log_density(simulated()[1])
    assert errors.possible_share == 0.05
    assert 0.1 < errors.constant_share < 0.2  # a little more than by default: the images are many
    assert fitted().effective_images == len(simulated()[1])


def test_regions_of_single_images_hold_as_many_true_poses_as_they_say_but_for_outliers():
    right = np.array([0.5, 0.9, 0.95]) * (1 - TRUE.outlier_share)
    np.testing.assert_allclose(fitted().coverage, right, atol=0.08)


def test_what_changed_is_told_with_its_gain():
    image, lasting = fitted().changes
    names = ("radius_m", "spread", "floor", "tail", "outlier_share", "unfamiliar_power")
    assert image.after == {name: getattr(fitted().errors, name) for name in names}
    assert image.before["tail"] == ErrorModel().tail
    assert image.gain is not None
    assert image.gain > 0.5
    assert (set(lasting.after), lasting.gain) == ({"lasting_share", "length_m", "length_rad", "mistaken_lengths"}, None)
    few = simulated(100)
    again = fit(*few, before=fit(*few).errors).changes[0]
    assert again.gain == pytest.approx(0.0, abs=1e-6)


def test_the_fit_is_the_same_in_a_scene_thirty_times_as_large():
    samples, truth = simulated(100)
    larger = [Poses(poses.rotation, 30.0 * poses.translation) for poses in (*samples, truth)]
    found, expected = fit(larger[:-1], larger[-1]).errors, fit(samples, truth).errors.scaled(30.0)
    for name in ("radius_m", "spread", "tail", "outlier_share", "length_m", "lasting_share", "flat_log_density"):
        assert getattr(found, name) == pytest.approx(getattr(expected, name), rel=0.02), name
    np.testing.assert_allclose(found.floor, expected.floor, rtol=0.02)
    np.testing.assert_allclose(found.typical_std, expected.typical_std, rtol=0.02)


def test_a_posterior_that_cannot_decide_between_two_places_is_judged_by_the_right_one():
    samples, truth = simulated()
    elsewhere = Poses.exp(np.array([4.0, 1.0, 0.0, 0.0, 0.0, 1.5]))
    half = len(samples[0]) // 2
    both = [Poses.concatenate([poses[:half], (elsewhere @ poses)[half:]]) for poses in samples]
    found = fit(both, truth)
    np.testing.assert_allclose(found.errors.floor, fitted().errors.floor, rtol=0.2)
    assert found.errors.outlier_share == pytest.approx(TRUE.outlier_share, abs=0.05)
    np.testing.assert_allclose(found.coverage, fitted().coverage, atol=0.04)


# --- errors that grow with how unfamiliar an image is ----------------------------------------------


@cache
def graded(power: float, count: int = 240):
    """Held-out images of scores .1 to .9 and some trained on at .1: standard deviations go with a power of the score.

    At a score of a half they are those of `TRUE`.
    """
    rng = np.random.default_rng(6)
    score = rng.uniform(0.1, 0.9, count)
    of_trained = np.full(count // 2, 0.1)
    seen = []
    for scores in (score, of_trained):
        truth = anywhere(len(scores), rng=rng)
        normal = student(len(scores), TRUE.tail, rng=rng) * ((scores / 0.5) ** power)[:, None]
        seen.append(Observations(posteriors(truth, TRUE, normal, rng=rng, num_samples=40), truth, scores))
    return seen


AT_A_HALF = np.hypot(0.06 * UNIT * np.sqrt(TRUE.spread), TRUE.floor)


def fit_graded(power: float, trained: bool = True, before: ErrorModel | None = None) -> ErrorModel:
    held_out, trained_on = graded(power)
    return fit(
        held_out.samples,
        held_out.truth,
        before=before,
        score=held_out.score,
        trained=trained_on if trained else None,
    ).errors


def test_errors_that_grow_with_the_score_are_found_to_with_their_size_at_its_median():
    errors = fit_graded(1.0)
    assert errors.unfamiliar_power == pytest.approx(1.0, abs=0.25)
    assert errors.unfamiliar_score == pytest.approx(np.median(graded(1.0)[0].score))
    np.testing.assert_allclose(errors.typical_std, AT_A_HALF, rtol=0.25)


def test_errors_that_do_not_depend_on_the_score_do_not_grow():
    assert fit_graded(0.0).unfamiliar_power <= 0.125


def test_without_images_trained_on_the_power_stays_and_the_errors_follow_it():
    before = replace(default_errors(graded(1.0)[0].truth), unfamiliar_power=1.0, unfamiliar_score=0.25)
    errors = fit_graded(1.0, trained=False, before=before)
    assert (errors.unfamiliar_power, errors.unfamiliar_score) == (1.0, 0.25)
    np.testing.assert_allclose(errors.typical_std, 0.5 * AT_A_HALF, rtol=0.25)


def test_where_nobody_knows_how_unfamiliar_images_are_nothing_grows():
    held_out, trained = (replace(seen, score=None) for seen in graded(0.0))
    assert fit(held_out.samples, held_out.truth, trained=trained).errors.unfamiliar_power == 0.0


# --- errors that last ------------------------------------------------------------------------------


def walk(count: int, step_m: float, *, rng: np.random.Generator) -> Poses:
    """A straight walk through a long corridor."""
    x = np.arange(count) * step_m
    side = np.cumsum(rng.normal(0, 0.01, (count, 2)), axis=0)
    return Poses(np.tile(np.eye(3), (count, 1, 1)), np.column_stack([x, side]))


STEP = 0.1


def lasting(count: int, length_m: float, share: float, *, rng: np.random.Generator) -> np.ndarray:
    """Errors (n, 6) in standard deviations of images along a walk, of which this share of the variance lasts."""
    fade = np.exp(-STEP / length_m)
    kept = rng.standard_normal((count, 6))
    for i in range(1, count):
        kept[i] = fade * kept[i - 1] + np.sqrt(1 - fade**2) * kept[i]
    return np.sqrt(share) * kept + np.sqrt(1 - share) * rng.standard_normal((count, 6))


def fit_walk(normal: np.ndarray, *, rng: np.random.Generator):
    """The fit of images along a straight walk with these errors (n, 6)."""
    truth = walk(len(normal), STEP, rng=rng)
    samples = posteriors(truth, replace(TRUE, outlier_share=1e-9), normal, rng=rng)
    return fit(samples, truth, Travel.along(truth, np.zeros(len(normal), np.int64)))


@pytest.mark.parametrize(("length_m", "share"), [(0.5, 0.65), (2.0, 0.6)])
def test_how_long_errors_last_is_found(length_m, share):
    rng = np.random.default_rng(1)
    found = fit_walk(lasting(500, length_m, share, rng=rng), rng=rng)
    assert length_m / 2 < found.errors.length_m < length_m * 2
    assert found.errors.lasting_share == pytest.approx(share, abs=0.12)
    expected = 1 + STEP * 500 / (2 * found.errors.length_m)
    assert found.effective_images == pytest.approx(expected, rel=0.05)
    assert found.errors.outlier_share == 0.05


def mistaking(
    lasts: float, *, errors_last: float = 0.5, count: int = 500, seed: int = 0, same_conditions: bool = False
) -> ErrorModel:
    """The fit of a walk of which two fifths of the images take one wall for another, over stretches so long."""
    rng = np.random.default_rng(seed)
    truth = walk(count, STEP, rng=rng)
    fade = np.exp(-STEP / lasts) if lasts else 0.0
    mood = rng.standard_normal(count)
    for i in range(1, count):
        mood[i] = fade * mood[i - 1] + np.sqrt(1 - fade**2) * mood[i]
    seen = Poses(truth.rotation, truth.translation + np.outer(mood < -0.25, [0.0, 0.0, 45.0]))
    normal = lasting(count, errors_last, 0.6, rng=rng)
    samples = posteriors(seen, replace(TRUE, outlier_share=1e-9), normal, rng=rng)
    scene = Poses.concatenate([truth, Poses(truth.rotation, truth.translation + np.array([0.0, 0.0, 45.0]))])
    way = Travel.along(truth, np.zeros(count, np.int64))
    before = default_errors(scene)
    return fit_errors(Observations(samples, truth, None), way, scene, before, same_conditions=same_conditions).errors


def test_how_long_a_place_is_mistaken_for_another_is_found_apart_from_how_long_errors_last():
    by_chance, one, four = mistaking(0.0), mistaking(1.0), mistaking(4.0)
    assert by_chance.mistaken_lengths == pytest.approx(4.0, abs=0.5)  # one length more is taken to be, three times
    assert 4.0 < one.mistaken_lengths < four.mistaken_lengths
    # Both ways of the correlation, and three times that.
    assert one.mistaken_lengths * one.length_m == pytest.approx(3 * 2.0, rel=0.6)
    assert four.mistaken_lengths * four.length_m > 3 * 3.0


def test_where_conditions_are_those_of_use_mistakes_last_as_long_as_on_held_out_images():
    elsewhere, here = mistaking(1.0), mistaking(1.0, same_conditions=True)
    assert here.mistaken_lengths - 1.0 == pytest.approx((elsewhere.mistaken_lengths - 1.0) / 3)
    assert replace(here, mistaken_lengths=elsewhere.mistaken_lengths) == elsewhere


def test_mistakes_that_fade_sooner_than_errors_are_votes_closer_than_a_length():
    errors = mistaking(0.2, errors_last=2.0, same_conditions=True)
    assert errors.mistaken_lengths < 0.6
    assert errors.mistaken_lengths * errors.length_m == pytest.approx(2 * 0.2, rel=0.6)
    new_each_time = mistaking(0.0, errors_last=4.0, count=150, same_conditions=True)
    assert new_each_time.mistaken_lengths >= 0.25


def test_images_that_never_mistake_the_place_are_worth_one_a_length():
    rng = np.random.default_rng(1)
    assert fit_walk(lasting(500, 0.5, 0.65, rng=rng), rng=rng).errors.mistaken_lengths == pytest.approx(1.0, abs=0.5)


def found_lasting(normal: np.ndarray, truth: Poses, passes: int = 1, extent: float = 20.0) -> LastingErrors:
    """What is found of errors (n, 6) of images at these poses, in passes of equal numbers."""
    way = Travel.along(truth, np.repeat(np.arange(passes), len(truth) // passes))
    return lasting_errors(normal, np.ones(len(normal), bool), way, extent)


@pytest.mark.parametrize(("share", "taken"), [(1.0, 0.7), (0.3, 0.5)])
def test_of_a_share_that_lasts_wholly_or_hardly_the_sum_of_the_correlations_is_kept(share, taken):
    rng = np.random.default_rng(7)
    truth = walk(1000, STEP, rng=rng)
    found = [found_lasting(lasting(1000, 1.0, share, rng=rng), truth) for _ in range(9)]
    assert {each.share for each in found} == {taken}
    assert np.median([each.length_m * taken for each in found]) == pytest.approx(share * 1.0, rel=0.25)


def test_what_lasts_long_beside_what_fades_soon_is_seen():
    rng = np.random.default_rng(0)
    truth = walk(1000, STEP, rng=rng)
    worth = []
    for _ in range(9):
        soon, long = (lasting(1000, length_m, 1.0, rng=rng) for length_m in (0.2, 2.0))
        found = found_lasting(np.sqrt(0.6) * soon + np.sqrt(0.4) * long, truth)
        worth.append(found.share * found.length_m)
    assert np.median(worth) == pytest.approx(0.6 * 0.2 + 0.4 * 2.0, rel=0.3)


@pytest.mark.parametrize(("passes", "count"), [(1, 20), (4, 25), (1, 100)])
def test_few_images_give_no_lengths_that_run_away(passes, count):
    rng = np.random.default_rng(0)
    truth = walk(passes * count, STEP, rng=rng)
    longest = 0.15 * 10.0
    found = []
    for _ in range(40):
        normal = np.concatenate([lasting(count, 0.5, 0.6, rng=rng) for _ in range(passes)])
        found.append(found_lasting(normal, truth, passes, extent=10.0))
    assert np.mean([each.length_m > 0.99 * longest for each in found]) <= 0.25
    assert {each.length_rad for each in found} == {0.4}  # of a camera that never turns nothing is learned


def test_images_in_one_place_say_nothing_of_lengths():
    truth = Poses(np.tile(np.eye(3), (60, 1, 1)), np.repeat([[0.0, 0.0, 0.0], [9.0, 9.0, 9.0]], 30, axis=0))
    found = found_lasting(np.random.default_rng(0).standard_normal((60, 6)), truth, passes=2)
    assert np.isfinite([found.length_m, found.length_rad]).all()
    assert found.share == 0.5


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
        lengths_rad.append(found_lasting(normal, truth).length_rad)
    assert lengths_rad[0] < 0.7
    assert lengths_rad[1] > 1.0


def test_a_stretch_of_larger_errors_does_not_lengthen_how_long_they_last():
    """Images err more in one part of the scene than in another: that lasts, but is no error that does."""
    found = []
    for larger in (1.0, 5.0):
        rng = np.random.default_rng(8)
        normal = lasting(180, 0.5, 0.6, rng=rng)
        normal[60:120] *= larger
        found.append(fit_walk(normal, rng=rng).errors)
    step_of_the_search = 50 ** (1 / 9)
    assert found[1].length_m <= 1.01 * step_of_the_search * found[0].length_m
    assert found[1].length_m < 1.0
    assert max(found[1].floor) > 1.1 * max(found[0].floor)


def test_errors_of_independent_images_last_no_longer_than_they_must():
    rng = np.random.default_rng(2)
    truth = walk(300, 0.1, rng=rng)
    samples = posteriors(truth, replace(TRUE, outlier_share=1e-9), rng.standard_normal((300, 6)), rng=rng)
    found = fit(samples, truth, Travel.along(truth, np.zeros(300, np.int64))).errors
    assert (found.lasting_share, found.length_m) == (0.5, pytest.approx(0.003 * scene_extent(truth)))


def test_a_way_counts_metres_and_radians_from_the_beginning_of_each_pass():
    turned = Poses.exp(np.array([[0, 0, 0, 0, 0, a] for a in (0.0, 0.1, 0.3, 0.3, 0.4)]))
    poses = Poses(turned.rotation, np.array([[0.0, 0, 0], [1, 0, 0], [1, 2, 0], [9, 9, 9], [9, 9, 8]]))
    way = Travel.along(poses, np.array([3, 3, 3, 4, 4]))
    np.testing.assert_allclose(way.metres, [0, 1, 3, 0, 1], atol=1e-12)
    np.testing.assert_allclose(way.radians, [0, 0.1, 0.3, 0, 0.1], atol=1e-6)
    some = way[np.array([1, 4])]
    np.testing.assert_allclose(some.metres, [1, 1])


# --- little, flat and bad data ---------------------------------------------------------------------


def usable(errors: ErrorModel, samples) -> bool:
    posterior = PosePosterior.from_samples(samples, errors)
    return bool(np.isfinite(posterior.covariances).all()) and len(posterior.shares) > 0


def test_sixty_images_of_one_pass_are_worth_few_and_the_fit_is_cautious():
    rng = np.random.default_rng(3)
    truth = walk(60, 0.05, rng=rng)
    errors = replace(TRUE, outlier_share=1e-9, floor=(0.05, 0.2, 0.05, 0.02, 0.02, 0.02))
    samples = posteriors(truth, errors, np.tile(rng.standard_normal(6), (60, 1)), rng=rng)
    scene = Poses.concatenate([truth, anywhere(100, rng=rng)])
    way = Travel.along(truth, np.zeros(60, np.int64))
    found = fit_errors(Observations(samples, truth), way, scene, default_errors(scene))
    assert found.effective_images < 10
    lengths, angles = np.array(found.errors.floor[:3]), np.array(found.errors.floor[3:])
    assert lengths.max() < 3 * lengths.min()
    assert angles.max() < 3 * angles.min()
    assert usable(found.errors, samples[0])


def test_images_that_are_all_wrong_leave_nothing_to_be_believed():
    rng = np.random.default_rng(4)
    truth = anywhere(100, rng=rng)
    samples = posteriors(truth, replace(TRUE, outlier_share=0.999999), rng.standard_normal((100, 6)), rng=rng)
    found = fit(samples, truth).errors
    assert found.outlier_share > 0.4 or min(found.typical_std[:3]) > 0.05 * scene_extent(truth)
    assert usable(found, samples[0])


@pytest.mark.parametrize("num_samples", [150, 1])
def test_cameras_that_move_in_a_plane_get_positive_covariances(num_samples):
    rng = np.random.default_rng(5)
    turned = np.zeros((80, 6))
    turned[:, 5] = rng.uniform(-3, 3, 80)
    truth = Poses(Poses.exp(turned).rotation, rng.uniform(0, 1, (80, 3)) * [10, 6, 0])
    flat = np.array([0.1, 0.1, 0, 0, 0, 0.05])
    offsets = truth @ Poses.exp(rng.standard_normal((80, 6)) * flat)
    samples = [offsets[i] @ Poses.exp(rng.standard_normal((num_samples, 6)) * flat) for i in range(80)]
    found = fit(samples, truth).errors
    assert usable(found, samples[0])
    assert 0.0 < found.floor[2] < 0.2
    assert 0.05 < found.typical_std[0] < 0.3


def test_cameras_that_all_stand_at_one_place_are_no_division_by_zero():
    truth = Poses.identity(60)
    samples = [Poses.identity(20)] * 60
    assert usable(fit(samples, truth).errors, samples[0])


# --- kernel widths ---------------------------------------------------------------------------------


@pytest.mark.parametrize(("spread_m", "spread_rad"), [(0.2, 0.05), (0.05, 0.15)])
def test_the_scale_of_the_kernels_is_found_from_samples_of_known_spread(spread_m, spread_rad):
    rng = np.random.default_rng(0)
    std = np.repeat([spread_m, spread_rad], 3)
    truth = anywhere(300, rng=rng)
    # As of a calibrated posterior: the truth lies in the samples as any other draw would.
    centres = truth @ Poses.exp(rng.standard_normal((300, 6)) * std)
    samples = [centres[i] @ Poses.exp(rng.standard_normal((200, 6)) * std) for i in range(300)]
    (width_m, width_rad), change = fit_widths(samples, truth, truth, (0.1, 0.1))
    # Of 200 samples in six dimensions the best kernel is narrower than the posterior: Silverman's factor is 0.55.
    assert 0.35 * spread_m < width_m < 0.9 * spread_m
    assert 0.35 * spread_rad < width_rad < 0.9 * spread_rad
    assert change.after == {"bandwidth_translation_m": width_m, "bandwidth_rotation_rad": width_rad}
    assert change.gain is not None
    assert change.gain >= -1e-4


def test_kernels_of_a_single_sample_get_exactly_the_spread_of_its_error():
    rng = np.random.default_rng(1)
    truth = anywhere(500, rng=rng)
    samples = [truth[[i]] @ Poses.exp(rng.standard_normal((1, 6)) * np.repeat([0.1, 0.04], 3)) for i in range(500)]
    width_m, width_rad = fit_widths(samples, truth, truth, (0.1, 0.1))[0]
    assert width_m == pytest.approx(0.1, rel=0.08)
    assert width_rad == pytest.approx(0.04, rel=0.08)
