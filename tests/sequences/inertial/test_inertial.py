"""Gravity by an inertial unit: right along a walk, and what becomes of units, gaps, saturation and wrong drivers."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from filtering.se3 import Poses
from sequences.errors import SequenceError
from sequences.frame import Gravity
from sequences.inertial.gravity import GravityFilter
from sequences.inertial.samples import InertialSamples, InertialUnit
from sequences.inertial.sequence import InertialSequence, beside_true_poses
from sequences.inertial.topics import read_inertial
from sequences.options import SequenceOptions
from sequences.reader import SequenceReader
from tests.helpers.inertial_files import GRAVITY, IMU, inertial_messages, with_messages, without_orientation
from tests.helpers.sequence_files import BEGIN_NS, Walk, world_from_camera

RNG = np.random.default_rng


@pytest.fixture
def recorded(tmp_path):
    plain = Walk().write(tmp_path / "plain.mcap")

    def record(topic=IMU, *, source=plain, **messages):
        path = tmp_path / f"{topic.replace('/', '_')}{len(list(tmp_path.iterdir()))}.mcap"
        return with_messages(source, path, topic, "sensor_msgs/Imu", inertial_messages(**messages))

    return record


def angles_deg(path, options=None):
    """How far the gravity of each frame is from the true one, and the notices."""
    options = options or SequenceOptions()
    frames = InertialSequence(SequenceReader(path, options), *read_inertial(path, options))
    found = []
    for frame in frames:
        true = world_from_camera(frame.time_ns).rotation.T @ [0, 0, 1]
        found.append(np.nan if frame.gravity is None else np.degrees(np.arccos(min(true @ frame.gravity.up, 1.0))))
    return np.array(found), frames.notices


def altered(*, force=None, orientation=None, drop=()):
    """A change of messages: of the force, of the orientation; those numbered are dropped."""

    def change(number, message):
        if orientation is None:
            without_orientation(number, message)
        else:
            message["orientation"] = orientation(message["orientation"])
        if force is not None:
            message["linear_acceleration"] = force(message["linear_acceleration"])
        return number not in drop

    return change


# --- gravity --------------------------------------------------------------------------------------------


def test_the_units_own_orientation_gives_gravity_about_the_cameras_axes(recorded):
    off, notices = angles_deg(recorded())
    assert off.max() < 0.5
    assert not notices


def test_without_orientation_force_and_turn_rate_give_it(recorded):
    off, notices = angles_deg(recorded(change=without_orientation))
    assert off.max() < 5.0  # the walk accelerates
    assert np.median(off) < 3.0
    assert not notices


def standing(seconds, hz, *, rng, force_std=0.3, turn=(0.0, 0.0, 0.0)):
    count = round(seconds * hz)
    times_ns = BEGIN_NS + (np.arange(count) * 1e9 / hz).astype(np.int64)
    up = Poses.exp(np.concatenate([np.zeros((count, 3)), -np.outer(np.arange(count) / hz, turn)], axis=1)).rotation
    force = GRAVITY * up[:, :, 2] + force_std * rng.standard_normal((count, 3))
    return InertialSamples(times_ns, force, np.tile(np.array(turn, float), (count, 1))), up[:, :, 2]


def gravity_after(samples):
    """Gravity at the last of some samples."""
    return gravity_along(samples)[-1]


def gravity_along(samples):
    """Gravity at each sample."""
    gravity = GravityFilter()
    gravity.extend(samples)
    return [gravity.at(time_ns) for time_ns in samples.times_ns.tolist()]


def test_noise_of_the_force_averages_out_and_the_stated_error_holds():
    off = []
    for seed in range(20):
        samples, up = standing(10.0, 100.0, rng=RNG(seed), force_std=0.5)
        found = gravity_after(samples)
        off.append(np.linalg.norm(found.up - up[-1]) / np.sqrt(2) / found.std_rad)
    assert np.sqrt(np.mean(np.square(off))) < 1.0
    assert found.std_rad < 0.08


def test_while_it_turns_the_direction_goes_along():
    samples, up = standing(5.0, 100.0, rng=RNG(0), force_std=0.0, turn=(0.7, -0.4, 0.2))
    found = np.array([each.up for each in gravity_along(samples)])
    assert np.degrees(np.arccos(np.clip(np.vecdot(found, up), -1, 1))).max() < 0.5


def test_samples_of_a_stream_give_the_gravity_of_a_whole_recording():
    samples, _ = standing(5.0, 100.0, rng=RNG(0), turn=(0.3, 0.1, 0.0))
    whole, stream = GravityFilter(), GravityFilter()
    whole.extend(samples)
    for begin in range(0, 500, 7):
        own = slice(begin, begin + 7)
        stream.extend(InertialSamples(samples.times_ns[own], samples.force[own], samples.turn_rate[own]))
        time_ns = int(samples.times_ns[own][-1])
        stream.forget_before(time_ns - 10**9)
        assert stream.at(time_ns) == whole.at(time_ns)
    assert stream.at(int(samples.times_ns[0])) is None  # forgotten
    assert stream.at(int(samples.times_ns[450])) == whole.at(int(samples.times_ns[450]))


def test_gravity_of_before_counts_less_the_longer_ago_it_is():
    samples, _ = standing(5.0, 100.0, rng=RNG(0))
    gravity = GravityFilter()
    gravity.extend(samples)
    last_ns = int(samples.times_ns[-1])
    now, later = gravity.at(last_ns), gravity.at(last_ns + 50_000_000)
    assert later.up == now.up
    assert later.std_rad > now.std_rad + 0.005
    assert gravity.at(last_ns + 110_000_000) is None


def test_while_the_frame_accelerates_the_stated_error_is_larger():
    samples, _ = standing(10.0, 100.0, rng=RNG(0), force_std=0.02)
    shaken = samples.force.copy()
    shaken[500:] += 1.5 * np.sin(np.arange(500) / 8.0)[:, None] * [1.0, 0.5, 0.7]
    calm, moved = gravity_after(samples), gravity_after(replace(samples, force=shaken))
    assert moved.std_rad > 1.3 * calm.std_rad
    assert np.degrees(np.arccos(moved.up @ np.array([0, 0, 1]))) < 3 * np.degrees(moved.std_rad)


def test_the_rate_of_the_samples_does_not_matter():
    stds = [gravity_after(standing(10.0, hz, rng=RNG(0), force_std=0.0)[0]).std_rad for hz in (20.0, 400.0)]
    assert stds[0] == pytest.approx(stds[1], rel=0.1)


def test_without_turn_rates_the_error_is_larger(recorded):
    samples, _ = standing(5.0, 100.0, rng=RNG(0), force_std=0.02)
    blind = gravity_after(replace(samples, turn_rate=np.full_like(samples.turn_rate, np.nan)))
    assert blind.std_rad > 2 * gravity_after(samples).std_rad


# --- bad input ------------------------------------------------------------------------------------------


def test_force_in_g_is_converted_with_a_notice(recorded):
    off, notices = angles_deg(recorded(change=altered(force=lambda force: force / GRAVITY)))
    assert off.max() < 5.0
    assert any("taken for one in g" in notice for notice in notices)


def test_force_without_gravity_is_not_used_and_said(recorded):
    off, notices = angles_deg(recorded(change=altered(force=lambda force: 0.01 * force)))
    assert np.isnan(off).all()
    assert any("expected about 9.81" in notice for notice in notices)
    assert any("12 of 12 images have no gravity" in notice for notice in notices)


def test_frames_in_a_gap_have_no_gravity_and_are_counted(recorded):
    off, notices = angles_deg(recorded(change=altered(drop=range(30, 95))))
    assert np.isnan(off[4:9]).all()
    assert np.isfinite(off[[0, 1, 10, 11]]).all()
    assert any("of 12 images have no gravity" in notice for notice in notices)


def message(number, *, force=(0.0, 0.0, GRAVITY), quat=(0.0, 0.0, 0.0, 0.0), tilt=-1.0):
    """A stamp and a message of a unit that lies still."""
    x, y, z, w = quat
    axes = [SimpleNamespace(x=fx, y=fy, z=fz) for fx, fy, fz in (force, (0.0, 0.0, 0.01))]
    return number * 10**7, SimpleNamespace(
        linear_acceleration=axes[0],
        angular_velocity=axes[1],
        orientation=SimpleNamespace(x=x, y=y, z=z, w=w),
        linear_acceleration_covariance=np.zeros(9),
        angular_velocity_covariance=np.zeros(9),
        orientation_covariance=np.diag([tilt, tilt, 1.0]).ravel(),
    )


def test_saturated_samples_are_left_out_and_counted():
    unit = InertialUnit(IMU, np.eye(3))
    for number in range(100):
        unit.take(*message(number, force=(19.6 if 40 <= number < 46 else 0.0, 0.0, GRAVITY)))
    samples = unit.samples()
    assert np.isnan(samples.force[40:46]).all()
    assert np.isfinite(samples.force[:40]).all()
    assert "6 samples saturated" in unit.notices[0]


def test_a_stream_of_messages_is_judged_as_it_comes_and_forgets():
    unit, found, largest = InertialUnit(IMU, np.eye(3)), [], 0
    for number in range(30_000):  # five minutes, the last of them in g
        unit.take(*message(number, force=(0.0, 0.0, GRAVITY if number < 24_000 else 1.0)))
        largest = max(largest, len(unit._raw))
        if number % 10 == 9:
            found.append(unit.samples())
    assert len(np.concatenate([each.times_ns for each in found])) == 30_000
    assert largest < 1100  # ten seconds
    lengths = np.concatenate([each.force[:, 2] for each in found])
    np.testing.assert_allclose(lengths[:24_000], GRAVITY)
    np.testing.assert_allclose(lengths[-5000:], GRAVITY, rtol=1e-4)
    assert "taken for one in g" in unit.notices[0]
    assert unit.samples() is None


def test_an_orientation_that_contradicts_the_force_is_not_used(recorded):
    def upside_down(quat):
        return (Poses.from_quat_xyzw(np.zeros(3), quat) @ Poses.exp(np.array([0, 0, 0, np.pi, 0, 0]))).as_quat_xyzw()

    off, notices = angles_deg(recorded(change=altered(orientation=upside_down)))
    assert off.max() < 5.0  # by the force
    assert any("its orientation is off the specific force by" in notice for notice in notices)


def test_an_orientation_that_is_always_the_identity_is_none(recorded):
    off, _ = angles_deg(recorded(change=altered(orientation=lambda _: np.array([0, 0, 0, 1.0]))))
    assert off.max() < 5.0


def test_a_recording_without_a_unit_or_with_none_wanted_is_read_as_before(recorded, tmp_path):
    plain = tmp_path / "plain.mcap"
    assert read_inertial(plain, SequenceOptions()) == (None, [])
    assert read_inertial(recorded(), SequenceOptions(imu_topic="")) == (None, [])
    frames = list(InertialSequence(SequenceReader(plain), None, []))
    assert len(frames) == 12
    assert all(frame.gravity is None for frame in frames)


def test_a_unit_that_tf_does_not_link_to_the_camera_is_not_used_and_an_error_where_named(recorded):
    path = recorded(frame="somewhere")
    samples, notices = read_inertial(path, SequenceOptions())
    assert samples is None
    assert notices == [
        f"{IMU} is not used: no transforms on /tf_static or /tf lead from 'somewhere' to 'camera_optical_frame'"
        " (/camera/image/compressed); record them, or name --camera-frame"
    ]
    with pytest.raises(SequenceError, match="no transform from 'somewhere'"):
        read_inertial(path, SequenceOptions(imu_topic=IMU))


def test_a_gyroscope_and_an_accelerometer_that_tf_does_not_link_are_named_in_one_sentence(recorded):
    path = recorded("/gyro", frame="gyro_frame", source=recorded("/accel", frame="accel_frame", hz=50.0))
    samples, notices = read_inertial(path, SequenceOptions())
    assert samples is None
    (said,) = notices
    assert said.startswith("/gyro and /accel are not used: ")
    assert "from 'gyro_frame' and 'accel_frame' to 'camera_optical_frame'" in said


def test_of_several_units_the_one_with_most_messages_is_used_and_named(recorded):
    path = recorded("/fast", source=recorded("/slow", hz=50.0))
    samples, notices = read_inertial(path, SequenceOptions())
    assert len(samples.times_ns) == 130
    assert notices[0].startswith("/fast is the inertial unit of 2")


def test_few_messages_are_none(recorded):
    samples, notices = read_inertial(recorded(seconds=0.05), SequenceOptions())
    assert samples is None
    assert "5 messages can be used, expected at least 10" in notices[0]


def test_messages_that_are_not_finite_are_left_out_and_counted(recorded):
    def break_some(number, message):
        if number in (3, 4):
            message["linear_acceleration"] = np.array([np.nan, 0, 0])

    samples, notices = read_inertial(recorded(change=break_some), SequenceOptions())
    assert len(samples.times_ns) == 128
    assert "unusable, or not later than those before: 2 messages of /imu/data" in notices[0]


# --- beside true poses ----------------------------------------------------------------------------------


def test_gravity_that_is_upside_down_beside_the_true_poses_is_said(recorded):
    _, notices = angles_deg(recorded(change=altered(force=lambda force: -force)))
    assert any("upside down beside the true poses" in notice for notice in notices)


def test_a_unit_with_other_axes_than_tf_states_is_said():
    rng, found = RNG(0), []
    for _ in range(50):
        pose = Poses.exp(np.append(np.zeros(3), rng.uniform(-0.7, 0.7, 3)))
        x, y, z = pose.rotation.T @ [0, 0, 1.0]
        found.append((pose, (y, z, x)))
    wrong = [(pose, Gravity(up, 0.02)) for pose, up in found]
    right = [(pose, Gravity((z, x, y), 0.02)) for pose, (x, y, z) in found]
    assert "the unit's mount in tf" in beside_true_poses(wrong)[0]
    assert not beside_true_poses(right)


def test_an_orientation_of_a_huge_variance_is_none():
    for tilt, is_one in ((1e6, False), (1e-4, True)):
        unit = InertialUnit("/imu", np.eye(3))
        for number in range(20):
            unit.take(*message(number, quat=(0.1, 0.0, 0.0, np.sqrt(0.99)), tilt=tilt))
        assert (unit.samples().up is not None) == is_one


def test_gravity_of_no_use_is_unknown():
    for std_rad, is_known in ((0.01, True), (0.6, False), (1000.0, False)):
        unknown, up = np.full((3, 3), np.nan), np.tile([0.0, 0, 1], (3, 1))
        samples = InertialSamples(np.arange(3) * 10**7, unknown, unknown, up, std_rad)
        assert (gravity_after(samples) is not None) == is_known
