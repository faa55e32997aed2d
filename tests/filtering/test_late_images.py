"""Images that come late or out of order, and cameras of one moment in any order."""

from dataclasses import replace
from functools import reduce
from itertools import permutations

import numpy as np
import pytest

from filtering.errors import VaporTrackError
from filtering.kalman import KalmanLocalizer
from filtering.motion import MotionNoise, Odometry
from filtering.observation import Observation, View
from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from tests.helpers.simulation import (
    AHEAD,
    ERRORS,
    RNG,
    STAY,
    STD,
    assert_same_belief,
    lifted,
    motion,
    new_localizer,
    seen_at,
)

BEGIN_NS, EVERY_NS = 1_700_000_000_123_456_789, 100_000_000
MOUNT = Poses.exp(np.array([-0.3, 0.1, 0.1, 0, 0, 2.0]))


def seen_on_a_walk(count, *, seed=0):
    """Posteriors with two places each, and the odometry before each, of a walk that turns and speeds up."""
    rng, pose, seen, noise = RNG(seed), Poses.identity(), [], MotionNoise()
    for i in range(count):
        step = Poses.exp(np.array([0.05 + 0.02 * i, 0.03 * np.sin(i), 0, 0, 0.02, 0.3 * np.cos(i)]))
        pose = pose @ step
        places = lifted(pose @ Poses.exp(STD * rng.standard_normal(6)), (0.0, 3.0))
        seen.append((seen_at(places, (0.6, 0.3)), Odometry(step, noise.covariance(step, 0.1), 0.1)))
    return seen


def time_of(index):
    return BEGIN_NS + index * EVERY_NS


def since(seen, arrived, index):
    """The motion to an image from the one before it in time among those that came."""
    before = max((each for each in arrived if each < index), default=None)
    return None if before is None else reduce(Odometry.then, [seen[i][1] for i in range(before + 1, index + 1)])


def come_in(order, seen, *, cameras=lambda index: "camera", **settings):
    """Update with images as they come; odometry leads from the one before in time."""
    localizer, estimates = new_localizer(max_hypotheses=6, late_window_s=0.5, **settings), []
    for number, index in enumerate(order):
        view = View(seen[index][0], Poses.identity(), cameras(index))
        odom = since(seen, order[:number], index)
        estimates.append(localizer.update([view], odom, time_ns=time_of(index)))
    return localizer, estimates


@pytest.mark.parametrize(
    "order",
    [
        [0, 2, 1, 3, 4, 5, 6, 7],
        [0, 1, 6, 2, 3, 4, 5, 7],  # several in order, late by up to four images
        [0, 5, 4, 3, 2, 1, 7, 6],  # backwards, and the latest one before the last
        [0, 3, 1, 5, 2, 7, 4, 6],
    ],
)
@pytest.mark.parametrize("cameras", [lambda index: "camera", lambda index: f"camera {index % 2}"])
def test_images_in_any_order_give_the_belief_of_those_in_order(order, cameras):
    seen = seen_on_a_walk(8)
    expected, one_by_one = come_in(range(8), seen, cameras=cameras)
    late, estimates = come_in(order, seen, cameras=cameras)
    assert_same_belief(estimates[-1], one_by_one[-1], rtol=0, atol=1e-9)
    assert estimates[-1].status == one_by_one[-1].status
    assert abs(estimates[-1].agreement - one_by_one[-1].agreement) < 1e-9
    more, odom = seen_on_a_walk(9)[8]
    after = [each.update(more, odom, time_ns=time_of(8)) for each in (expected, late)]
    assert_same_belief(*after, rtol=0, atol=1e-9)


def test_a_late_image_counts_and_the_estimate_is_still_that_of_the_latest_time():
    seen = seen_on_a_walk(5)
    localizer, estimates = come_in([0, 1, 2, 4], seen)
    late = localizer.update(seen[3][0], seen[3][1], time_ns=time_of(3))
    before_m, after_m = (each.modes[0].world_from_camera.translation for each in (estimates[-1], late))
    assert 0.0 < np.linalg.norm(after_m - before_m) < 0.15
    assert late.modes[0].widest_std_m < estimates[-1].modes[0].widest_std_m
    assert late.novelty < estimates[-1].novelty  # part of what the latest one shows was seen before it


def test_without_odometry_of_a_late_image_the_known_motion_is_split_at_its_time():
    noise = MotionNoise()
    step = Poses.exp(np.array([0.2, 0.02, 0, 0, 0.1, 0.4]))
    piece = Odometry(step, noise.covariance(step, 0.1), 0.1)
    seen = [seen_at(lifted(Poses.exp(i * step.log()), (0.0, 3.0)), (0.6, 0.3)) for i in range(5)]
    in_order, late = new_localizer(), new_localizer()
    for i in range(5):
        expected = in_order.update(seen[i], piece, time_ns=time_of(i))
    late.update(seen[0], None, time_ns=time_of(0))
    late.update(seen[4], reduce(Odometry.then, [piece] * 4), time_ns=time_of(4))
    for i in (3, 1, 2):
        estimate = late.update(seen[i], None, time_ns=time_of(i))
    assert_same_belief(estimate, expected, rtol=0, atol=1e-9)


def test_a_gap_of_odometry_is_split_as_well_and_odometry_of_a_part_of_it_ends_there():
    seen = seen_on_a_walk(4)
    for part in (None, seen[1][1]):
        in_order, late = new_localizer(), new_localizer()
        for index, odom in ((0, None), (1, part), (3, None)):
            expected = in_order.update(seen[index][0], odom, time_ns=time_of(index))
        for index, odom in ((0, None), (3, None), (1, part)):
            estimate = late.update(seen[index][0], odom, time_ns=time_of(index))
        assert_same_belief(estimate, expected, rtol=0, atol=1e-9)


def test_odometry_that_comes_by_itself_makes_the_split_exact():
    seen = seen_on_a_walk(6)
    in_order, late = new_localizer(), new_localizer()
    for localizer in (in_order, late):
        localizer.update(seen[0][0], None, time_ns=time_of(0))
    for i in range(1, 6):
        expected = in_order.predict(seen[i][1], time_ns=time_of(i))
        late.predict(seen[i][1], time_ns=time_of(i))
        if i in (2, 5):
            expected = in_order.update(seen[i][0], STAY, time_ns=time_of(i))
    for i in (5, 2):
        estimate = late.update(seen[i][0], STAY, time_ns=time_of(i))
    assert_same_belief(estimate, expected, rtol=0, atol=1e-9)


def test_with_a_time_the_elapsed_time_is_that_between_the_steps():
    posterior = seen_at(Poses.identity(1))
    timed, stated = new_localizer(), new_localizer()
    for i in range(3):
        one = timed.update(posterior, None, time_ns=i * 3 * 10**9)
        other = stated.update(posterior, None, elapsed_s=3.0)
    assert_same_belief(one, other, atol=0)


# --- cameras of one moment --------------------------------------------------------------------------------------


def rig_on_a_walk(count):
    """Posteriors and mounts of three cameras at each of some moments; the second is the most exact."""
    rng, pose, mounts = RNG(0), Poses.identity(), [Poses.identity(), MOUNT, MOUNT.inverse()]
    for _ in range(count):
        pose = pose @ AHEAD.previous_from_current
        errors = STD * rng.standard_normal((3, 6))
        yield [
            (seen_at(pose @ mount @ Poses.exp(error), std=std * STD), mount)
            for mount, error, std in zip(mounts, errors, (1.0, 0.3, 1.0), strict=True)
        ]


@pytest.mark.parametrize("names", ["abc", "cab"])
@pytest.mark.parametrize("at_once", [True, False])
def test_cameras_of_one_moment_give_the_same_in_any_order_by_any_names_and_in_one_call_or_several(names, at_once):
    expected = None
    for order in permutations(range(3)):
        localizer = new_localizer()
        for i, seen in enumerate(rig_on_a_walk(4)):
            views = [View(*seen[each], names[each]) for each in order]
            for number, call in enumerate([views] if at_once else [[view] for view in views]):
                estimate = localizer.update(call, None if number else AHEAD, time_ns=time_of(i))
        if expected is None:
            alone = new_localizer()
            for seen in rig_on_a_walk(4):
                expected = alone.update([View(*each, name) for each, name in zip(seen, "xyz", strict=True)], AHEAD)
        assert_same_belief(estimate, expected, rtol=0, atol=0)


def test_an_image_after_a_prediction_of_its_time_is_the_image_of_that_motion():
    seen = seen_on_a_walk(3)
    one, other = new_localizer(), new_localizer()
    for i in range(3):
        expected = one.update(*seen[i], time_ns=time_of(i))
        if i:
            other.predict(seen[i][1], time_ns=time_of(i))
        estimate = other.update(seen[i][0], None, time_ns=time_of(i))
    assert_same_belief(estimate, expected, rtol=0, atol=0)


# --- beyond the window, and other times that cannot be used -----------------------------------------------------


def refused(localizer, match, update=lambda localizer: localizer.update(seen_at(Poses.identity()), None, time_ns=5)):
    belief, history = localizer.belief, localizer._history
    with pytest.raises(VaporTrackError, match=match):
        update(localizer)
    assert localizer.belief is belief
    assert localizer._history is history


def test_an_image_beyond_the_window_is_refused_and_the_latest_of_the_window_is_not():
    seen = seen_on_a_walk(10)
    localizer, _ = come_in([0, 1, 2, 3, 8], seen)
    update = localizer.update
    with pytest.raises(
        VaporTrackError, match=r"is 0\.600 s older than the latest, .* at most 0\.5 s \(late_window_s\)"
    ):
        update(seen[2][0], None, time_ns=time_of(2))
    with pytest.raises(VaporTrackError, match=r"views of cameras camera, camera"):
        update(seen[3][0], None, time_ns=time_of(3))  # which has an image
    instant = new_localizer(late_window_s=0.0)
    instant.update(seen[0][0], None, time_ns=time_of(1))
    with pytest.raises(VaporTrackError, match=r"0\.001 s older than the latest, .* at most 0 s"):
        instant.update(seen[0][0], None, time_ns=time_of(1) - 10**6)
    update(seen[4][0], since(seen, [3], 4), time_ns=time_of(4))


def test_no_image_before_the_first_one_or_a_stated_pose_is_taken():
    posterior = seen_at(Poses.identity(1))
    localizer = new_localizer()
    localizer.update(posterior, None, time_ns=100)
    refused(localizer, "expected none before the first one, at 100 ns")
    localizer.forget()
    localizer.update(posterior, None, time_ns=7)  # of another clock, after the belief was forgotten
    localizer.start_at(Poses.identity(), np.eye(6), ERRORS, time_ns=100)
    refused(localizer, "expected none before the first one, at 100 ns")
    localizer.update(posterior, AHEAD, time_ns=10**8 + 100)
    refused(localizer, "expected none before the first one, at 100 ns")
    localizer.update(posterior, replace(AHEAD, duration_s=0.05), time_ns=5 * 10**7 + 100)
    localizer.start_at(Poses.identity(), np.eye(6), ERRORS)
    localizer.update(posterior, AHEAD, time_ns=5)


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("time_ns", [-1, 0.5, 1e9, float("nan"), True, "5", 1 << 63])
def test_a_time_that_is_no_count_of_nanoseconds_is_refused(time_ns):
    refused(
        new_localizer(),
        "time_ns is .*, expected integer nanoseconds from 0 to",
        lambda localizer: localizer.update(seen_at(Poses.identity()), None, time_ns=time_ns),
    )
    with pytest.raises(VaporTrackError, match="time_ns is"):
        new_localizer().start_at(Poses.identity(), np.eye(6), ERRORS, time_ns=time_ns)


@pytest.mark.usefixtures("unchecked")  # the annotation says int
def test_numpy_integers_are_times():
    assert Observation((), None, time_ns=np.int64(5)).time_ns == 5


def test_steps_with_and_without_times_are_not_mixed():
    posterior = seen_at(Poses.identity(1))
    timed, untimed = new_localizer(), new_localizer()
    timed.update(posterior, None, time_ns=4)
    untimed.update(posterior, None)
    refused(timed, "without time_ns after one at 4 ns", lambda localizer: localizer.update(posterior, None))
    refused(timed, "without time_ns after one at 4 ns", lambda localizer: localizer.predict(AHEAD))
    refused(untimed, "at time_ns 5 after steps without a time")
    assert timed.predicted(AHEAD).status == "converged"
    for localizer in (timed, untimed):
        localizer.forget()
    untimed.update(posterior, None, time_ns=5)
    timed.update(posterior, None)


def test_a_baseline_without_a_history_takes_no_times():
    with pytest.raises(VaporTrackError, match="time_ns is 5, expected None: this baseline keeps no history"):
        KalmanLocalizer().advance(Observation.of_posterior(seen_at(Poses.identity(1)), None, time_ns=5))


def test_odometry_since_the_wrong_image_is_noticed_by_how_long_it_took():
    seen = seen_on_a_walk(4)
    localizer, _ = come_in([0, 3], seen)
    for wrong in (since(seen, [0], 3), Odometry.still(), replace(seen[1][1], duration_s=-0.1)):
        refused(
            localizer,
            r"took .* expected the motion since the observation before|expected a finite duration",
            lambda localizer, wrong=wrong: localizer.update(seen[1][0], wrong, time_ns=time_of(1)),
        )


def test_a_late_image_that_raises_changes_nothing():
    localizer, _ = come_in([0, 1, 3], seen_on_a_walk(4))
    bad = replace(AHEAD, covariance=np.full((6, 6), np.nan))
    refused(
        localizer,
        "covariance is not finite",
        lambda localizer: localizer.update(PosePosterior.uninformative(ERRORS), bad, time_ns=time_of(2)),
    )


def test_what_is_kept_is_the_window():
    localizer = new_localizer(late_window_s=0.3)
    for i in range(40):
        localizer.update(seen_at(Poses.identity()), STAY, time_ns=time_of(i))
    assert [moment.time_ns for moment in localizer._history.moments] == [time_of(i) for i in (36, 37, 38, 39)]


# --- parts of a motion ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("turn_rad", [0.0, 0.7, 3.1])
def test_the_parts_of_a_motion_are_the_motion_and_share_its_noise_evenly(turn_rad):
    noise, whole = MotionNoise(), Poses.exp(np.array([3.0, 0.2, -0.1, 0, 0.05, turn_rad]))
    odometry = Odometry(whole, noise.covariance(whole, 2.0), 2.0)
    first = odometry.part(0.3)
    again = first.then(odometry.after(first))
    assert again.duration_s == pytest.approx(2.0)
    np.testing.assert_allclose(again.previous_from_current.as_matrix(), whole.as_matrix(), atol=1e-12)
    np.testing.assert_allclose(again.covariance, odometry.covariance, atol=1e-12)
    step = Poses.exp(0.3 * whole.log())
    np.testing.assert_allclose(first.covariance, noise.covariance(step, 0.6), rtol=1e-6, atol=1e-12)


def test_the_rest_of_a_motion_has_a_covariance_whatever_the_first_part_states():
    rest = motion(0.2, 0, 0, 0, 0, 0.3).after(motion(0.1, 0, 0, 0, 0, 0, std=np.full(6, 0.5)))
    assert np.linalg.eigvalsh(rest.covariance)[0] >= -1e-15
    assert rest.duration_s == 0.0
