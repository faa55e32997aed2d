"""Several cameras on one robot."""

from dataclasses import replace

import numpy as np
import pytest

from filtering.config import LocalizerConfig
from filtering.errors import VaporTrackError
from filtering.fixed_lag import FixedLagSmoother
from filtering.hindsight import FilterStep
from filtering.kalman import KalmanLocalizer
from filtering.localizer import ParticleLocalizer
from filtering.motion import Odometry
from filtering.observation import Observation, View
from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from filtering.smoothing import SmoothingConfig, smooth
from filtering.vertical import Vertical
from tests.helpers.simulation import (
    AHEAD,
    ERRORS,
    OUT_OF_DISTRIBUTION,
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


def circling(localizer, mounts, *, count=60, wrong=None, rng=None, dark=(), std=STD, start=None):
    """A walk with a camera at each mount, image by image; the stated mount of one is `wrong`."""
    rng, pose, estimates = rng or RNG(0), Poses.identity() if start is None else start, []
    for _ in range(count):
        pose = pose @ AHEAD.previous_from_current
        for name, mount in mounts.items():
            stated = mount @ wrong[name] if wrong and name in wrong else mount
            place = pose @ mount @ Poses.exp(std * rng.normal(size=6))
            seen = OUT_OF_DISTRIBUTION if name in dark else seen_at(place, std=std)
            observation = Observation.of_posterior(
                seen, AHEAD if name == "front" else Odometry.still(0.0), 0.1, reference_from_camera=stated, camera=name
            )
            estimates.append((pose, localizer.advance(observation)))
    return estimates


RIG = {"front": FRONT, "back": BACK, "side": Poses.exp(np.array([0, 0, 0.2, 0, 0, 1.5]))}


@pytest.mark.parametrize(("turned_deg", "std"), [(57.0, STD), (172.0, STD), (10.0, 0.1 * STD)])
def test_a_camera_with_a_wrong_mount_is_left_out_and_the_others_decide(turned_deg, std):
    wrong = {"side": Poses.exp(np.array([0, 0, 0, 0, 0, np.radians(turned_deg)]))}
    estimates = circling(new_localizer(), RIG, wrong=wrong, std=std)
    for pose, estimate in estimates[90:]:
        assert estimate.modes[0].world_from_camera.distance(pose)[0] < 0.3
        assert estimate.status == "converged"
    assert [estimate.left_out for _, estimate in estimates[-3:]] == [(), (), ("side",)]


def test_a_covered_camera_does_not_keep_the_others_from_being_sure():
    for dark in (["side"], ["back", "side"]):
        estimates = circling(new_localizer(), RIG, dark=dark)
        assert {estimate.status for _, estimate in estimates[60:]} == {"converged"}


def test_a_camera_counts_again_once_its_views_fit():
    localizer = new_localizer()
    circling(localizer, RIG, wrong={"side": Poses.exp(np.array([0, 0, 0, 0, 0, 2.0]))}, count=40)
    here = localizer.predict(STAY).modes[0].world_from_camera
    estimates = circling(localizer, RIG, rng=RNG(3), start=here)
    left_out = ["side" in estimate.left_out for _, estimate in estimates]
    assert any(left_out[:6])
    assert not any(left_out[-90:])


def test_cameras_that_all_see_another_place_are_believed():
    localizer = new_localizer()
    circling(localizer, RIG)
    start = Poses.exp(np.array([40.0, 0, 0, 0, 0, 0]))
    elsewhere, estimate = circling(localizer, RIG, rng=RNG(5), count=120, start=start)[-1]
    assert estimate.modes[0].world_from_camera.distance(elsewhere)[0] < 0.3
    assert estimate.status == "converged"


def test_in_hindsight_the_errors_of_each_camera_are_its_own():
    """Three cameras whose errors last are worth three images; one camera that takes three images is worth one."""
    std_m = []
    for names in (["front"] * 3, ["front", "back", "side"]):
        localizer, steps = new_localizer(), []
        for i in range(30):
            for j, name in enumerate(names):
                observation = Observation.of_posterior(
                    seen_at(Poses.identity()), Odometry.still(0.0) if i + j else None, camera=name
                )
                steps.append(FilterStep.of(observation, localizer.advance(observation)))
        lagged = FixedLagSmoother(1.0, ERRORS)
        poses = [pose for step in steps for pose in lagged.update(step)] + lagged.finish()
        smoothed = smooth(steps, ERRORS, SmoothingConfig.of_filter(LocalizerConfig())).best
        std_m.append([np.sqrt(each[0, 0]) for each in (smoothed.covariance[45], poses[45].covariance)])
    lasting = ERRORS.correlated_fraction
    for one, three in zip(*std_m, strict=True):
        expected = np.sqrt((lasting / 3 + (1 - lasting) / 90) / (lasting + (1 - lasting) / 90))
        assert three / one == pytest.approx(expected, rel=0.2)


def test_the_kalman_filter_has_the_camera_that_is_localized():
    kalman, alone = KalmanLocalizer(), KalmanLocalizer()
    rng, pose = RNG(0), Poses.identity()
    for i in range(10):
        pose = pose @ AHEAD.previous_from_current
        seen = Observation.of_posterior(seen_at(pose @ Poses.exp(STD * rng.normal(size=6))), AHEAD if i else None, 0.1)
        other = seen_at(pose @ BACK)
        both = kalman.advance(seen)
        expected = alone.advance(seen)
        np.testing.assert_allclose(both.world_from_camera.as_matrix(), expected.world_from_camera.as_matrix())
        kalman.advance(
            Observation.of_posterior(other, Odometry.still(0.0), 0.0, reference_from_camera=BACK, camera="back")
        )


def test_a_frozen_camera_is_told_from_its_own_last_image_only():
    class Seen:
        def observe(self, image, *, rng):
            return seen_at(Poses.identity())

    localizer, image = ParticleLocalizer(Seen(), rng=RNG(0)), np.full((4, 4, 3), 7, np.uint8)
    assert not localizer.observe(image, camera="left").is_uninformative
    assert not localizer.observe(image, camera="right").is_uninformative
    assert localizer.observe(image, camera="left").is_uninformative


def test_cameras_and_gravity_may_come_in_any_order_in_filter_and_smoothers():
    level = Vertical(up=(0.0, 0.0, 1.0), tilt_std_rad=0.002)
    localizer, steps, truth, rng = new_localizer(), [], [], RNG(0)
    first_seen = {"front": 0, "back": 10, "side": 30}  # and gravity with image 20
    flat, pose = motion(0.1, 0, 0, 0, 0, 0.02), Poses.identity()
    for i in range(60):
        pose = pose @ flat.previous_from_current
        for name in (name for name, first in first_seen.items() if i >= first):
            mount = RIG[name]
            seen = seen_at(pose @ mount @ Poses.exp(STD * rng.normal(size=6)))
            odometry = (flat if name == "front" else Odometry.still(0.0)) if steps else None
            observation = Observation.of_posterior(seen, odometry, 0.1, reference_from_camera=mount, camera=name)
            observation = replace(observation, vertical=level if i >= 20 else None)
            steps.append(FilterStep.of(observation, localizer.advance(observation)))
            truth.append(pose)
    poses = Poses.stack(truth)
    smoothed = smooth(steps, ERRORS, SmoothingConfig.of_filter(LocalizerConfig())).best.poses
    lag = FixedLagSmoother(1.0, ERRORS)
    lagged = [pose for step in steps for pose in lag.update(step)] + lag.finish()
    assert [each.number for each in lagged] == list(range(len(steps)))
    filtered = Poses.stack([step.modes[0].world_from_camera for step in steps])
    for found in (filtered, smoothed, Poses.stack([each.world_from_camera for each in lagged])):
        assert found.distance(poses)[0].max() < 0.25
        tilt = np.arccos(np.clip(found.rotation[60:, 2, 2], -1.0, 1.0))
        assert tilt.max() < 0.01  # without gravity 0.05


def test_where_no_camera_sees_the_place_the_belief_is_lost():
    localizer = new_localizer()
    circling(localizer, RIG)
    estimates = circling(localizer, RIG, dark=list(RIG), count=40)
    assert estimates[-1][1].status == "lost"
    first = next(i for i, (_, estimate) in enumerate(estimates) if estimate.status == "lost")
    assert first < 3 * 30  # three seconds of three cameras


@pytest.mark.parametrize("dark", [(), ("back",)])
def test_a_camera_that_sees_nothing_any_more_does_not_decide_over_the_others(dark):
    """One camera is misled for a while beside a dead or covered one, and recovers as if it were alone."""
    localizer, rng, pose = new_localizer(), RNG(1), Poses.identity()
    circling(localizer, {"front": FRONT, "back": BACK})
    for _ in range(60):
        elsewhere = Poses.exp(np.concatenate([rng.uniform(-60.0, 60.0, 3), rng.normal(size=3)]))
        localizer.advance(Observation.of_posterior(seen_at(elsewhere), AHEAD, 0.1, camera="front"))
    pose, found = Poses.exp(np.array([40.0, 0, 0, 0, 0, 0])), []
    for _ in range(200):
        pose = pose @ AHEAD.previous_from_current
        seen = seen_at(pose @ FRONT @ Poses.exp(STD * rng.normal(size=6)))
        of_front = Observation.of_posterior(seen, AHEAD, 0.1, reference_from_camera=FRONT, camera="front")
        found.append(localizer.advance(of_front))
        for name in dark:
            localizer.advance(Observation.of_posterior(OUT_OF_DISTRIBUTION, Odometry.still(0.0), 0.0, camera=name))
    assert {estimate.status for estimate in found[-50:]} == {"converged"}
    assert found[-1].modes[0].world_from_camera.distance(pose)[0] < 0.3


def test_a_camera_with_a_wrong_mount_is_found_while_its_views_are_hardly_new():
    """Errors that are correlated over ten metres: a view is new once in a hundred images."""
    noise = replace(ERRORS, length_m=10.0, length_rad=10.0)
    localizer, rng, pose = new_localizer(), RNG(2), Poses.identity()
    left_out = []
    for _ in range(40):
        pose = pose @ AHEAD.previous_from_current
        for name, mount in RIG.items():
            turned = mount @ Poses.exp(np.array([0, 0, 0, 0, 0, 0.7])) if name == "side" else mount
            seen = seen_at(pose @ mount @ Poses.exp(0.1 * STD * rng.normal(size=6)), std=0.1 * STD, noise=noise)
            odometry = AHEAD if name == "front" else Odometry.still(0.0)
            view = Observation.of_posterior(seen, odometry, 0.1, reference_from_camera=turned, camera=name)
            left_out.append("side" in localizer.advance(view).left_out)
    assert sum(left_out) > 25
