"""Poses by the images until a lag later: between filter and hindsight, once each, in order."""

from dataclasses import replace

import numpy as np
import pytest

from filtering.errors import VaporTrackError
from filtering.fixed_lag import FixedLagSmoother
from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from filtering.smoothing import smooth
from tests.filtering.test_smoothing import CONFIG, FILTER, carried_off, moved, steps_along
from tests.helpers.modelled_walk import ERRORS, walk

pytestmark = pytest.mark.usefixtures("unchecked")


def lagged_along(steps, lag_s):
    smoother = FixedLagSmoother(lag_s, ERRORS, CONFIG, FILTER.modes)
    return [pose for step in steps for pose in smoother.update(step)] + smoother.finish()


def poses_of(found):
    return Poses.stack([each.world_from_camera for each in found])


def test_each_pose_is_given_once_the_lag_has_passed_in_order():
    steps, _ = steps_along(walk(40, rng=np.random.default_rng(0)))
    smoother = FixedLagSmoother(1.0, ERRORS, CONFIG, FILTER.modes)
    given = [smoother.update(step) for step in steps]
    assert [len(each) for each in given] == [0] * 10 + [1] * 30  # an image every tenth of a second
    numbers = [pose.number for each in [*given, smoother.finish()] for pose in each]
    assert numbers == list(range(40))


def test_a_lag_is_better_than_none_and_worse_than_all_images():
    off = {"filter": [], "lag": [], "all": []}
    for seed in range(2):
        path = walk(100, rng=np.random.default_rng(seed), speed_m=0.1)
        steps, filtered = steps_along(path)
        trajectories = filtered, poses_of(lagged_along(steps, 2.0)), smooth(steps, ERRORS, CONFIG).best.poses
        for name, poses in zip(off, trajectories, strict=True):
            off[name].append(poses.distance(path.truth)[0])
    filtered, lagged, smoothed = (np.sqrt(np.mean(np.square(each))) for each in off.values())
    assert smoothed < 1.02 * lagged
    assert lagged < 0.9 * filtered


def test_with_a_lag_as_long_as_the_run_it_is_the_whole_run_in_hindsight():
    """But for places and unusual errors, which it decides on the way."""
    steps, _ = steps_along(walk(40, rng=np.random.default_rng(3), speed_m=0.1))
    found, best = lagged_along(steps, 100.0), smooth(steps, ERRORS, CONFIG).best
    assert poses_of(found).distance(best.poses)[0].max() < 0.02
    covariances = np.stack([each.covariance for each in found])
    np.testing.assert_allclose(covariances[:, 0, 0], best.covariance[:, 0, 0], rtol=0.25)


def test_a_start_that_is_decided_within_the_lag_is_right():
    path = walk(60, rng=np.random.default_rng(15), lifts=lambda i: (0.0,) if i >= 20 else (-6.0, -3.0, 0.0, 3.0))
    steps, filtered = steps_along(path)
    assert (filtered.distance(path.truth)[0][:10] > 1.0).any()  # precondition: the filter could not know yet
    assert (poses_of(lagged_along(steps, 4.0)).distance(path.truth)[0] < 0.4).all()


def test_it_goes_over_to_where_the_camera_was_carried():
    first = walk(60, rng=np.random.default_rng(5), speed_m=0.1)
    path = carried_off(first, moved(walk(60, rng=np.random.default_rng(6), speed_m=0.1), (0.0, 9.0, 0.0)))
    steps, filtered = steps_along(path)
    found = lagged_along(steps, 6.0)
    assert [each.number for each in found] == list(range(120))
    wrong, wrong_before = (poses.distance(path.truth)[0] > 0.5 for poses in (poses_of(found), filtered))
    assert wrong.sum() < 0.5 * wrong_before.sum()
    assert [each.number for each in found if each.carried_off] == [60]


def test_images_without_places_and_gaps_in_the_odometry_are_crossed():
    path = walk(60, rng=np.random.default_rng(1))
    nothing = PosePosterior.uninformative(ERRORS)
    seen = [nothing if 20 <= i < 30 else posterior for i, posterior in enumerate(path.posteriors)]
    odometry = [None if i == 45 else motion for i, motion in enumerate(path.odometry)]
    steps, _ = steps_along(replace(path, posteriors=seen, odometry=odometry))
    found = lagged_along(steps, 1.0)
    assert poses_of(found).distance(path.truth)[0].max() < 0.4
    assert all(np.linalg.eigvalsh(each.covariance)[0] > 0.0 for each in found)


@pytest.mark.parametrize("lag_s", [0.0, -1.0, np.nan, np.inf])
def test_a_lag_that_is_no_time_is_refused(lag_s):
    with pytest.raises(VaporTrackError, match="above 0"):
        FixedLagSmoother(lag_s, ERRORS)
