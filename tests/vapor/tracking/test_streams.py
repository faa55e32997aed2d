"""Images and odometry by callbacks, in any order, against the frames that a reader makes of a recording of them."""

import threading
import tracemalloc
from itertools import pairwise

import numpy as np
import pytest

from filtering.config import LocalizerConfig
from filtering.errors import VaporTrackError
from filtering.localizer import ParticleLocalizer
from filtering.motion import MotionNoise, Odometry
from filtering.observation import Observation, View
from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from sequences.reader import SequenceReader
from sequences.trajectories.interpolation import odometry_between
from tests.helpers.sequence_files import BASE_FROM_CAMERA, BEGIN_NS, TWIST_COVARIANCE, Walk, picture, world_from_base
from tests.helpers.simulation import ERRORS, RNG, STD, assert_same_belief, lifted, seen_at
from vapor.tracking.streams import StreamLocalizer


def sent(pose):
    """A pose as a message has it, by a quaternion."""
    return Poses.from_quat_xyzw(pose.translation, pose.as_quat_xyzw())


COUNT = 20
WALK = Walk(COUNT)
MOUNT = sent(BASE_FROM_CAMERA)
ODOMETRY = [(time_ns, sent(pose)) for time_ns, pose in WALK.odometry]
TIMES_NS = [time_ns for time_ns, _ in WALK.images]
"""Of the images; odometry comes every 20 ms, between them."""


def posterior(index):
    """Of an image: its place, and one three metres above that looks alike until the eighth."""
    truth = world_from_base(np.array(TIMES_NS[index])) @ BASE_FROM_CAMERA
    off = Poses.exp(0.3 * STD * np.random.default_rng(index).standard_normal(6))
    return seen_at(lifted(truth @ off, (0.0, 3.0)), (0.6, 0.3)) if index < 8 else seen_at(truth @ off)


class Knowing:
    """A model that knows an image by its number, in its first value."""

    def observe(self, image, *, rng):
        return posterior(int(image[0, 0, 0]))


def image_of(index):
    return np.full((4, 4, 3), index, np.uint8)


def new_stream(*, model=None, base_from_camera=MOUNT, late_window_s=0.5, **options):
    localizer = ParticleLocalizer(model, LocalizerConfig(late_window_s=late_window_s), rng=RNG(0))
    return StreamLocalizer(localizer, base_from_camera=base_from_camera, **options)


def image_event(index, **named):
    def come(stream):
        return stream.add_observation(
            Observation.of_posterior(posterior(index), None, time_ns=TIMES_NS[index], **named)
        )

    return TIMES_NS[index], come


def odometry_event(time_ns, pose):
    return time_ns, lambda stream: stream.add_odometry(time_ns, pose, TWIST_COVARIANCE)


def events(*, odometry_late_ns=0, image_late_ns=lambda index: 0, odometry=ODOMETRY, images=range(COUNT)):
    """Callbacks, in the order in which they come."""
    of_odometry = [(time_ns + odometry_late_ns, odometry_event(time_ns, pose)[1]) for time_ns, pose in odometry]
    of_images = [(TIMES_NS[index] + image_late_ns(index), image_event(index)[1]) for index in images]
    return [come for _, come in sorted([*of_odometry, *of_images], key=lambda each: each[0])]


def run(stream, callbacks):
    return [estimate for come in callbacks for estimate in come(stream)]


@pytest.fixture(scope="module")
def expected(tmp_path_factory):
    """The estimates by the frames of a recording."""
    reader = SequenceReader(WALK.write(tmp_path_factory.mktemp("walk") / "walk.mcap"))
    localizer, estimates = ParticleLocalizer(None, rng=RNG(0)), []
    for index, frame in enumerate(reader):
        estimates.append(localizer.update(posterior(index), frame.odometry, time_ns=frame.time_ns))
    assert len(estimates) == COUNT
    return estimates


@pytest.mark.parametrize("odometry_late_ns", [0, 15_000_000, 170_000_000], ids=["at once", "late", "images wait"])
def test_images_in_order_give_the_estimates_of_a_recording_to_the_last_bit(expected, odometry_late_ns):
    stream = new_stream()
    estimates = run(stream, events(odometry_late_ns=odometry_late_ns)) + stream.flush()
    assert [each.time_ns for each in estimates] == TIMES_NS
    for ours, theirs in zip(estimates, expected, strict=True):
        assert_same_belief(ours.estimate, theirs, rtol=0, atol=0)
    assert not stream.skipped


def test_poses_of_odometry_that_come_before_an_image_is_due_come_in_any_order(expected):
    stream = new_stream()
    for index in range(4):
        image_event(index)[1](stream)
    came, estimates = [0, 1], []
    for first in range(2, 22, 5):  # of those from one image to the next
        came += [first, *range(first + 4, first, -1)]
    for number in came:
        estimates += odometry_event(*ODOMETRY[number])[1](stream)
    assert [each.time_ns for each in estimates] == TIMES_NS[:4]
    assert_same_belief(estimates[-1].estimate, expected[3], rtol=0, atol=0)


def test_images_that_are_late_give_the_belief_of_those_in_order(expected):
    stream = new_stream()
    lateness_ns = (0, 250_000_000, 0, 330_000_000, 10_000_000)
    estimates = run(stream, events(image_late_ns=lambda index: lateness_ns[index % 5])) + stream.flush()
    assert len(estimates) == COUNT
    assert estimates[-1].time_ns == TIMES_NS[-1]
    assert_same_belief(estimates[-1].estimate, expected[-1], rtol=0, atol=1e-9)


def increments():
    """Time and motion of the base from message to message, with the noise that its twist covariance makes."""
    for (before_ns, before), (time_ns, pose) in pairwise(ODOMETRY):
        yield (
            time_ns,
            odometry_between(
                np.array([before_ns, time_ns]),
                Poses.stack([before, pose]),
                np.stack([TWIST_COVARIANCE] * 2),
                before_ns,
                time_ns,
                base_from_camera=Poses.identity(),
                motion_noise=MotionNoise(),
            ),
        )


@pytest.mark.parametrize("form", ["velocities", "increments"])
def test_velocities_and_increments_are_the_same_motion(expected, form):
    stream = new_stream()
    callbacks = [(TIMES_NS[i], image_event(i)[1]) for i in range(COUNT)]
    if form == "velocities":
        first_ns = ODOMETRY[0][0]
        callbacks.append((first_ns, lambda stream: stream.add_velocity(first_ns, np.zeros(6), TWIST_COVARIANCE)))
    for time_ns, odometry in increments():
        if form == "velocities":
            velocity = odometry.tangent / odometry.duration_s

            def come(stream, time_ns=time_ns, velocity=velocity):
                return stream.add_velocity(time_ns, velocity, TWIST_COVARIANCE)
        else:

            def come(stream, time_ns=time_ns, odometry=odometry):
                return stream.add_increment(time_ns, odometry)

        callbacks.append((time_ns, come))
    estimates = run(stream, [come for _, come in sorted(callbacks, key=lambda each: each[0])]) + stream.flush()
    assert_same_belief(estimates[-1].estimate, expected[-1], rtol=0, atol=1e-7)
    assert not stream.skipped


def test_across_a_lost_increment_the_motion_is_unknown_and_an_overlapping_one_is_left_out():
    stream = new_stream()
    step = Odometry(Poses.exp(np.array([0.01, 0, 0, 0, 0, 0])), 1e-6 * np.eye(6), 0.02)
    by_time = {}
    for number in range(50):
        time_ns = BEGIN_NS + 20_000_000 * (number + 1)
        if number != 22:  # between the fifth image and the sixth
            stream.add_increment(time_ns, step)
        if number % 5 == 4:
            index = number // 5 + 1
            for each in image_event(index)[1](stream):
                by_time[index] = each.estimate
    assert [index for index, estimate in by_time.items() if estimate.gap_motion is not None] == [5]
    stream.add_increment(time_ns + 5_000_000, step)
    assert stream.skipped == {"an increment overlaps the one before": 1}


def test_increments_that_know_the_rotation_alone_leave_the_way_unknown_and_turn_the_camera():
    turning = np.array([0, 0, 0, 0, 0, 0.02])
    stream = new_stream()
    by_time = run(stream, [image_event(0)[1]])
    for number in range(50):
        time_ns = BEGIN_NS + 20_000_000 * (number + 1)
        turned = Odometry.turn(Poses.exp(turning), 1e-8 * np.eye(3), 0.02)
        if not 20 <= number < 30:  # of two images
            turned = Odometry(Poses.exp(turning), 1e-8 * np.eye(6), 0.02)
        by_time += stream.add_increment(time_ns, turned)
        if number % 5 == 4:
            nothing = Observation.of_posterior(PosePosterior.uninformative(ERRORS), None, time_ns=time_ns)
            by_time += stream.add_observation(nothing)
    unknown = [i for i, each in enumerate(by_time) if each.estimate.gap_motion is not None]
    assert unknown == [5, 6]
    first, last = by_time[0].map_from_base, by_time[-1].map_from_base
    np.testing.assert_allclose(first.between(last).log()[3:], [0, 0, 1.0], atol=1e-6)
    stds = [float(np.sqrt(np.trace(each.estimate.modes[0].covariance[:3, :3]))) for each in by_time]
    assert stds[6] > 3.0 * stds[4]


def test_across_a_jump_of_the_odometry_and_a_time_without_any_the_motion_is_unknown():
    leap = Poses.exp(np.array([3.0, 0, 0, 0, 0, 0]))
    odometry = [(t, leap @ pose if t > TIMES_NS[4] + 50_000_000 else pose) for t, pose in ODOMETRY]
    odometry = [each for each in odometry if not TIMES_NS[8] + 10_000_000 < each[0] < TIMES_NS[14]]
    stream = new_stream(wait_s=1.0)
    estimates = run(stream, events(odometry=odometry)) + stream.flush()
    unknown = [i for i, each in enumerate(estimates) if each.estimate.gap_motion is not None]
    assert unknown == [5, *range(9, 16)]


def test_what_comes_twice_or_too_late_is_left_out_and_counted(expected):
    stream = new_stream()
    callbacks = events()
    estimates = run(stream, callbacks)
    again = [image_event(3), image_event(COUNT - 1), odometry_event(*ODOMETRY[-1])]
    assert run(stream, [come for _, come in again]) == []
    assert stream.skipped == {"time stamp not increasing": 3}
    assert_same_belief(estimates[-1].estimate, expected[-1], rtol=0, atol=0)


def test_a_clock_that_is_set_back_is_an_error_that_changes_nothing_until_all_is_forgotten(expected):
    stream = new_stream()
    callbacks = events()
    run(stream, callbacks[:60])
    hour_ns = 3600 * 10**9
    for call in (
        lambda: stream.add_odometry(BEGIN_NS - hour_ns, Poses.identity()),
        lambda: stream.add_observation(Observation.of_posterior(posterior(0), None, time_ns=BEGIN_NS - hour_ns)),
    ):
        with pytest.raises(VaporTrackError, match=r"360\d\.\d s older than the latest, .* `forget` begins anew"):
            call()
    assert_same_belief((run(stream, callbacks[60:]) + stream.flush())[-1].estimate, expected[-1], rtol=0, atol=0)
    stream.forget()
    again = run(stream, callbacks) + stream.flush()
    assert again[-1].time_ns == TIMES_NS[-1]
    assert again[0].estimate.status == "ambiguous"


def test_an_image_waits_no_longer_than_it_should_for_odometry_that_does_not_come():
    stream = new_stream(wait_s=0.25)
    came = [len(image_event(index)[1](stream)) for index in range(8)]
    assert came == [0, 0, 0, 1, 1, 1, 1, 1]
    assert [each.time_ns for each in stream.flush()] == TIMES_NS[5:8]
    alone = new_stream(wait_s=0.0)
    assert [len(image_event(index)[1](alone)) for index in range(8)] == [1] * 8


def test_where_no_image_comes_the_belief_follows_odometry_in_little_memory(unchecked):
    stream = new_stream(base_from_camera=None)
    run(stream, [image_event(0)[1], image_event(1)[1]])
    speed = np.array([0.2, 0, 0, 0, 0, 0.05])
    sizes = []
    tracemalloc.start()
    for number in range(1, 4001):  # over three minutes
        time_ns = TIMES_NS[1] + 50_000_000 * number
        stream.add_velocity(time_ns, speed)
        if number in (1000, 4000):
            sizes.append(tracemalloc.get_traced_memory()[0])
    tracemalloc.stop()
    assert sizes[1] < sizes[0] + 200_000
    (estimate,) = stream.add_observation(Observation.of_posterior(posterior(12), None, time_ns=time_ns))
    assert estimate.time_ns == time_ns
    assert np.sqrt(np.trace(estimate.estimate.covariances[0][:3, :3])) > 0.1


def test_images_and_odometry_from_two_threads_give_the_belief_of_one(expected, unchecked):
    stream = new_stream(model=Knowing())
    # Either may be ahead by less than `wait_s`: longer no image waits.
    found, odometry_ahead, images_ahead = [], threading.Semaphore(20), threading.Semaphore(4)

    def bring_odometry():
        for index, (time_ns, pose) in enumerate(ODOMETRY):
            odometry_ahead.acquire()
            found.extend(stream.add_odometry(time_ns, pose, TWIST_COVARIANCE))
            if index % 5 == 0:
                images_ahead.release()

    thread = threading.Thread(target=bring_odometry)
    thread.start()
    for index in range(COUNT):
        images_ahead.acquire()
        found.extend(stream.add_image(TIMES_NS[index], image_of(index)))
        for _ in range(5):
            odometry_ahead.release()
    odometry_ahead.release(len(ODOMETRY))
    thread.join()
    found.extend(stream.flush())
    assert sorted(each.time_ns for each in found) == TIMES_NS
    latest = max(found, key=lambda each: each.time_ns)
    assert_same_belief(latest.estimate, expected[-1], rtol=0, atol=0)


def test_odometry_is_taken_while_the_network_is_busy():
    class Busy(Knowing):
        begun, done = threading.Event(), threading.Event()

        def observe(self, image, *, rng):
            self.begun.set()
            assert self.done.wait(10)
            return super().observe(image, rng=rng)

    stream, found = new_stream(model=Busy()), []
    thread = threading.Thread(target=lambda: found.extend(stream.add_image(TIMES_NS[0], image_of(0))))
    thread.start()
    assert Busy.begun.wait(10)
    for time_ns, pose in ODOMETRY[:10]:
        assert stream.add_odometry(time_ns, pose) == []
    Busy.done.set()
    thread.join()
    assert [each.time_ns for each in found] == TIMES_NS[:1]


def test_the_poses_of_the_robot_are_those_of_its_odometry_in_the_map():
    in_map = Poses.exp(np.array([5.0, -2.0, 0.3, 0, 0, 1.0]))
    stream = new_stream(late_window_s=0.5)
    odometry = [(time_ns, in_map.inverse() @ pose) for time_ns, pose in ODOMETRY]
    estimates = run(stream, events(odometry=odometry)) + stream.flush()
    assert estimates[0].map_from_odom is None  # ambiguous
    best = estimates[-1]
    metres, radians = best.map_from_odom.distance(in_map)
    assert metres < 0.2
    assert radians < 0.1
    truth = world_from_base(np.array(best.time_ns))
    np.testing.assert_allclose(best.map_from_base.distance(truth), 0.0, atol=0.15)


def test_views_of_several_cameras_are_views_of_one_moment():
    beside_it = Poses.exp(np.array([-0.3, 0.1, 0.1, 0, 0, 2.0]))
    beside = [
        PosePosterior(each.means @ beside_it, each.covariances, each.weights, ERRORS, each.samples @ beside_it)
        for each in map(posterior, range(COUNT))
    ]

    def both(index):
        views = View(posterior(index), Poses.identity(), "front"), View(beside[index], beside_it, "back")
        return [Observation((view,), time_ns=TIMES_NS[index]) for view in views], views

    together, apart = new_stream(), new_stream()
    for stream in (together, apart):
        for time_ns, pose in ODOMETRY:
            stream.add_odometry(time_ns, pose, TWIST_COVARIANCE)
            break
    for index in range(6):
        for stream in (together, apart):
            for time_ns, pose in ODOMETRY[5 * index + 1 : 5 * index + 6]:
                stream.add_odometry(time_ns, pose, TWIST_COVARIANCE)
        singles, views = both(index)
        one = together.add_observation(Observation(views, time_ns=TIMES_NS[index]))[-1]
        two = [each for single in singles for each in apart.add_observation(single)][-1]
    assert_same_belief(one.estimate, two.estimate, rtol=0, atol=1e-9)


def test_a_first_image_without_a_place_is_left_out():
    stream = new_stream(wait_s=0.0)
    nothing = PosePosterior.uninformative()
    assert stream.add_observation(Observation.of_posterior(nothing, None, time_ns=TIMES_NS[0])) == []
    assert stream.skipped == {"no place in the first image": 1}
    assert len(image_event(1)[1](stream)) == 1


def test_a_stated_pose_is_where_it_goes_on():
    stream = new_stream(wait_s=0.0)
    for time_ns, pose in ODOMETRY[:40]:
        stream.add_odometry(time_ns, pose, TWIST_COVARIANCE)
    truth = world_from_base(np.array(TIMES_NS[6])) @ BASE_FROM_CAMERA
    stream.start_at(TIMES_NS[6], truth, 1e-4 * np.eye(6), ERRORS)
    assert image_event(5)[1](stream) == []
    (estimate,) = image_event(7)[1](stream)
    assert estimate.estimate.status == "converged"


BAD = {
    r"time_ns is 1\.5, expected integer": lambda stream: stream.add_odometry(1.5, Poses.identity()),
    r"odometry has batch shape \(2,\)": lambda stream: stream.add_odometry(1, Poses.identity(2)),
    "odometry is not finite": lambda stream: stream.add_odometry(1, Poses(np.eye(3), np.array([0, np.nan, 0]))),
    "odometry is of type ndarray, expected Poses": lambda stream: stream.add_odometry(1, np.eye(4)),
    r"covariance has shape \(36,\), expected \(6, 6\)": lambda stream: stream.add_odometry(
        1, Poses.identity(), [0.0] * 36
    ),
    "negative eigenvalue": lambda stream: stream.add_odometry(1, Poses.identity(), -np.eye(6)),
    "velocity is .*, expected six finite": lambda stream: stream.add_velocity(1, np.array([np.inf, 0, 0, 0, 0, 0])),
    "as increments after poses, expected one form": lambda stream: stream.add_increment(BEGIN_NS, Odometry.still(0.1)),
    "with 0 views and odometry None, expected": lambda stream: stream.add_observation(Observation(time_ns=1)),
    "no observation model": lambda stream: stream.add_image(BEGIN_NS, picture(0)),
}


@pytest.mark.parametrize("message", BAD)
def test_what_cannot_be_used_is_named(message, unchecked):
    stream = new_stream()
    if "form" in message:
        stream.add_odometry(BEGIN_NS, Poses.identity())
    with pytest.raises(VaporTrackError, match=message):
        BAD[message](stream)


class Forgetful:
    """A model that returns nothing."""

    def observe(self, image, *, rng):
        return None


def test_an_image_whose_posterior_or_camera_is_none_is_an_error_at_once_and_the_next_one_comes(unchecked):
    stream = new_stream(model=Forgetful())
    with pytest.raises(VaporTrackError, match=r"camera 'camera': posterior is None, expected a PosePosterior"):
        stream.add_image(TIMES_NS[0], image_of(0))
    with pytest.raises(VaporTrackError, match=r"reference_from_camera of camera 'camera' has batch shape \(1,\)"):
        image_event(0, reference_from_camera=Poses.identity(1))[1](stream)
    for each in ODOMETRY[:8]:
        assert odometry_event(*each)[1](stream) == []
    assert len(image_event(0)[1](stream)) == 1


@pytest.mark.parametrize(
    ("mount", "message"),
    [
        (Poses.identity(1), r"base_from_camera has batch shape \(1,\), expected \(\): one pose"),
        (np.eye(4), "base_from_camera is of type ndarray, expected Poses"),
        (Poses(np.eye(3), np.array([0, np.nan, 0])), "base_from_camera is not finite"),
    ],
    ids=["batch", "matrix", "NaN"],
)
def test_a_mount_that_is_no_pose_is_named(mount, message, unchecked):
    with pytest.raises(VaporTrackError, match=message):
        new_stream(base_from_camera=mount)


def test_a_start_that_is_no_single_pose_is_named(unchecked):
    with pytest.raises(VaporTrackError, match=r"world_from_camera has batch shape \(1,\)"):
        new_stream().start_at(TIMES_NS[0], Poses.identity(1), 1e-4 * np.eye(6), ERRORS)


def test_a_wait_that_is_none_is_named():
    with pytest.raises(VaporTrackError, match=r"wait_s is -1\.0, expected between 0\.0 and 60\.0"):
        new_stream(wait_s=-1.0)
