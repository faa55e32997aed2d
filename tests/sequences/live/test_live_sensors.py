"""An inertial unit and a barometer of a running system: what they say of frames as their samples come."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from filtering.se3 import Poses
from sequences.errors import SequenceError
from sequences.inertial.sequence import InertialSequence
from sequences.inertial.topics import read_inertial
from sequences.live.frames import LiveFrames
from sequences.options import ReadingOptions, SequenceOptions
from sequences.reader import SequenceReader
from sequences.recordings.message_definitions import encoder
from sequences.recordings.source import TF_STATIC, RawMessage
from tests.helpers import tf_files
from tests.helpers.fake_transport import messages_of, offering
from tests.helpers.inertial_files import GRAVITY, IMU, inertial_messages, with_messages, without_orientation
from tests.helpers.live_reading import SECOND, Robot, at_ms, stamp_of, stamped
from tests.helpers.sequence_files import BEGIN_NS, MS, ODOMETRY, Walk, world_from_camera


@pytest.fixture(scope="module")
def walk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three seconds, with a unit that states no orientation."""
    folder = tmp_path_factory.mktemp("walk")
    messages = inertial_messages(seconds=3.1, change=without_orientation)
    return with_messages(Walk(30).write(folder / "plain.mcap"), folder / "imu.mcap", IMU, "sensor_msgs/Imu", messages)


@pytest.fixture(scope="module")
def said(walk: Path) -> list[RawMessage]:
    return messages_of(walk)


def sensing(raws: list[RawMessage], options: ReadingOptions | None = None, **settings: float) -> Robot:
    """A system that has said all of the messages, whose frames have what sensors say."""
    robot = Robot(offering(raws), options, made=LiveFrames, **settings)
    robot.live_through(raws[:40])
    if robot.opened is not None:
        robot.reader.sensors.look_again(changed=False)  # as the session does, now and then
    robot.live_through(raws[40:])
    return robot


def late(raws: list[RawMessage], by_ms: int) -> list[RawMessage]:
    """The same messages, of which those of the unit come late."""
    moved = [raw._replace(log_time_ns=raw.log_time_ns + by_ms * MS * (raw.topic == IMU)) for raw in raws]
    return sorted(moved, key=lambda raw: raw.log_time_ns)


def off_deg(frame) -> float:
    true = world_from_camera(frame.time_ns).rotation.T @ [0, 0, 1]
    return float(np.degrees(np.arccos(min(true @ frame.gravity.up, 1.0))))


def test_gravity_and_odometry_are_those_of_the_recording(walk: Path, said: list[RawMessage]) -> None:
    expected = list(InertialSequence(SequenceReader(walk), *read_inertial(walk, SequenceOptions())))
    frames = [frame for _, frame in sensing(said).frames]
    assert [frame.time_ns for frame in frames] == [frame.time_ns for frame in expected]
    plain = {frame.time_ns: frame.odometry for frame in SequenceReader(walk)}
    for frame, other in zip(frames[1:], expected[1:], strict=True):
        assert frame.gravity is not None
        assert other.gravity is not None
        np.testing.assert_allclose(frame.gravity.up, other.gravity.up, atol=3e-3)
        assert frame.gravity.std_rad == pytest.approx(other.gravity.std_rad, rel=0.2)  # by the force so far
        assert frame.odometry is not None
        assert other.odometry is not None
        moved, same = frame.odometry.previous_from_current, other.odometry.previous_from_current
        np.testing.assert_allclose(moved.as_matrix(), same.as_matrix(), atol=1e-5)
        np.testing.assert_allclose(frame.odometry.covariance, other.odometry.covariance, rtol=1e-2, atol=1e-9)
        of_wheels = plain[frame.time_ns]
        assert of_wheels is not None
        assert not np.array_equal(frame.odometry.covariance, of_wheels.covariance)


def test_samples_that_come_late_delay_no_image_and_count_less(said: list[RawMessage]) -> None:
    now, soon, never = (sensing(late(said, by_ms)) for by_ms in (0, 60, 200))
    assert now.times_ms == soon.times_ms == never.times_ms
    assert all(frame.gravity is None for _, frame in never.frames)
    for (_, frame), (_, other) in zip(now.frames[5:], soon.frames[5:], strict=True):
        assert frame.gravity is not None
        assert other.gravity is not None
        assert other.gravity.std_rad > frame.gravity.std_rad
        assert off_deg(other) < 3 * np.degrees(other.gravity.std_rad)


def test_an_image_moves_by_the_turns_so_far_with_an_error_of_what_is_missing(said: list[RawMessage]) -> None:
    stated = []
    for by_ms in (0, 30, 150):
        frames = [frame for _, frame in sensing(late(said, by_ms)).frames[5:]]
        known = [frame.odometry for frame in frames if frame.odometry is not None]
        assert len(known) == 25
        stated.append(np.median([np.sqrt(each.covariance[5, 5]) for each in known]))
    assert stated[0] < stated[1] < stated[2]


def test_a_late_image_is_corrected_as_well_and_teaches_nothing_twice(said: list[RawMessage]) -> None:
    image = next(raw for raw in said if "Image" in raw.type and at_ms(raw) == 2000)
    others = [raw for raw in said if raw is not image]
    robot = Robot(offering(said), made=LiveFrames, late_window_s=0.35)
    robot.live_through([raw for raw in others if at_ms(raw) < 2250])
    learned = robot.reader.sensors.motion.gyroscope.num_motions
    robot.live_through([image])
    assert robot.times_ms[-1] == 2000
    frame = robot.frames[-1][1]
    assert frame.gravity is not None
    assert off_deg(frame) < 5.0
    assert frame.odometry is not None
    assert np.sqrt(frame.odometry.covariance[5, 5]) < 0.02
    assert robot.reader.sensors.motion.gyroscope.num_motions == learned


def test_across_a_pause_of_odometry_the_turn_is_known_and_the_way_is_not(said: list[RawMessage]) -> None:
    robot = sensing([raw for raw in said if raw.topic != ODOMETRY or not 1010 < at_ms(raw) < 1650])
    before, after = next(
        (one, other)
        for (_, one), (_, other) in pairwise(robot.frames)
        if other.odometry is not None and not other.odometry.knows_translation
    )
    assert after.odometry is not None
    assert after.time_ns - before.time_ns >= 600 * MS
    turned = world_from_camera(before.time_ns).between(world_from_camera(after.time_ns)).log()[3:]
    error = after.odometry.previous_from_current.between(Poses.exp(np.append(np.zeros(3), turned))).log()[3:]
    assert np.linalg.norm(turned) > 0.05
    assert np.linalg.norm(error) < 0.01
    assert (np.abs(error) < 3 * np.sqrt(np.diag(after.odometry.covariance)[3:])).all()
    rest = [frame.odometry for _, frame in robot.frames if frame.time_ns > after.time_ns]
    assert all(odometry is not None and odometry.knows_translation for odometry in rest)


@pytest.mark.parametrize("by_s", [-5, 5])
def test_a_units_clock_that_is_set_begins_the_unit_anew_and_nothing_else(by_s: int, said: list[RawMessage]) -> None:
    def set_at_1_s(raw: RawMessage) -> RawMessage:
        return stamped(raw, stamp_of(raw) + by_s * SECOND) if raw.topic == IMU and at_ms(raw) > 1000 else raw

    def and_back(raw: RawMessage) -> RawMessage:
        return set_at_1_s(raw) if at_ms(raw) < 2000 else raw

    robot = sensing([and_back(raw) for raw in said])
    assert robot.reader.readings == 1
    assert robot.times_ms == [100 * n for n in range(30)]
    without = [frame.gravity is None for _, frame in robot.frames]
    assert all(without[12:20])
    assert not any([*without[1:10], *without[23:]])


@pytest.mark.parametrize("by_s", [-5, 0, 40])
def test_a_unit_by_another_clock_than_the_images_is_told(by_s: int, said: list[RawMessage]) -> None:
    robot = sensing([stamped(raw, stamp_of(raw) + by_s * SECOND) if raw.topic == IMU else raw for raw in said])
    for _ in range(2):  # more frames than in this walk
        for _, frame in robot.frames:
            robot.reader.sensors.seen(frame, None)
    told = [notice for notice in robot.reader.sensors.notices if "stamps" in notice]
    assert len(told) == (by_s != 0)
    assert all(f"{IMU}: its stamps are {by_s:+d}." in notice or "-4.9 s" in notice for notice in told)
    robot.reader.sensors._came_s[IMU] -= 100.0
    silent = robot.reader.sensors.notices
    assert any("no message on" in notice for notice in silent)
    assert not any("stamps" in notice for notice in silent)


def test_a_clock_of_all_that_is_set_leaves_the_bias(said: list[RawMessage]) -> None:
    shifted = [
        stamped(raw, stamp_of(raw) - 5 * SECOND) if "tf" not in raw.topic and at_ms(raw) > 1000 else raw for raw in said
    ]
    robot = sensing(shifted)
    assert robot.reader.readings > 1
    after = [frame for number, frame in robot.frames if number == robot.reader.readings]
    assert all(frame.gravity is not None for frame in after[4:])
    assert robot.reader.sensors.motion.gyroscope.num_motions > 20


def test_a_unit_that_comes_later_or_leaves_and_comes_back_is_used(said: list[RawMessage]) -> None:
    robot = Robot(offering([raw for raw in said if raw.topic != IMU]), made=LiveFrames)
    robot.live_through([raw for raw in said if at_ms(raw) < 550])
    robot.transport.offer(IMU, "sensor_msgs/Imu")
    for until in (750, 800):  # as the session does, now and then
        robot.reader.sensors.look_again(changed=robot.heard.refresh())
        robot.live_through([raw for raw in said if 550 < at_ms(raw) < until and at_ms(raw) > until - 200])
    assert robot.reader.sensors.names == [IMU]
    robot.live_through([raw for raw in said if 800 < at_ms(raw) < 1500])
    robot.live_through([raw for raw in said if 1500 < at_ms(raw) < 2200 and raw.topic != IMU])
    robot.live_through([raw for raw in said if at_ms(raw) > 2200])
    known = {at: frame.gravity is not None for at, (_, frame) in zip(robot.times_ms, robot.frames, strict=True)}
    assert not any(known[at] for at in (0, 300, 500, 1700, 2000, 2100))
    assert all(known[at] for at in (1000, 1200, 1400, 2500, 2900))


@pytest.mark.parametrize("late", [IMU, TF_STATIC])
def test_a_unit_that_speaks_late_or_is_linked_late_is_used_from_then_on(late: str, tmp_path: Path) -> None:
    messages = inertial_messages(seconds=3.1, frame="imu_link")
    path = with_messages(
        Walk(30).write(tmp_path / "plain.mcap"), tmp_path / "imu.mcap", IMU, "sensor_msgs/Imu", messages
    )
    said = messages_of(path)
    (event,) = tf_files.mounted("base_link", "imu_link")
    link = RawMessage(TF_STATIC, BEGIN_NS, encoder(event.type)(event.message), event.type, "cdr", b"")
    robot = Robot(offering(said), made=LiveFrames)
    robot.live_through([raw for raw in said if (at_ms(raw) < 500 and raw.topic != late) or raw.topic == TF_STATIC])
    robot.live_through([link] if late == IMU else [])
    for _ in range(6):  # half a minute
        robot.reader.sensors.look_again(changed=robot.heard.refresh())
    assert robot.reader.sensors.names == []
    robot.live_through([link] if late == TF_STATIC else [raw for raw in said if 500 < at_ms(raw) < 600])
    robot.reader.sensors.look_again(changed=robot.heard.refresh())
    assert robot.reader.sensors.names == [IMU]


def test_units_are_chosen_as_of_a_recording(walk: Path, tmp_path: Path) -> None:
    slow = inertial_messages(seconds=3.1, hz=25.0)
    elsewhere = inertial_messages(seconds=3.1, hz=400.0, frame="somewhere")
    both = with_messages(walk, tmp_path / "slow.mcap", "/a_slow_one", "sensor_msgs/Imu", slow)
    three = with_messages(both, tmp_path / "three.mcap", "/elsewhere", "sensor_msgs/Imu", elsewhere)
    robot = sensing(messages_of(three))
    assert robot.reader.sensors.names == [IMU]
    assert any("/imu/data is the inertial unit of 3" in notice for notice in robot.reader.sensors.notices)
    named = sensing(messages_of(three), ReadingOptions(imu_topic="/a_slow_one"))
    assert named.reader.sensors.names == ["/a_slow_one"]
    without = sensing(messages_of(three), ReadingOptions(imu_topic=""))
    assert without.reader.sensors.names == []
    assert not {offer.topic for offer in without.transport.subscribed} & {IMU, "/a_slow_one", "/elsewhere"}
    assert all(frame.gravity is None for _, frame in without.frames)


def test_a_unit_that_is_named_is_waited_for_and_an_error_where_it_is_none(said: list[RawMessage]) -> None:
    robot = sensing([raw for raw in said if raw.topic != IMU], ReadingOptions(imu_topic=IMU))
    assert robot.opened is None
    assert "no topic '/imu/data' (--imu-topic)" in robot.wanting[-1] or "/imu/data" in robot.wanting[-1]
    with pytest.raises(SequenceError, match="expected sensor_msgs/Imu"):
        sensing(said, ReadingOptions(imu_topic=ODOMETRY))


def test_units_in_g_are_converted_with_a_notice(walk: Path, tmp_path: Path) -> None:
    def in_g(number, message):
        without_orientation(number, message)
        message["linear_acceleration"] = message["linear_acceleration"] / GRAVITY

    messages = inertial_messages(seconds=3.1, change=in_g)
    path = with_messages(Walk(30).write(tmp_path / "plain.mcap"), tmp_path / "g.mcap", IMU, "sensor_msgs/Imu", messages)
    robot = sensing(messages_of(path))
    assert max(off_deg(frame) for _, frame in robot.frames[1:]) < 5.0
    assert any("taken for one in g" in notice for notice in robot.reader.sensors.notices)


def test_what_is_remembered_is_bounded(walk: Path, said: list[RawMessage]) -> None:
    robot = sensing(said)
    sensors, first = robot.reader.sensors, next(raw for raw in said if raw.topic == IMU)
    for number in range(10_000):  # 100 s, without an image
        time_ns = BEGIN_NS + 4 * SECOND + 10 * MS * number
        sensors.take(stamped(first, time_ns)._replace(log_time_ns=time_ns))
    assert len(sensors.motion.gyroscope._rates) < 3600
    assert len(sensors.motion._gravity._found) < 3600
    assert sensors.unit is not None
    assert len(sensors.unit._raw) < 1600
