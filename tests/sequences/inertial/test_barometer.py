"""Rides in lifts by a barometer: found, added to odometry that stands still, and the storey afterwards."""

import numpy as np
import pytest

from filtering.config import LocalizerConfig
from filtering.localizer import ParticleLocalizer
from filtering.motion import Odometry
from filtering.observation import Observation
from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from filtering.storeys import Storeys
from sequences.inertial.barometer import Barometer, LiftRides, height_of, rides_in
from sequences.inertial.sequence import InertialSequence
from sequences.inertial.topics import read_inertial, read_rides
from sequences.options import SequenceOptions
from sequences.reader import SequenceReader
from sequences.recordings.mcap_writer import ros_header
from tests.helpers.inertial_files import standing_with_unit, with_messages
from tests.helpers.sequence_files import BEGIN_NS
from tests.helpers.simulation import ERRORS, RNG, STD, image_errors, lifted, seen_at

UP = (0.0, -1.0, 0.0)


def pressure_of(height_m):
    return 101_325.0 * (1.0 - np.asarray(height_m) / 44_330.0) ** (1.0 / 0.1903)


def ride(seconds, *, by_m=3.0, begins_s=20.0, m_per_s=1.0):
    """A change of height at a constant speed."""
    return np.clip((np.asarray(seconds) - begins_s) * m_per_s, 0.0, abs(by_m)) * np.sign(by_m)


def heights(truth, *, hz=20.0, lasts_s=60.0, noise_m=0.1, seed=0):
    seconds = np.arange(0.0, lasts_s, 1.0 / hz)
    measured = truth(seconds) + noise_m * RNG(seed).standard_normal(len(seconds))
    return BEGIN_NS + (seconds * 1e9).astype(np.int64), measured


# --- which changes are rides ----------------------------------------------------------------------------


@pytest.mark.parametrize("by_m", [3.0, -3.0, 12.0])
@pytest.mark.parametrize("hz", [2.0, 20.0, 100.0])
def test_a_ride_is_found_with_its_time_and_its_height(by_m, hz):
    (found,) = rides_in(*heights(lambda t: ride(t, by_m=by_m), hz=hz, noise_m=0.05))
    assert found.heights_m[-1] == pytest.approx(by_m, abs=0.35)
    begin_s, end_s = (found.times_ns[[0, -1]] - BEGIN_NS) * 1e-9
    assert begin_s == pytest.approx(20.0, abs=1.2)
    assert end_s == pytest.approx(20.0 + abs(by_m), abs=1.2)


@pytest.mark.parametrize(
    ("truth", "why"),
    [
        (lambda t: 0.0 * t, "noise"),
        (lambda t: 0.8 * (t > 30), "a door that opens"),
        (lambda t: 1.5 * np.exp(-(((t - 30) / 0.4) ** 2)), "a gust"),
        (lambda t: 5.0 * t / 600.0, "the weather"),
        (lambda t: 3.0 * t / 60.0, "a long ramp"),
    ],
)
def test_other_changes_of_the_pressure_are_none(truth, why):
    for seed in range(5):
        assert not rides_in(*heights(truth, seed=seed)), why


def test_no_ride_goes_on_across_a_gap():
    times_ns, measured = heights(ride)
    kept = (times_ns < BEGIN_NS + 21 * 10**9) | (times_ns > BEGIN_NS + 25 * 10**9)
    assert not rides_in(times_ns[kept], measured[kept])


def test_heights_are_those_of_the_standard_atmosphere():
    np.testing.assert_allclose(height_of(pressure_of([0.0, 3.0, 500.0])), [0.0, 3.0, 500.0], atol=1e-6)


# --- what odometry becomes ------------------------------------------------------------------------------


def still(duration_s=0.1):
    return Odometry(Poses.identity(), 1e-6 * np.eye(6), duration_s)


def added(lifts, begin_s, end_s, odometry, up=UP):
    return lifts.step(BEGIN_NS + round(begin_s * 1e9), BEGIN_NS + round(end_s * 1e9), odometry, up)


def test_motions_add_up_to_the_ride_with_its_uncertainty():
    lifts = LiftRides(rides_in(*heights(ride)))
    whole = Odometry.still()
    for i in range(600):
        whole = whole.then(added(lifts, i / 10, (i + 1) / 10, still()))
    np.testing.assert_allclose(
        whole.previous_from_current.translation, [0, -lifts.rides[0].heights_m[-1], 0], atol=1e-6
    )
    assert 0.25 < np.sqrt(whole.covariance[1, 1]) < 0.5
    assert np.sqrt(whole.covariance[0, 0]) < 0.1
    assert "+3." in lifts.notices[0] or "+2.9" in lifts.notices[0]


def test_odometry_that_moves_or_is_unknown_and_a_camera_of_unknown_tilt_stay():
    lifts = LiftRides(rides_in(*heights(ride)))
    walks = Odometry(Poses.exp(np.array([0, 0, 0.05, 0, 0, 0])), 1e-6 * np.eye(6), 0.1)
    assert added(lifts, 21.0, 21.1, walks) is walks
    assert added(lifts, 21.0, 21.1, None) is None
    one, again = still(), LiftRides(lifts.rides)
    assert added(again, 21.0, 21.1, one, None) is one
    assert added(again, 10.0, 10.1, one) is one
    assert not lifts.notices
    assert not again.notices


def test_after_a_clock_was_set_back_rides_of_the_new_time_count_and_those_of_the_old_one_do_not():
    lifts, set_back_s = LiftRides(rides_in(*heights(ride))), 3600.0
    for i in range(600):
        added(lifts, set_back_s + i / 10, set_back_s + (i + 1) / 10, still())
    rises_m = -added(lifts, 21.0, 21.1, still()).previous_from_current.translation[1]
    assert rises_m == 0.0  # before rides of the new time are known
    lifts.extend(rides_in(*heights(ride)))
    rises_m = -added(lifts, 21.1, 21.2, still()).previous_from_current.translation[1]
    assert rises_m == pytest.approx(0.1, abs=0.03)


@pytest.mark.parametrize("hz", [3.0, 10.0, 30.0])
def test_odometry_that_trembles_stands_at_any_rate(hz):
    lifts, rng = LiftRides(rides_in(*heights(ride))), RNG(0)
    risen_m, number = 0.0, round(60 * hz)
    for i in range(number):
        trembles = Odometry(Poses.exp(np.append(0.003 * rng.standard_normal(3), np.zeros(3))), 1e-4 * np.eye(6), 1 / hz)
        motion = added(lifts, i / hz, (i + 1) / hz, trembles)
        moved = motion.previous_from_current.translation - trembles.previous_from_current.translation
        risen_m -= moved[1]
    assert risen_m == pytest.approx(lifts.rides[0].heights_m[-1], rel=0.05)


# --- pressures that come as time passes -----------------------------------------------------------------


def followed(truth, *, hz=10.0, lasts_s=60.0, seed=0, moves=lambda seconds: False):
    """What each motion of odometry rises by, and the rides, by pressures that come as time passes."""
    barometer, lifts, risen = Barometer("/pressure"), LiftRides(), []
    times_ns, measured = heights(truth, lasts_s=lasts_s, noise_m=0.05, seed=seed)
    at = 0
    for i in range(round(lasts_s * hz)):
        end_ns = BEGIN_NS + round((i + 1) / hz * 1e9)
        while at < len(times_ns) and times_ns[at] <= end_ns:
            barometer.take(int(times_ns[at]), pressure_of(measured[at]))
            at += 1
        if barometer.has_news():
            lifts.extend(barometer.rides(goes_on=True))
            barometer.forget_before(barometer.last_ns - 120 * 10**9)
        tangent = np.array([0, 0, 1.0 / hz if moves(i / hz) else 0.0, 0, 0, 0])
        motion = Odometry(Poses.exp(tangent), 1e-6 * np.eye(6), 1 / hz)
        found = added(lifts, i / hz, (i + 1) / hz, motion)
        risen.append(-found.previous_from_current.translation[1])
    return np.array(risen), lifts, barometer


@pytest.mark.parametrize("by_m", [3.0, -3.0, 12.0])
@pytest.mark.parametrize("hz", [3.0, 30.0])
def test_a_ride_that_shows_as_it_goes_is_made_up_for_within_seconds_and_without_a_leap(by_m, hz):
    risen, lifts, _ = followed(lambda t: ride(t, by_m=by_m), hz=hz)
    along = np.cumsum(risen)
    seconds = (np.arange(len(risen)) + 1) / hz
    assert along[-1] == pytest.approx(by_m, abs=0.35)
    off = np.abs(along - ride(seconds, by_m=by_m))
    assert off[seconds < 19.0].max() < 0.01
    assert off[seconds > 20.0 + abs(by_m) + 4.0].max() < 0.4
    assert np.abs(risen * hz).max() < 5.0  # metres a second
    assert len(lifts.rides) == 1


def test_a_robot_that_moves_while_the_pressure_changes_is_on_stairs_and_gets_nothing():
    risen, *_ = followed(ride, moves=lambda seconds: 15.0 < seconds < 30.0)
    np.testing.assert_array_equal(risen, np.zeros(len(risen)))


def test_what_is_left_of_a_ride_comes_while_the_robot_drives_on():
    risen, *_ = followed(ride, moves=lambda seconds: seconds > 23.5)
    assert risen.sum() == pytest.approx(3.0, abs=0.4)


def test_a_change_that_goes_back_at_once_is_undone():
    """As where a door lets the pressure of another room in for some seconds."""
    for seed in range(3):
        risen, *_ = followed(lambda t: ride(t, by_m=2.5) - ride(t, by_m=2.5, begins_s=22.7), seed=seed)
        assert np.cumsum(risen).max() > 1.0
        assert abs(risen.sum()) < 0.5


def test_hours_of_pressure_are_not_remembered():
    def rides(t):
        return sum(
            ride(t, begins_s=begin, by_m=(-1) ** number * 3.0) for number, begin in enumerate(range(60, 1200, 60))
        )

    risen, lifts, barometer = followed(rides, hz=2.0, lasts_s=1200.0)
    assert len(barometer._pressure) < 2500
    assert len(lifts.rides) == 19
    assert risen.sum() == pytest.approx(3.0, abs=1.0)
    assert np.abs(np.cumsum(risen) - rides(np.arange(2400) / 2.0))[::120].max() < 1.0


# --- the storey afterwards ------------------------------------------------------------------------------

FLOORS = Storeys((1.5, 4.5, 7.5))
LEVEL = Poses.from_matrix(np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 1.5], [0, 0, 0, 1]]))


BEGINS_S, DRIVES_ON_S = 8.0, 6.0


def storeys_after_a_ride(by_m, *, barometer, seed):
    """The belief on each storey before a ride with still wheels and no images, and 5 s after leaving; the true one."""
    rng, lasts_s = RNG(seed), BEGINS_S + abs(by_m) + 2.0

    def height(t):
        return ride(t, by_m=by_m, begins_s=BEGINS_S)

    lifts = LiftRides(rides_in(*heights(height, lasts_s=lasts_s + 10.0, seed=seed)) if barometer else [])
    localizer, pose, found = ParticleLocalizer(None, LocalizerConfig(), rng=RNG(seed)), LEVEL, []
    for i, error in enumerate(image_errors(np.full(round(10 * (lasts_s + 5.0)), 0.1), ERRORS, rng=rng)):
        seconds = i / 10
        drives = seconds < BEGINS_S - 2.0 or seconds > lasts_s
        step = Poses.exp(np.array([0, 0, 0.06, 0, 0.01, 0])) if drives else Poses.identity()
        risen = height(seconds) - height(seconds - 0.1)
        pose = pose @ step
        pose = Poses(pose.rotation, pose.translation + np.array([0, 0, float(risen)]))
        odometry = Odometry(step, np.diag(np.repeat([1e-5, 1e-6], 3)), 0.1)
        odometry = added(lifts, seconds - 0.1, seconds, odometry)
        at = pose @ Poses.exp(STD * error)
        floors = lifted(Poses(at.rotation, at.translation * [1, 1, 0]), [1.5, 4.5, 7.5])
        known = [1.0, 0.0, 0.0] if i < 10 else [1 / 3] * 3  # at first it sees something unique
        seen = seen_at(floors, known) if drives else PosePosterior.uninformative(ERRORS)
        found.append(FLOORS.belief(localizer.advance(Observation.of_posterior(seen, odometry))))
    return found[round(10 * BEGINS_S)], found[-1], int(FLOORS.of(pose))


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("by_m", [3.0, 6.0])
def test_five_seconds_after_leaving_a_lift_the_storey_is_right(by_m):
    for seed in range(2):
        before, after, storey = storeys_after_a_ride(by_m, barometer=True, seed=seed)
        assert before[0] > 0.9
        assert after[storey] > 0.8
    assert storeys_after_a_ride(by_m, barometer=False, seed=0)[1][storey] < 0.2


# --- recordings -----------------------------------------------------------------------------------------


@pytest.fixture
def in_a_lift(tmp_path):
    """A recording of 30 s of a robot that stands, with an inertial unit, while the pressure shows a ride."""
    with_imu = standing_with_unit(tmp_path, seconds=30.0)

    def record(unit=1.0):
        seconds = np.arange(0.0, 30.0, 0.1)
        times_ns = BEGIN_NS + (seconds * 1e9).astype(np.int64)
        pressure = unit * pressure_of(ride(seconds, begins_s=10.0))
        messages = [
            (t, {"header": ros_header(t, "base_link"), "fluid_pressure": p})
            for t, p in zip(times_ns.tolist(), pressure.tolist(), strict=True)
        ]
        return with_messages(with_imu, tmp_path / f"{unit}.mcap", "/pressure", "sensor_msgs/FluidPressure", messages)

    return record


@pytest.mark.parametrize("unit", [1.0, 0.01])
def test_a_recorded_ride_is_part_of_the_odometry_of_its_frames(in_a_lift, unit):
    path, options = in_a_lift(unit), SequenceOptions()
    rides, notices = read_rides(path, options)
    assert any("hPa" in notice for notice in notices) == (unit == 0.01)
    frames = InertialSequence(SequenceReader(path, options), *read_inertial(path, options), rides=rides)
    whole = Odometry.still()
    for frame in frames:
        whole = whole if frame.odometry is None else whole.then(frame.odometry)
    risen = whole.previous_from_current.translation @ np.array(frame.gravity.up)
    assert risen == pytest.approx(3.0, abs=0.3)
    assert any("the barometer shows 1 ride (+3.0 m)" in n or "(+2." in n for n in frames.notices)


def test_a_pressure_of_another_unit_is_not_used_and_said(in_a_lift):
    rides, notices = read_rides(in_a_lift(0.001), SequenceOptions())
    assert not rides
    assert "expected about 101325" in notices[0]


def test_a_recording_without_a_barometer_or_with_none_wanted_has_no_rides(in_a_lift, tmp_path):
    assert read_rides(in_a_lift(), SequenceOptions(pressure_topic="")) == ([], [])
    assert read_rides(tmp_path / "plain.mcap", SequenceOptions()) == ([], [])
