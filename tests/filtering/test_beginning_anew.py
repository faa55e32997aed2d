"""A localizer that is told to forget, or where it is; and belief over motion that nobody knows."""

import copy

import numpy as np
import pytest

from filtering.errors import VaporTrackError
from filtering.se3 import Poses
from tests.helpers.simulation import AHEAD, ERRORS, assert_same_belief, new_localizer, seen_at, walk

COVARIANCE = np.diag([0.25, 0.25, 0.04, 0.01, 0.01, 0.07])


def test_one_that_forgot_begins_as_a_new_one_does():
    used, fresh = new_localizer(), new_localizer()
    walk(used, 20)
    used.forget()
    with pytest.raises(VaporTrackError, match="nothing to predict from"):
        used.predict(AHEAD)
    pose = Poses.exp(np.array([3.0, -2.0, 0.5, 0.1, 0.2, 0.3]))
    for localizer in (used, fresh):
        localizer.update(seen_at(pose, errors=ERRORS), None)
    one, other = used.update(seen_at(pose, errors=ERRORS), AHEAD), fresh.update(seen_at(pose, errors=ERRORS), AHEAD)
    assert_same_belief(one, other, rtol=1e-12, atol=1e-12)
    assert one.status == other.status


def test_a_stated_pose_is_the_belief_with_its_uncertainty():
    localizer = new_localizer()
    walk(localizer, 5)
    pose = Poses.exp(np.array([30.0, 4.0, 1.0, 0.0, 0.0, 1.5]))
    estimate = localizer.start_at(pose, COVARIANCE, ERRORS)
    (mode,) = estimate.modes
    assert float(mode.world_from_camera.distance(pose)[0]) == 0.0
    np.testing.assert_allclose(mode.covariance, COVARIANCE + ERRORS.constant_covariance(np.zeros((6, 6))))
    assert mode.weight == 1.0


def test_images_make_a_stated_pose_exact():
    truth = Poses.exp(np.array([30.0, 4.0, 1.0, 0.0, 0.0, 1.5]))
    localizer = new_localizer()
    localizer.start_at(truth @ Poses.exp(np.array([0.4, -0.3, 0.1, 0.05, 0.0, -0.1])), COVARIANCE, ERRORS)
    estimates, pose = walk(localizer, 12, pose=truth)
    assert float(estimates[-1].modes[0].world_from_camera.distance(pose)[0]) < 0.15
    assert estimates[-1].status == "converged"


def test_images_of_elsewhere_outweigh_a_stated_pose_that_is_wrong():
    localizer = new_localizer()
    localizer.start_at(Poses.exp(np.array([60.0, 0.0, 0.0, 0.0, 0.0, 0.0])), COVARIANCE, ERRORS)
    estimates, pose = walk(localizer, 60)
    assert float(estimates[-1].modes[0].world_from_camera.distance(pose)[0]) < 0.3


@pytest.mark.parametrize("bad", [np.zeros((6, 6)), np.full((6, 6), np.nan), -np.eye(6)])
def test_a_covariance_that_is_none_leaves_the_belief_as_it_was(bad):
    localizer, untouched = new_localizer(), new_localizer()
    walk(localizer, 5)
    walk(untouched, 5)
    with pytest.raises(VaporTrackError):
        localizer.start_at(Poses.identity(), bad, ERRORS)
    assert_same_belief(localizer.predict(AHEAD), untouched.predict(AHEAD))


def test_a_belief_over_an_unknown_motion_is_as_wide_as_the_time_is_long():
    localizer = new_localizer()
    walk(localizer, 20)
    widths = [copy.copy(localizer).predict(None, elapsed_s=s).modes[0].widest_std_m for s in (0.0, 0.5, 2.0)]
    assert widths[0] < 0.2
    speed = localizer.config.gap.speed_m_per_s
    np.testing.assert_allclose(widths[1:], [0.5 * speed, 2.0 * speed], rtol=0.02)
    assert copy.copy(localizer).predict(None, elapsed_s=2.0).status == "ambiguous"


def test_a_copy_that_predicts_leaves_the_original_alone():
    localizer, untouched = new_localizer(), new_localizer()
    walk(localizer, 8)
    walk(untouched, 8)
    copy.copy(localizer).predict(None, elapsed_s=30.0)
    copy.copy(localizer).predict(AHEAD)
    assert_same_belief(localizer.predict(AHEAD), untouched.predict(AHEAD))
