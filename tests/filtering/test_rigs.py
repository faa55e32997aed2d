"""Several cameras on one robot."""

import numpy as np
import pytest

from filtering.errors import VaporTrackError
from filtering.localizer import ParticleLocalizer
from filtering.observation import View
from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from tests.helpers.simulation import (
    AHEAD,
    ERRORS,
    RNG,
    STAY,
    STD,
    assert_same_belief,
    motion,
    new_localizer,
    seen_at,
    walk,
)

FRONT = Poses.exp(np.array([0.3, 0, 0.1, 0, 0, 0]))

BACK = Poses.exp(np.array([-0.3, 0.1, 0.1, 0, 0, np.pi - 0.2]))


def test_a_camera_on_a_rig_says_of_the_rig_what_it_says_of_itself_carried_over():
    # Turned only: with a lever arm the camera moves another distance than the rig.
    turned = Poses.exp(np.array([0, 0, 0, 0, 0, np.pi - 0.2]))
    rig, alone = new_localizer(), new_localizer()
    rng, pose = RNG(0), Poses.identity()
    for _ in range(15):
        pose = pose @ AHEAD.previous_from_current
        posterior = seen_at(pose @ turned @ Poses.exp(STD * rng.standard_normal(6)))
        one = rig.update([View(posterior, turned, "camera")], AHEAD)
        other = alone.update(posterior.seen_from(turned), AHEAD)
        assert_same_belief(one, other, atol=1e-12)
        assert one.status == other.status
    assert one.modes[0].world_from_camera.distance(pose)[0] < 0.3


def test_of_two_cameras_one_may_say_nothing():
    pair, alone = new_localizer(), new_localizer()
    for i in range(10):
        pose = Poses.exp(np.array([0.1 * i, 0, 0, 0, 0, 0]))
        front = View(seen_at(pose @ FRONT), FRONT, "front")
        both = [front, View(PosePosterior.uninformative(ERRORS), BACK, "back")]
        step = motion(0.1, 0, 0, 0, 0, 0)
        assert_same_belief(pair.update(both, step), alone.update([front], step), atol=0)


def test_a_camera_seen_later_for_the_first_time_brings_errors_of_its_own():
    localizer = new_localizer()
    for _ in range(50):
        before = localizer.update([View(seen_at(FRONT), FRONT, "front")], STAY)
    after = localizer.update([View(seen_at(FRONT), FRONT, "front"), View(seen_at(BACK), BACK, "back")], STAY)
    assert before.modes[0].widest_std_m > after.modes[0].widest_std_m * 1.1
    assert after.novelty == 1.0  # it looks at what the other did not
    again = localizer.update([View(seen_at(BACK), BACK, "back")], STAY)
    assert again.novelty == 0.0
    assert np.exp(again.log_weights).sum() == pytest.approx(1.0)


def test_two_views_of_one_camera_at_one_moment_are_refused():
    view = View(seen_at(Poses.identity(1)), FRONT, "front")
    with pytest.raises(VaporTrackError, match="views of cameras front, front, expected each once"):
        new_localizer().update([view, view], None)


def test_a_camera_that_turns_on_its_mount_sees_something_new():
    localizer, novelty = new_localizer(), []
    for i in range(60):  # two turns
        mount = Poses.exp(np.array([0, 0, 0, 0, 0, 2 * np.pi * i / 30]))
        estimate = localizer.update([View(seen_at(mount), mount, "turret")], STAY)
        novelty.append(estimate.novelty)
    assert sum(novelty[1:30]) == pytest.approx(2 * np.pi * 29 / 30 / ERRORS.length_rad, rel=0.05)
    assert sum(novelty[31:]) < 1.0  # the second turn shows the same again


def test_no_view_at_all_is_a_prediction():
    one, other = new_localizer(), new_localizer()
    for localizer in (one, other):
        walk(localizer, 5)
    assert_same_belief(one.update([], AHEAD), other.predict(AHEAD), atol=0)


def test_a_rig_begins_at_its_first_view_that_has_places():
    place = seen_at(Poses.identity(1))
    views = [
        View(PosePosterior.uninformative(ERRORS), Poses.identity(), "left"),
        View(place, Poses.identity(), "right"),
    ]
    estimate = ParticleLocalizer(None, rng=np.random.default_rng(0)).update(views, None)
    np.testing.assert_allclose(estimate.modes[0].world_from_camera.translation, 0.0, atol=1e-9)
