"""The run in hindsight: better than the filter, as certain as it says, with breaks and with what stays undecided."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import chdtri

from filtering.config import GapConfig, LocalizerConfig
from filtering.errors import VaporTrackError
from filtering.hindsight import FilterStep, trajectory_agreement
from filtering.localizer import ParticleLocalizer
from filtering.motion import Odometry
from filtering.observation import Observation
from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from filtering.smoothing import SmoothingConfig, Sources, smooth
from tests.helpers.modelled_walk import BIAS, ERRORS, walk
from tests.helpers.simulation import image_errors, new_localizer, seen_at

pytestmark = pytest.mark.usefixtures("unchecked")

FILTER = LocalizerConfig(odometry_bias=BIAS)
CONFIG = SmoothingConfig.of_filter(FILTER)


def steps_along(path, config=FILTER):
    """The filter's steps along a walk, and its best poses."""
    localizer = ParticleLocalizer(None, config, rng=np.random.default_rng(0))
    steps, best = [], []
    for posterior, odometry in zip(path.posteriors, path.odometry, strict=True):
        observation = Observation.of_posterior(posterior, odometry, 0.1)
        estimate = localizer.advance(observation)
        steps.append(FilterStep.of(observation, estimate))
        best.append(estimate.modes[0].world_from_camera)
    return steps, Poses.stack(best)


def smoothed_along(path, noise=ERRORS, config=CONFIG):
    return smooth(steps_along(path)[0], noise, config)


def squared(trajectory, truth):
    """Normalised estimation errors squared, (n,)."""
    error = trajectory.poses.between(truth).log()
    return np.vecdot(error, np.linalg.solve(trajectory.covariance, error[:, :, None])[:, :, 0])


def carried_off(first, second):
    """Two walks as one, in which odometry does not show the way from one to the other."""
    still = Odometry(Poses.exp(np.array([0.05, 0, 0, 0, 0, 0])), first.odometry[1].covariance, 0.1)
    return replace(
        first,
        truth=Poses.concatenate([first.truth, second.truth]),
        odometry=[*first.odometry, still, *second.odometry[1:]],
        posteriors=[*first.posteriors, *second.posteriors],
    )


def moved(path, offset):
    """The same walk elsewhere."""
    offset = np.asarray(offset)
    return replace(
        path,
        truth=Poses(path.truth.rotation, path.truth.translation + offset),
        posteriors=[
            replace(each, means=Poses(each.means.rotation, each.means.translation + offset)) for each in path.posteriors
        ],
    )


# --- the trajectory -----------------------------------------------------------------------------------


def test_where_errors_follow_the_model_hindsight_is_better_than_the_filter_and_as_certain_as_it_says():
    before, after, inside = [], [], []
    for seed in range(20, 24):
        path = walk(120, rng=np.random.default_rng(seed), speed_m=0.2)
        steps, filtered = steps_along(path)
        best = smooth(steps, ERRORS, CONFIG).best
        before.append(filtered.distance(path.truth)[0])
        after.append(best.poses.distance(path.truth)[0])
        inside.append(squared(best, path.truth)[:, None] <= chdtri(6, 1.0 - np.array([0.5, 0.9, 0.95])))
    assert np.sqrt(np.mean(np.square(after))) < 0.8 * np.sqrt(np.mean(np.square(before)))
    np.testing.assert_allclose(np.mean(np.concatenate(inside), axis=0), [0.5, 0.9, 0.95], atol=0.15)


def test_an_ambiguous_start_is_resolved_in_hindsight():
    path = walk(60, rng=np.random.default_rng(15), lifts=lambda i: (0.0,) if i >= 40 else (-6.0, -3.0, 0.0, 3.0))
    steps, filtered = steps_along(path)
    assert (filtered.distance(path.truth)[0][:10] > 1.0).any()  # precondition: the filter could not know yet
    hindsight = smooth(steps, ERRORS, CONFIG)
    assert (hindsight.best.poses.distance(path.truth)[0] < 0.4).all()
    assert not hindsight.is_ambiguous(FILTER.modes, ERRORS).any()


def test_where_two_places_stay_alike_both_trajectories_are_given_with_their_probabilities():
    path = walk(60, rng=np.random.default_rng(4), lifts=lambda i: (0.0, 3.0))
    hindsight = smoothed_along(path)
    assert hindsight.second is not None
    probability = hindsight.best.probability[-1], hindsight.second.probability[-1]
    assert sum(probability) == pytest.approx(1.0, abs=0.01)
    assert probability[1] > 0.4
    heights = sorted(each.poses.translation[:, 2].mean() for each in (hindsight.best, hindsight.second))
    np.testing.assert_allclose(heights, path.truth.translation[:, 2].mean() + np.array([0.0, 3.0]), atol=0.2)
    assert hindsight.is_ambiguous(FILTER.modes, ERRORS).all()


def test_poses_on_both_sides_of_a_kidnap_are_right_and_the_break_is_where_it_happened():
    first = walk(60, rng=np.random.default_rng(5), speed_m=0.1)
    path = carried_off(first, moved(walk(60, rng=np.random.default_rng(6), speed_m=0.1), (0.0, 9.0, 0.0)))
    steps, filtered = steps_along(path)
    assert (filtered.distance(path.truth)[0][60:] > 1.0).sum() > 2  # precondition: it takes the filter some images
    hindsight = smooth(steps, ERRORS, CONFIG)
    assert (hindsight.best.poses.distance(path.truth)[0] < 0.5).all()
    assert np.flatnonzero(hindsight.carried_off).tolist() == [60]


def test_a_place_that_was_undecided_before_a_kidnap_stays_so():
    first = walk(40, rng=np.random.default_rng(7), speed_m=0.1, lifts=lambda i: (0.0, 3.0))
    path = carried_off(first, moved(walk(60, rng=np.random.default_rng(8), speed_m=0.1), (0.0, 9.0, 0.0)))
    hindsight = smoothed_along(path)
    ambiguous = hindsight.is_ambiguous(FILTER.modes, ERRORS)
    assert ambiguous[:40].all()
    assert not ambiguous[40:].any()


def test_a_long_mistake_of_the_network_is_no_kidnap():
    """A length of images that show another floor: two kidnaps are less probable."""
    path = walk(90, rng=np.random.default_rng(9), speed_m=0.1, lifts=lambda i: (3.0,) if 40 <= i < 46 else (0.0,))
    hindsight = smoothed_along(path)
    assert not hindsight.carried_off.any()
    assert (hindsight.best.poses.distance(path.truth)[0] < 0.5).all()


def test_odometry_that_states_how_wrong_it_is_breaks_no_trajectory():
    path = walk(60, rng=np.random.default_rng(7), speed_m=0.2)
    far = Odometry(Poses.exp(np.array([1.5, 0.3, 0, 0, 0, 0])), np.diag([1.0] * 3 + [1e-4] * 3), 0.1)
    path = replace(path, odometry=[far if 25 <= i < 35 else each for i, each in enumerate(path.odometry)])
    hindsight = smoothed_along(path)
    assert not hindsight.carried_off.any()
    assert (hindsight.best.poses.distance(path.truth)[0] < 0.5).all()


def test_images_without_places_are_no_measurement():
    path = walk(60, rng=np.random.default_rng(1))
    nothing = PosePosterior.uninformative(ERRORS)
    seen = [posterior if i < 20 or i >= 40 else nothing for i, posterior in enumerate(path.posteriors)]
    stated = replace(CONFIG, adapt_errors=False)
    best, of_all = (
        smoothed_along(replace(path, posteriors=each), config=stated).best for each in (seen, path.posteriors)
    )
    assert best.poses.distance(path.truth)[0].max() < 0.4
    assert (best.covariance[20:40, 0, 0] > of_all.covariance[20:40, 0, 0]).all()


def test_a_standing_camera_does_not_outvote_the_others():
    """One stretch of the path counts the same whether the camera took one image there or a hundred."""
    path = walk(40, rng=np.random.default_rng(2), speed_m=0.3)
    still = Odometry(Poses.identity(), 1e-12 * np.eye(6), 0.0)
    index = np.concatenate([np.arange(20), np.full(100, 20), np.arange(20, 40)])
    often = replace(
        path,
        truth=path.truth[index],
        odometry=[*path.odometry[:21], *[still] * 100, *path.odometry[21:]],
        posteriors=[path.posteriors[i] for i in index],
    )
    once, repeated = (smoothed_along(each).best for each in (path, often))
    others = np.concatenate([np.arange(20), np.arange(120, 140)])
    assert once.poses.distance(repeated.poses[others])[0].max() < 0.04
    assert np.sqrt(repeated.covariance[60, 0, 0]) > 0.6 * np.sqrt(once.covariance[20, 0, 0])


@pytest.mark.parametrize("unit", [30.0, 1.0 / 30.0])
def test_lengths_in_another_unit_give_the_same_times_that(unit):
    results = []
    for factor in (1.0, unit):
        path = walk(60, rng=np.random.default_rng(7), unit=factor, lifts=lambda i: (0.0,) if i >= 30 else (-3.0, 0.0))
        results.append(smoothed_along(path, ERRORS.scaled(factor)).best)
    np.testing.assert_allclose(results[1].poses.translation, unit * results[0].poses.translation, atol=2e-3 * unit)
    np.testing.assert_allclose(results[1].poses.rotation, results[0].poses.rotation, atol=2e-3)
    np.testing.assert_allclose(results[1].covariance[:, 0, 0], unit**2 * results[0].covariance[:, 0, 0], rtol=0.02)


def test_across_a_gap_in_the_odometry_the_trajectory_goes_on_and_in_another_sequence_it_begins_anew():
    path = walk(60, rng=np.random.default_rng(8))
    path = replace(path, odometry=[None if i == 30 else motion for i, motion in enumerate(path.odometry)])
    gone_on = smoothed_along(path)
    assert not gone_on.carried_off.any()
    assert (gone_on.best.poses.distance(path.truth)[0] < 0.3).all()
    settings = replace(FILTER, gap=GapConfig(action="forget"))
    anew = smooth(steps_along(path, settings)[0], ERRORS, SmoothingConfig.of_filter(settings))
    assert np.flatnonzero(anew.carried_off).tolist() == [30]
    assert (anew.best.poses.distance(path.truth)[0] < 0.3).all()


def test_nothing_to_smooth_is_refused():
    with pytest.raises(VaporTrackError, match="expected at least one"):
        smooth([], ERRORS)


# --- whether its poses are to be trusted -------------------------------------------------------------


def at(count):
    return np.arange(count) * 100_000_000


def test_poses_away_from_their_images_do_not_agree_with_them():
    path = walk(120, rng=np.random.default_rng(3), lifts=lambda i: (0.0, 3.0, 6.0) if i % 40 else (0.0,), speed_m=0.08)
    steps = seen_along(path)
    assert trajectory_agreement(path.truth, at(120), steps, ERRORS).min() > 0.8
    off_m = np.where((np.arange(120) >= 50) & (np.arange(120) < 90), 0.9, 0.0)
    pulled = Poses(path.truth.rotation, path.truth.translation + off_m[:, None] * np.array([0.0, 1.0, 0.0]))
    trusted = trajectory_agreement(pulled, at(120), steps, ERRORS) >= 0.7
    assert not trusted[52:88].any()
    assert trusted[off_m == 0.0].mean() > 0.9


def seen_along(path, *, most=16, of=lambda i: True):
    """Steps with the heaviest places of some images."""
    nothing, steps = PosePosterior.uninformative(ERRORS), []
    for i, posterior in enumerate(path.posteriors):
        kept = posterior.heaviest(most) if of(i) else nothing
        left_out = float(posterior.weights.sum() - kept.weights.sum()) if of(i) else 0.0
        steps.append(FilterStep(kept, left_out, None, 0.1, path.truth[i : i + 1], np.ones(1), ()))
    return steps


def test_one_place_among_many_alike_agrees_also_where_its_place_was_left_out():
    path = walk(30, rng=np.random.default_rng(4), lifts=lambda i: tuple(3.0 * k for k in reversed(range(15))))
    assert trajectory_agreement(path.truth, at(30), seen_along(path), ERRORS).min() > 0.7
    assert trajectory_agreement(path.truth, at(30), seen_along(path, most=6), ERRORS).min() > 0.7
    aside = Poses(path.truth.rotation, path.truth.translation + np.array([0.0, 0.0, 1.5]))
    assert trajectory_agreement(aside, at(30), seen_along(path), ERRORS).max() < 0.1


def test_a_pose_far_outside_of_the_map_fits_no_image_whatever_places_were_left_out():
    path = walk(30, rng=np.random.default_rng(4), lifts=lambda i: tuple(3.0 * k for k in range(15)))
    away = Poses(path.truth.rotation, path.truth.translation + np.array([36590.0, 124135.0, -19294.0]))
    assert trajectory_agreement(away, at(30), seen_along(path, most=6), ERRORS).max() < 0.01


def test_images_that_say_nothing_leave_the_word_to_those_about_them():
    path = walk(30, rng=np.random.default_rng(5))
    steps = seen_along(path, of=lambda i: i < 10)
    found = trajectory_agreement(path.truth, at(30), steps, ERRORS)
    assert found[:15].min() > 0.8
    assert found[15:].max() == 0.0
    slow = trajectory_agreement(path.truth, at(30) * 10, steps, ERRORS)  # an image a second
    np.testing.assert_allclose(slow, found)
    assert trajectory_agreement(path.truth, at(30) // 10, steps, ERRORS)[15:30].min() > 0.8  # a hundred a second


def test_without_odometry_the_camera_has_moved_as_far_in_hindsight_as_in_the_filter():
    """Images alone of a standing camera buy nothing in either."""
    localizer, steps, distances = new_localizer(), [], []
    for error in image_errors([0.0] * 60, ERRORS, rng=np.random.default_rng(1)):
        observation = Observation.of_posterior(seen_at(Poses.exp(error)), None, 0.1)
        estimate = localizer.advance(observation)
        steps.append(FilterStep.of(observation, estimate))
        distances.append(estimate.normalized_distance)
    config = SmoothingConfig.of_filter(LocalizerConfig())
    sources, moved = Sources.unseen(ERRORS, config, [steps[0].camera]), []
    for step in steps:
        sources, there, *_ = sources.after(step, ERRORS, config)
        moved.append(there[0])
    np.testing.assert_allclose(moved[1:], distances[1:])
    assert sum(moved) < 5.0  # walking it would be 18
