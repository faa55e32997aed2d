"""Clocks of a running system that are set, and stamps that are odd."""

import struct
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from sequences.options import ReadingOptions
from sequences.reader import SequenceReader
from sequences.recordings.source import TF, TF_STATIC, RawMessage
from tests.helpers.fake_transport import messages_of
from tests.helpers.live_reading import SECOND, at_ms, lived, require_same, stamp_of, stamped, tf_record
from tests.helpers.sequence_files import BEGIN_NS, IMAGES, MS, ODOMETRY, close, world_from_camera

ODD = "time stamp unlike those before"


@pytest.mark.parametrize("by_s", [-5, 5, -3600, 3600])
def test_a_clock_that_is_set_begins_a_new_reading_and_images_go_on(by_s: int, long_raws: list[RawMessage]) -> None:
    moment_ms, by_ns = 1505, by_s * SECOND
    said = [
        stamped(raw, stamp_of(raw) + by_ns) if raw.topic != TF_STATIC and at_ms(raw) > moment_ms else raw
        for raw in long_raws
    ]
    robot = lived(said)
    before = [frame for n, frame in robot.frames if n == 1]
    after = [frame for n, frame in robot.frames if n == robot.reader.readings]
    assert robot.reader.readings > 1
    assert len(before) + len(after) == len(robot.frames)
    assert [frame.time_ns for frame in before] == [BEGIN_NS + 100 * n * MS for n in range(len(before))]
    assert len(before) >= 15
    assert after[0].odometry is None
    assert after[0].time_ns <= BEGIN_NS + 2200 * MS + by_ns
    for last, frame in pairwise(after):
        assert frame.time_ns - last.time_ns == 100 * MS
        assert frame.odometry is not None
        moved = world_from_camera(last.time_ns - by_ns).inverse() @ world_from_camera(frame.time_ns - by_ns)
        assert close(frame.odometry.previous_from_current, moved, 1e-3)
    assert after[-1].time_ns == BEGIN_NS + 2900 * MS + by_ns
    assert robot.reader.counts.stated == 30
    assert robot.reader.counts.are_complete


@pytest.mark.parametrize("by_s", [-5, 5, 3600])
def test_single_odd_stamps_are_left_out_and_the_reading_goes_on(
    by_s: int, long_raws: list[RawMessage], long_walk: Path
) -> None:
    def said(raw: RawMessage) -> RawMessage:
        is_odd = raw.topic in (IMAGES, ODOMETRY) and at_ms(raw) % 500 in (0, 407)
        return stamped(raw, stamp_of(raw) + by_s * SECOND) if is_odd and at_ms(raw) > 300 else raw

    robot = lived([said(raw) for raw in long_raws])
    assert robot.reader.readings == 1
    assert robot.reader.counts.skipped == {ODD: 5}
    assert robot.reader.skipped_messages == {f"{ODD} on {ODOMETRY}": 6}
    assert len(robot.frames) == 25
    assert all(frame.odometry is not None for _, frame in robot.frames[1:])
    expected = {frame.time_ns: frame for frame in SequenceReader(long_walk)}
    for _, frame in robot.frames:
        np.testing.assert_array_equal(frame.image, expected[frame.time_ns].image)


def test_messages_that_were_held_up_for_seconds_make_the_same_frames(
    long_raws: list[RawMessage], long_walk: Path
) -> None:
    late = [raw for raw in long_raws if 500 < at_ms(raw) < 2500]
    arriving = [raw._replace(log_time_ns=BEGIN_NS + 2500 * MS) if raw in late else raw for raw in long_raws]
    robot = lived(sorted(arriving, key=lambda raw: raw.log_time_ns))
    require_same([frame for _, frame in robot.frames], SequenceReader(long_walk))
    assert robot.reader.readings == 1


def test_stamps_of_no_use_are_replaced_by_times_of_arrival(walk_file: Path, raws: list[RawMessage]) -> None:
    """As --stamps log asks it to."""
    said = [raw if raw.topic == TF_STATIC else stamped(raw, 7 * SECOND) for raw in raws]
    robot = lived(said, ReadingOptions(stamps="log"))
    require_same([frame for _, frame in robot.frames], SequenceReader(walk_file))
    robot = lived(said)
    assert len(robot.frames) <= 1


def test_a_clock_of_tf_that_is_set_begins_a_new_reading(tmp_path: Path) -> None:
    raws = messages_of(tf_record(tmp_path / "tf.mcap", num_images=20))
    by_ns = -5 * SECOND

    def said(raw: RawMessage) -> RawMessage:
        if raw.topic == TF_STATIC or at_ms(raw) < 1005:
            return raw
        offset = 4 if raw.topic == TF else 0  # behind the number of transforms
        data = raw.data
        sec, nanosec = struct.unpack_from("<iI", data, 4 + offset)
        stamp = struct.pack("<iI", *divmod(sec * SECOND + nanosec + by_ns, SECOND))
        return raw._replace(data=data[: 4 + offset] + stamp + data[12 + offset :])

    robot = lived([said(raw) for raw in raws])
    assert robot.reader.readings > 1
    after = [frame for n, frame in robot.frames if n == robot.reader.readings]
    assert after[0].odometry is None
    assert len(after) >= 5
    for last, frame in pairwise(after):
        assert frame.odometry is not None
        moved = world_from_camera(last.time_ns - by_ns).inverse() @ world_from_camera(frame.time_ns - by_ns)
        assert close(frame.odometry.previous_from_current, moved, 1e-3)
