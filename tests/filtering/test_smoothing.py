"""The trajectory in hindsight: images that repeat each other share what they say, and odometry may err slowly."""

from dataclasses import replace

import numpy as np
import pytest

from filtering.config import LocalizerConfig
from filtering.errors import VaporTrackError
from filtering.estimate import posterior_modes
from filtering.localizer import ParticleLocalizer
from filtering.se3 import Poses
from filtering.smoothing import SmoothingConfig, independence, smooth, trajectory_agreement
from tests.helpers.full import some
from tests.helpers.modelled_walk import BIAS, ERRORS, walk

pytestmark = pytest.mark.usefixtures("unchecked")

CONFIG = SmoothingConfig(odometry_bias=BIAS)


def filtered_and_smoothed(path, noise=ERRORS, modes=None):
    localizer = ParticleLocalizer(None, LocalizerConfig(odometry_bias=BIAS), rng=np.random.default_rng(0))
    estimates = [localizer.update(p, odom) for p, odom in zip(path.posteriors, path.odometry, strict=True)]
    filtered = Poses.stack([estimate.modes[0].world_from_camera for estimate in estimates])
    sure = np.array([estimate.status == "converged" for estimate in estimates])
    distances = np.array([estimate.normalized_distance for estimate in estimates])
    modes = modes or [posterior_modes(posterior) for posterior in path.posteriors]
    return filtered, smooth(modes, path.odometry, distances, filtered, sure, noise, CONFIG)


# --- what an image is worth --------------------------------------------------------------------------


def of_one_pose(distances, correlated_fraction):
    """What the images say together of one pose, in independent images: 1ᵀ K⁻¹ 1."""
    along = np.cumsum(distances)
    correlation = correlated_fraction * np.exp(-np.abs(along[:, None] - along))
    np.fill_diagonal(correlation, 1.0)
    return np.linalg.inv(correlation).sum()


@pytest.mark.parametrize("correlated_fraction", [0.0, 0.5, 0.8, 0.999])
def test_a_standing_camera_is_worth_little_more_than_one_image(correlated_fraction):
    n = 500
    worth = independence(np.zeros(n), correlated_fraction)
    np.testing.assert_allclose(worth, 1 / (1 + (n - 1) * correlated_fraction), rtol=0.05)


@pytest.mark.parametrize("step", some(2, [0.5, 20.0, 0.01, 0.1, 2.0]))
def test_on_a_long_way_an_image_is_worth_what_the_inverse_of_the_correlations_says(step):
    n, correlated_fraction = 2000, 0.8
    worth = independence(np.full(n, step), correlated_fraction)
    assert worth[n // 2] == pytest.approx(
        1 / (1 - correlated_fraction + correlated_fraction / np.tanh(step / 2)), rel=1e-3
    )
    assert worth.sum() == pytest.approx(of_one_pose(np.full(n, step), correlated_fraction), rel=1e-6)


def test_a_stand_takes_nothing_from_images_on_the_way():
    """A stand of a hundred images counts as one of a single image does."""
    distances = np.concatenate([np.full(20, 0.7), np.zeros(99), np.full(20, 0.7)])
    worth = independence(distances, 0.8)
    once = independence(np.full(40, 0.7), 0.8)
    np.testing.assert_allclose(worth[:18], once[:18], rtol=0.05)
    assert once[19] <= worth[19:119].sum() < 1.5 * once[19]
    np.testing.assert_allclose(worth.sum(), of_one_pose(np.maximum(distances, 1e-6), 0.8), rtol=1e-4)


def test_one_image_is_one_and_errors_that_do_not_last_are_independent():
    assert independence(np.zeros(1), 0.8) == [1.0]
    np.testing.assert_allclose(independence(np.zeros(9), 0.0), 1.0)


# --- the trajectory -----------------------------------------------------------------------------------


def test_where_errors_follow_the_model_hindsight_is_better_than_the_filter():
    before, after = [], []
    for seed in range(3):
        path = walk(150, rng=np.random.default_rng(seed), speed_m=0.08)
        filtered, smoothed = filtered_and_smoothed(path)
        before.append(filtered.distance(path.truth)[0])
        after.append(smoothed.distance(path.truth)[0])
    assert np.sqrt(np.mean(np.square(after))) < 0.8 * np.sqrt(np.mean(np.square(before)))
    assert np.median(after) < np.median(before)


def test_an_ambiguous_start_is_resolved_in_hindsight():
    path = walk(60, rng=np.random.default_rng(15), lifts=lambda i: (0.0,) if i >= 40 else (-6.0, -3.0, 0.0, 3.0))
    filtered, smoothed = filtered_and_smoothed(path)
    assert (filtered.distance(path.truth)[0][:10] > 1.0).any()  # precondition: the filter could not know yet
    assert (smoothed.distance(path.truth)[0] < 0.4).all()


def test_images_without_modes_are_no_measurement():
    path = walk(60, rng=np.random.default_rng(1))
    modes = [posterior_modes(p) if i < 20 or i >= 40 else () for i, p in enumerate(path.posteriors)]
    _, smoothed = filtered_and_smoothed(path, modes=modes)
    assert smoothed.distance(path.truth)[0].max() < 0.4
    unseen = smooth(
        [()] * 60, path.odometry, path.distances, path.truth[np.arange(60)], np.ones(60, bool), ERRORS, CONFIG
    )
    assert np.isfinite(unseen.translation).all()


def test_a_standing_camera_does_not_outvote_the_others():
    """One stretch of the path counts the same whether the camera took one image there or a hundred."""
    path = walk(40, rng=np.random.default_rng(2), speed_m=0.3)
    modes = [posterior_modes(posterior) for posterior in path.posteriors]
    still = type(path.odometry[1])(Poses.identity(), 1e-12 * np.eye(6), 0.0)
    repeated = [*modes[:20], *[modes[20]] * 100, *modes[20:]]
    odometry = [*path.odometry[:21], *[still] * 100, *path.odometry[21:]]
    distances = np.concatenate([path.distances[:21], np.zeros(100), path.distances[21:]])
    index = np.concatenate([np.arange(20), np.full(100, 20), np.arange(20, 40)])
    once = smooth(modes, path.odometry, path.distances, path.truth, np.ones(40, bool), ERRORS, CONFIG)
    often = smooth(repeated, odometry, distances, path.truth[index], np.ones(140, bool), ERRORS, CONFIG)
    assert once.distance(often[np.concatenate([np.arange(20), np.arange(120, 140)])])[0].max() < 0.04


@pytest.mark.parametrize("unit", [30.0, 1.0 / 30.0])
def test_lengths_in_another_unit_give_the_same_times_that(unit):
    results = []
    for factor in (1.0, unit):
        path = walk(60, rng=np.random.default_rng(7), unit=factor, lifts=lambda i: (0.0,) if i >= 30 else (-3.0, 0.0))
        results.append(filtered_and_smoothed(path, ERRORS.scaled(factor))[1])
    np.testing.assert_allclose(results[1].translation, unit * results[0].translation, atol=2e-3 * unit)
    np.testing.assert_allclose(results[1].rotation, results[0].rotation, atol=2e-3)


def test_a_gap_splits_the_trajectory():
    path = walk(60, rng=np.random.default_rng(8))
    modes = [posterior_modes(posterior) for posterior in path.posteriors]
    odometry = [None if i == 30 else motion for i, motion in enumerate(path.odometry)]
    sure = np.ones(60, bool)
    whole = smooth(modes, odometry, path.distances, path.truth, sure, ERRORS, CONFIG)
    first, second = slice(0, 30), slice(30, 60)
    for part in (first, second):
        alone = smooth(modes[part], odometry[part], path.distances[part], path.truth[part], sure[part], ERRORS, CONFIG)
        np.testing.assert_allclose(whole[part].translation, alone.translation, atol=1e-12)


def test_lists_of_different_length_are_refused():
    with pytest.raises(VaporTrackError, match="got 0, 1, 2, 3 and 2"):
        smooth([], [None], np.zeros(2), Poses.identity(3), np.zeros(2, bool), ERRORS)


# --- whether its poses are to be trusted -------------------------------------------------------------


def at(count):
    return np.arange(count) * 100_000_000


def test_poses_that_odometry_pulled_away_from_their_images_do_not_agree_with_them():
    path = walk(120, rng=np.random.default_rng(3), lifts=lambda i: (0.0, 3.0, 6.0) if i % 40 else (0.0,), speed_m=0.08)
    modes = [posterior_modes(posterior) for posterior in path.posteriors]
    assert trajectory_agreement(path.truth, at(120), modes, ERRORS).min() > 0.8
    for i in range(50, 80):
        path.odometry[i] = replace(
            path.odometry[i], previous_from_current=Poses.identity(), covariance=1e-8 * np.eye(6)
        )
    smoothed = filtered_and_smoothed(path)[1]
    off_m = smoothed.distance(path.truth)[0]
    trusted = trajectory_agreement(smoothed, at(120), modes, ERRORS) >= 0.7
    assert (off_m > 0.5).sum() > 10
    assert not trusted[off_m > 0.5].any()
    assert trusted[off_m < 0.15].mean() > 0.9


def test_one_place_among_many_alike_agrees_also_where_its_mode_was_left_out():
    path = walk(30, rng=np.random.default_rng(4), lifts=lambda i: tuple(3.0 * k for k in range(15)))
    modes = [posterior_modes(posterior) for posterior in path.posteriors]
    assert trajectory_agreement(path.truth, at(30), modes, ERRORS).min() > 0.7
    assert trajectory_agreement(path.truth, at(30), [each[-6:] for each in modes], ERRORS).min() > 0.7
    aside = Poses(path.truth.rotation, path.truth.translation + np.array([0.0, 0.0, 1.5]))
    assert trajectory_agreement(aside, at(30), modes, ERRORS).max() < 0.1


def test_a_pose_far_outside_of_the_map_fits_no_image_whatever_modes_were_left_out():
    path = walk(30, rng=np.random.default_rng(4), lifts=lambda i: tuple(3.0 * k for k in range(15)))
    told = [posterior_modes(posterior)[-6:] for posterior in path.posteriors]
    away = Poses(path.truth.rotation, path.truth.translation + np.array([36590.0, 124135.0, -19294.0]))
    assert trajectory_agreement(away, at(30), told, ERRORS).max() < 0.01


def test_images_that_say_nothing_leave_the_word_to_those_about_them():
    path = walk(30, rng=np.random.default_rng(5))
    modes = [posterior_modes(posterior) if i < 10 else () for i, posterior in enumerate(path.posteriors)]
    found = trajectory_agreement(path.truth, at(30), modes, ERRORS)
    assert found[:15].min() > 0.8
    assert found[15:].max() == 0.0
    slow = trajectory_agreement(path.truth, at(30) * 10, modes, ERRORS)  # an image a second
    np.testing.assert_allclose(slow, found)
    assert trajectory_agreement(path.truth, at(30) // 10, modes, ERRORS)[15:30].min() > 0.8  # a hundred images a second
