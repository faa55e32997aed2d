"""Frames of a running system: in order, late, overtaken, and the motion between them."""

from functools import reduce
from pathlib import Path

import numpy as np
import pytest

from filtering.motion import Odometry
from sequences.reader import SequenceReader
from sequences.recordings.source import RawMessage
from tests.helpers.fake_transport import messages_of, offering
from tests.helpers.live_reading import Robot, at_ms, lived, require_same, stamp_of, tf_record
from tests.helpers.sequence_files import (
    BASE_FROM_CAMERA,
    BEGIN_NS,
    CAMERA,
    IMAGES,
    MS,
    ODOMETRY,
    Walk,
    close,
    world_from_camera,
)

OVERTAKEN, LATE = "a newer image was there", "time stamp not increasing"


def test_frames_are_those_of_the_recording_to_the_last_bit(long_walk: Path, long_raws: list[RawMessage]) -> None:
    robot = lived(long_raws)
    require_same([frame for _, frame in robot.frames], SequenceReader(long_walk))
    assert [n for n, _ in robot.frames] == [1] * 30
    assert robot.reader.camera == CAMERA
    assert close(robot.reader.base_from_camera, BASE_FROM_CAMERA)
    assert robot.reader.counts.as_json() == {"stated": 30, "read": 30, "used": 30, "skipped": {}}
    assert not robot.reader.skipped_messages


def test_an_image_waits_until_odometry_has_come_as_far(raws: list[RawMessage]) -> None:
    robot = Robot(offering(raws))
    robot.live_through([raw for raw in raws if at_ms(raw) < 500 or (raw.topic != ODOMETRY and at_ms(raw) <= 500)])
    assert robot.times_ms == [0, 100, 200, 300, 400]  # the image of 500 is there
    assert robot.reader.counts.used == 5
    assert robot.reader.counts.stated == 6
    robot.live_through([raw for raw in raws if raw.topic == ODOMETRY and 500 < at_ms(raw) < 510])
    assert robot.times_ms == [0, 100, 200, 300, 400, 500]


def test_of_several_images_that_are_due_the_newest_is_given_and_moves_from_the_last_frame(
    raws: list[RawMessage], walk_file: Path
) -> None:
    robot = Robot(offering(raws))
    robot.live_through([raw for raw in raws if at_ms(raw) < 250])
    robot.live_through([raw for raw in raws if 250 < at_ms(raw) < 650], ask=False)
    frame = robot.reader.newest_frame()
    assert robot.times_ms == [0, 100, 200]
    assert frame is not None
    assert frame.odometry is not None
    assert (frame.time_ns - BEGIN_NS) / MS == 600
    moved = world_from_camera(BEGIN_NS + 200 * MS).inverse() @ world_from_camera(frame.time_ns)
    assert close(frame.odometry.previous_from_current, moved, 1e-3)
    assert frame.odometry.duration_s == pytest.approx(0.4)
    np.testing.assert_array_equal(frame.image, list(SequenceReader(walk_file))[6].image)
    assert robot.reader.counts.skipped == {OVERTAKEN: 3}
    assert robot.reader.newest_frame() is None


def test_where_the_newest_image_cannot_be_used_the_one_before_it_is_given(tmp_path: Path) -> None:
    walk = Walk()
    walk.images[6] = (walk.images[6][0], b"no image")
    raws = messages_of(walk.write(tmp_path / "walk.mcap"))
    robot = Robot(offering(raws))
    robot.live_through([raw for raw in raws if at_ms(raw) < 250])
    robot.live_through([raw for raw in raws if 250 < at_ms(raw) < 650], ask=False)
    frame = robot.reader.newest_frame()
    assert frame is not None
    assert (frame.time_ns - BEGIN_NS) / MS == 500
    assert robot.reader.counts.skipped == {OVERTAKEN: 2, "undecodable image": 1}


def test_images_that_nobody_asks_for_do_not_pile_up(long_raws: list[RawMessage]) -> None:
    for with_odometry, reason in ((True, OVERTAKEN), (False, "odometry had not come yet")):
        robot = Robot(offering(long_raws))
        robot.live_through([raw for raw in long_raws if at_ms(raw) < 250])
        after = [raw for raw in long_raws if at_ms(raw) > 250 and (with_odometry or raw.topic != ODOMETRY)]
        robot.live_through(after, ask=False)
        assert robot.reader.counts.stated == 30
        assert robot.reader.counts.skipped == {reason: 27 - 16}


def test_images_out_of_order_and_images_twice_are_counted(raws: list[RawMessage], walk_file: Path) -> None:
    twice = [each for raw in raws for each in [raw] * (1 + (raw.topic == IMAGES))]
    robot = lived(twice)
    require_same([frame for _, frame in robot.frames], SequenceReader(walk_file))
    assert robot.reader.counts.stated == 24
    assert robot.reader.counts.skipped.total() == 12
    late = [raw for raw in raws if raw.topic == IMAGES and at_ms(raw) == 300]
    assert len(late) == 1
    others = [raw for raw in raws if raw not in late]
    robot = lived([raw for raw in others if at_ms(raw) < 550] + late + [raw for raw in others if at_ms(raw) > 550])
    assert 300 not in robot.times_ms
    assert len(robot.frames) == 11
    assert robot.reader.counts.as_json() == {"stated": 12, "read": 12, "used": 11, "skipped": {LATE: 1}}


@pytest.mark.parametrize("by_tf", [False, True])
def test_an_image_late_within_the_window_moves_from_the_frame_before_it_in_time(by_tf: bool, tmp_path: Path) -> None:
    path = tf_record(tmp_path / "tf.mcap") if by_tf else Walk().write(tmp_path / "walk.mcap")
    frames = {frame.time_ns: frame for frame in SequenceReader(path)}
    raws = messages_of(path)
    late = {at: next(raw for raw in raws if "Image" in raw.type and at_ms(raw) == at) for at in (300, 400, 500)}
    said = [raw for raw in raws if raw not in late.values()]
    robot = Robot(offering(raws), late_window_s=0.35)
    robot.live_through([raw for raw in said if at_ms(raw) < 650])
    robot.live_through([late[500], late[400], late[500]])
    robot.live_through([raw for raw in said if 650 < at_ms(raw) < 750])
    robot.live_through([late[300]])  # 0.4 s late
    robot.live_through([raw for raw in said if at_ms(raw) > 750])
    assert robot.times_ms == [0, 100, 200, 600, 500, 400, 700, 800, 900, 1000, 1100]
    assert robot.reader.counts.skipped == {LATE: 2}
    moved = {frame.time_ns: frame.odometry for _, frame in robot.frames}
    since_200 = [frames[BEGIN_NS + at * MS].odometry for at in (300, 400, 500)]
    expected = reduce(Odometry.then, [each for each in since_200 if each is not None])
    for at, odometry in ((500, expected), (700, frames[BEGIN_NS + 700 * MS].odometry)):
        found = moved[BEGIN_NS + at * MS]
        assert found is not None
        assert odometry is not None
        assert close(found.previous_from_current, odometry.previous_from_current, 1e-9)
        # On tf it is by the stated noise of motions between images.
        np.testing.assert_allclose(found.covariance, odometry.covariance, atol=1e-6 if by_tf else 1e-12)
        assert found.duration_s == pytest.approx(odometry.duration_s)


def test_images_that_were_overtaken_come_while_no_newer_one_is_there(long_raws: list[RawMessage]) -> None:
    robot = Robot(offering(long_raws), late_window_s=0.25)
    robot.live_through([raw for raw in long_raws if at_ms(raw) < 250])
    robot.live_through([raw for raw in long_raws if 250 < at_ms(raw) < 1050], ask=False)
    newest, older = robot.reader.newest_frame(), robot.reader.newest_frame()
    assert newest is not None
    assert older is not None
    assert [(frame.time_ns - BEGIN_NS) / MS for frame in (newest, older)] == [1000, 900]
    robot.live_through([raw for raw in long_raws if 1050 < at_ms(raw) < 1150])
    assert robot.times_ms == [0, 100, 200, 800, 1100]
    assert robot.reader.counts.skipped == {OVERTAKEN: 5}


def test_odometry_that_comes_twice_or_late_is_left_out(raws: list[RawMessage], walk_file: Path) -> None:
    odometry = [raw for raw in raws if raw.topic == ODOMETRY]
    said = [raw for raw in raws if raw.topic != ODOMETRY]
    for n, raw in enumerate(odometry):
        said += [raw, raw._replace(data=odometry[max(n - 12, 0)].data)]  # of as long before as the last image at least
    robot = lived(sorted(said, key=lambda raw: raw.log_time_ns))
    require_same([frame for _, frame in robot.frames], SequenceReader(walk_file))
    skipped = robot.reader.skipped_messages
    assert set(skipped) == {"poses of odometry: time stamp not increasing"}
    assert skipped.total() >= len(odometry) - 12


def test_times_of_arrival_are_known_by_stamp(raws: list[RawMessage]) -> None:
    arriving = [raw._replace(log_time_ns=raw.log_time_ns + 40 * MS) for raw in raws]
    robot = lived(arriving)
    for _, frame in robot.frames:
        assert robot.reader.arrived_ns(frame.time_ns) == frame.time_ns + 40 * MS
    assert robot.reader.arrived_ns(BEGIN_NS + 1) is None


def test_take_says_whether_odometry_is_there_that_is_later(raws: list[RawMessage]) -> None:
    robot = Robot(offering(raws))
    robot.live_through([raw for raw in raws if at_ms(raw) < 550])
    for raw in [raw for raw in raws if at_ms(raw) > 550]:
        before = robot.reader.odometry_ns
        assert robot.reader.take(raw) == (raw.topic == ODOMETRY)
        assert not robot.reader.take(raw)
        assert robot.reader.odometry_ns == (stamp_of(raw) if raw.topic == ODOMETRY else before)


def test_between_images_odometry_says_how_the_camera_moved_since_the_last_one(raws: list[RawMessage]) -> None:
    robot = Robot(offering(raws))
    assert robot.opened is None
    robot.live_through([raw for raw in raws if at_ms(raw) < 450])
    reader = robot.reader
    assert reader.frame_ns == BEGIN_NS + 400 * MS
    time_ns = reader.odometry_ns
    assert time_ns is not None
    for until_ns in (time_ns, time_ns - 10 * MS):
        moved = reader.moved_until(until_ns)
        assert moved is not None
        expected = world_from_camera(reader.frame_ns).inverse() @ world_from_camera(until_ns)
        assert close(moved.previous_from_current, expected, 1e-3)
    assert reader.moved_until(time_ns + 1) is None
    assert reader.moved_until(reader.frame_ns) is None
    assert reader.frame_ns == BEGIN_NS + 400 * MS
    reader.settle(time_ns)
    assert reader.frame_ns == time_ns
    robot.live_through([raw for raw in raws if 450 < at_ms(raw) < 550])
    frame = robot.frames[-1][1]
    assert frame.odometry is not None
    expected = world_from_camera(time_ns).inverse() @ world_from_camera(frame.time_ns)
    assert close(frame.odometry.previous_from_current, expected, 1e-3)


@pytest.mark.parametrize(("pause_ms", "is_whole"), [(440, True), (640, False)])
def test_across_a_pause_of_half_a_second_the_motion_is_not_known(
    pause_ms: int, is_whole: bool, long_raws: list[RawMessage]
) -> None:
    said = [raw for raw in long_raws if raw.topic != ODOMETRY or not 1010 < at_ms(raw) < 1010 + pause_ms]
    robot = lived(said)
    assert robot.times_ms[:11] == [100 * n for n in range(11)]
    after = next(frame for _, frame in robot.frames if frame.time_ns > BEGIN_NS + 1000 * MS)
    assert (after.odometry is not None) == is_whole
    rest = [frame for _, frame in robot.frames if frame.time_ns > after.time_ns]
    assert len(rest) >= 12
    assert all(frame.odometry is not None for frame in rest)
    assert robot.reader.readings == 1
    assert robot.reader.counts.skipped == ({OVERTAKEN: 3} if is_whole else {"in a gap of odometry over 0.5 s": 6})
