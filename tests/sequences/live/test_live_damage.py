"""Damaged messages of a running system, and the count of all images."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sequences.frame import Frame
from sequences.reader import SequenceReader
from sequences.recordings.message_definitions import encoder
from sequences.recordings.source import TF, TF_STATIC, RawMessage
from tests.helpers.checks import no_checks
from tests.helpers.fake_transport import messages_of, offering
from tests.helpers.live_reading import SECOND, Robot, at_ms, lived, require_same, stamp_of, stamped, tf_record
from tests.helpers.sequence_files import BEGIN_NS, IMAGES, MS, ODOMETRY

INFO = "/camera/camera_info"


def damaged(data: bytes) -> Iterator[bytes]:
    """The bytes of a message as nobody should send them."""
    yield from (data[:end] for end in (0, 1, 3, 4, 11, 13, len(data) // 2, len(data) - 9))
    yield data[:12] + b"\xff" * (len(data) - 12)
    yield data[:4] + b"\xff" * (len(data) - 4)
    yield np.random.default_rng(0).bytes(len(data))


def with_damage(raws: list[RawMessage], topic: str) -> tuple[list[RawMessage], int]:
    """Messages, and after those of a topic the same with damage; and how many of these there are."""
    said, number = [], 0
    for raw in raws:
        said.append(raw)
        if raw.topic == topic and at_ms(raw) > 350:
            bad = [raw._replace(data=data) for data in damaged(raw.data)]
            said += bad
            number += len(bad)
    return said, number


def test_damaged_images_are_counted_and_the_others_used(raws: list[RawMessage], walk_file: Path) -> None:
    said, number = with_damage(raws, IMAGES)
    robot = lived(said)
    require_same([frame for _, frame in robot.frames], SequenceReader(walk_file))
    counts = robot.reader.counts
    assert (number, counts.stated, counts.used) == (8 * 11, 12 + number, 12)
    assert counts.skipped.total() == number
    assert counts.skipped["undecodable image"] >= 8 * 8
    assert robot.reader.problems
    assert not robot.reader.skipped_messages
    assert robot.reader.readings == 1


@pytest.mark.parametrize("topic", [ODOMETRY, TF_STATIC])
def test_damaged_messages_are_counted_and_frames_stay_what_they_are(
    topic: str, raws: list[RawMessage], walk_file: Path
) -> None:
    (static,) = (raw for raw in raws if raw.topic == TF_STATIC)
    again = static._replace(log_time_ns=BEGIN_NS + 400 * MS)
    said, number = with_damage([*raws[:40], again, *raws[40:]], topic)
    assert number >= 11
    robot = lived(said)
    require_same([frame for _, frame in robot.frames], SequenceReader(walk_file))
    assert robot.reader.skipped_messages.total() == number
    assert robot.reader.counts.as_json() == {"stated": 12, "read": 12, "used": 12, "skipped": {}}


def test_damaged_messages_of_tf_are_counted_where_odometry_is_told_there(tmp_path: Path) -> None:
    path = tf_record(tmp_path / "tf.mcap")
    said, number = with_damage(messages_of(path), TF)
    robot = lived(said)
    require_same([frame for _, frame in robot.frames], SequenceReader(path))
    assert number > 400
    assert robot.reader.skipped_messages.total() == number


def test_before_everything_is_there_damaged_images_odometry_and_intrinsics_are_passed_over(
    raws: list[RawMessage], walk_file: Path
) -> None:
    for topic in (IMAGES, ODOMETRY, INFO):
        first = next(raw for raw in raws if raw.topic == topic)
        bad = [first._replace(data=first.data[:end]) for end in (0, 3, 11, len(first.data) // 2)]
        robot = lived([*bad, *raws])
        require_same([frame for _, frame in robot.frames], SequenceReader(walk_file))


def test_poses_that_are_none_are_counted(raws: list[RawMessage], walk_file: Path) -> None:
    first = next(raw for raw in raws if raw.topic == ODOMETRY and at_ms(raw) > 350)
    pose = {"position": {"x": float("nan")}, "orientation": {"w": 1.0}}
    header = {"stamp": dict(zip(("sec", "nanosec"), divmod(first.log_time_ns + 1, SECOND), strict=True))}
    fields = {"header": {**header, "frame_id": "odom"}, "child_frame_id": "base_link", "pose": {"pose": pose}}
    bad = first._replace(data=encoder("nav_msgs/Odometry")(fields))
    robot = lived([each for raw in raws for each in ([raw, bad] if raw is first else [raw])])
    require_same([frame for _, frame in robot.frames], SequenceReader(walk_file))
    assert robot.reader.skipped_messages == {"unusable poses of odometry": 1}
    assert any("not finite" in said for said in robot.reader.problems.values())


@settings(max_examples=25)
@given(seed=st.integers(0, 2**32 - 1))
def test_every_image_is_used_skipped_or_waits_whatever_happens(long_raws: list[RawMessage], seed: int) -> None:
    rng = np.random.default_rng(seed)
    asks, damage, twice, lost = rng.uniform(0.0, [1.0, 0.3, 0.3, 0.3])
    steps_ms = rng.uniform(0.0, 2500.0, 2)
    by_ns = (rng.uniform(-10.0, 10.0, 2) * SECOND).astype(int).tolist()
    said: list[RawMessage] = []
    for raw in long_raws:
        if raw.topic == TF_STATIC or at_ms(raw) < 200:
            said.append(raw)
            continue
        if rng.random() < lost:
            continue
        shift = sum(by for at, by in zip(steps_ms, by_ns, strict=True) if at_ms(raw) > at)
        raw = stamped(raw, stamp_of(raw) + shift + int(rng.integers(2) * rng.integers(-150, 150) * MS))
        if rng.random() < damage:
            raw = raw._replace(data=raw.data[: rng.integers(len(raw.data))])
        said += [raw] * (1 + int(rng.random() < twice))
    with no_checks():
        robot = Robot(offering(said), late_window_s=float(rng.choice([0.0, 0.2])))
        begin = next(n for n, raw in enumerate(said) if at_ms(raw) >= 200)
        robot.live_through(said[:begin])
        images = sum(raw.topic == IMAGES for raw in said[:begin])
        for raw in said[begin:]:
            images += raw.topic == IMAGES
            robot.live_through([raw], ask=bool(rng.random() < asks))
            counts = robot.reader.counts
            assert counts.stated == counts.read
            assert 0 <= images - counts.stated <= 2  # odd ones, of which it is not known what to make
            assert 0 <= counts.stated - counts.used - counts.skipped.total() <= 16
            assert counts.used == len(robot.frames)
            if robot.reader.readings > 1:
                assert all(frame.odometry is None for frame in _firsts(robot.frames))


def _firsts(frames: list[tuple[int, Frame]]) -> list[Frame]:
    """The first frame of every reading."""
    return [frame for n, (reading, frame) in enumerate(frames) if n == 0 or frames[n - 1][0] != reading]
