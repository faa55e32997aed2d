"""Frames of a running system, message by message."""

import queue
import struct
from collections.abc import Iterable, Iterator
from functools import reduce
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from filtering.motion import Odometry
from sequences.errors import NotFoundError, SequenceError
from sequences.frame import Frame
from sequences.live.reader import LiveReader
from sequences.live.topic_buffer import TopicBuffer
from sequences.options import ReadingOptions, SequenceOptions
from sequences.reader import SequenceReader
from sequences.recordings.message_definitions import encoder
from sequences.recordings.source import TF, TF_STATIC, RawMessage
from tests.helpers import tf_files
from tests.helpers.checks import no_checks
from tests.helpers.fake_transport import FakeTransport, messages_of, offering
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

INFO = "/camera/camera_info"
SECOND = 10**9
OVERTAKEN, LATE = "a newer image was there", "time stamp not increasing"
ODD = "time stamp unlike those before"


class Robot:
    """A running system, and who reads it: opens it as soon as everything is there, and asks for the frames."""

    def __init__(
        self, transport: FakeTransport, options: ReadingOptions | None = None, *, late_window_s: float = 0.0
    ) -> None:
        self.transport, self.options, self.late_window_s = transport, options or ReadingOptions(), late_window_s
        self.events: queue.SimpleQueue[RawMessage] = queue.SimpleQueue()
        self.heard = TopicBuffer(transport, self.events, options=self.options)
        self.opened: LiveReader | None = None
        self.frames: list[tuple[int, Frame]] = []  # with the number of the reading
        self.wanting: list[str] = []  # what was not there yet

    @property
    def reader(self) -> LiveReader:
        assert self.opened is not None, self.wanting
        return self.opened

    def try_to_open(self) -> None:
        self.heard.refresh()
        if self.opened is not None:
            return
        try:
            self.opened = LiveReader(self.heard, self.options, late_window_s=self.late_window_s)
        except NotFoundError as error:
            self.wanting.append(str(error))
            return
        for raw in self.heard.kept():
            self._take(raw, ask=True)

    def live_through(self, raws: Iterable[RawMessage], *, ask: bool = True) -> None:
        """Have messages said, one by one; frames are asked for after each, or not at all."""
        for raw in raws:
            self.try_to_open()
            self.transport.say(raw)
            while not self.events.empty():
                heard = self.events.get()
                if self.opened is None:
                    self.heard.keep(heard)
                else:
                    self._take(heard, ask=ask)
        self.try_to_open()

    def _take(self, raw: RawMessage, *, ask: bool) -> None:
        self.reader.take(raw)
        frame = self.reader.newest_frame() if ask else None
        if frame is not None:
            self.frames.append((self.reader.readings, frame))

    @property
    def times_ms(self) -> list[float]:
        """Stamps of the frames, after the first image of a walk."""
        return [(frame.time_ns - BEGIN_NS) / MS for _, frame in self.frames]


def lived(raws: list[RawMessage], options: ReadingOptions | None = None) -> Robot:
    """A system that has said all of the messages."""
    robot = Robot(offering(raws), options)
    robot.live_through(raws)
    return robot


def stamp_of(raw: RawMessage) -> int:
    sec, nanosec = struct.unpack_from("<iI", raw.data, 4)
    return sec * SECOND + nanosec


def stamped(raw: RawMessage, time_ns: int) -> RawMessage:
    """A message whose header has another stamp; it arrives when it did."""
    return raw._replace(data=raw.data[:4] + struct.pack("<iI", *divmod(time_ns, SECOND)) + raw.data[12:])


def at_ms(raw: RawMessage) -> float:
    """When a message arrives, after the first image of a walk."""
    return (raw.log_time_ns - BEGIN_NS) / MS


def require_same(frames: Iterable[Frame], expected: Iterable[Frame]) -> None:
    """Fail where frames differ in anything but the true poses, which a running system does not have."""
    for frame, other in zip(frames, expected, strict=True):
        assert frame.time_ns == other.time_ns
        assert frame.camera == other.camera
        np.testing.assert_array_equal(frame.image, other.image)
        assert (frame.odometry is None) == (other.odometry is None)
        if frame.odometry is not None and other.odometry is not None:
            moved, expected_moved = frame.odometry.previous_from_current, other.odometry.previous_from_current
            np.testing.assert_array_equal(moved.as_matrix(), expected_moved.as_matrix())
            np.testing.assert_array_equal(frame.odometry.covariance, other.odometry.covariance)
            assert frame.odometry.duration_s == other.odometry.duration_s


@pytest.fixture(scope="module")
def raws(walk_file: Path) -> list[RawMessage]:
    return messages_of(walk_file)


@pytest.fixture(scope="module")
def long_walk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return Walk(30).write(tmp_path_factory.mktemp("walk") / "long.mcap")


@pytest.fixture(scope="module")
def long_raws(long_walk: Path) -> list[RawMessage]:
    return messages_of(long_walk)


# --- frames ---------------------------------------------------------------------------------------


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


# --- odometry that pauses -------------------------------------------------------------------------


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


# --- damage ---------------------------------------------------------------------------------------


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


# --- clocks ---------------------------------------------------------------------------------------


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


# --- counts ---------------------------------------------------------------------------------------


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


# --- topics ---------------------------------------------------------------------------------------


def test_a_topic_that_is_published_with_two_types_is_refused(raws: list[RawMessage]) -> None:
    transport = offering(raws)
    transport.offer(IMAGES, "sensor_msgs/Image")
    with pytest.raises(SequenceError, match=r"image/compressed has messages of .*Image and of .*expected one type"):
        Robot(transport).try_to_open()


def test_what_is_not_there_yet_is_named(raws: list[RawMessage]) -> None:
    for topic, said in [
        (IMAGES, "no image topic, expected one of type sensor_msgs/Image"),
        (ODOMETRY, "no odometry topic, expected one of type nav_msgs/Odometry; found "),
        (TF_STATIC, "no transform from 'base_link' (/odom, child frame) to 'camera_optical_frame'"),
    ]:
        robot = lived([raw for raw in raws if raw.topic != topic])
        assert robot.opened is None
        assert said in robot.wanting[-1]
        assert robot.wanting[-1].startswith("a made-up system: ")


def test_topics_may_come_one_after_the_other(raws: list[RawMessage], walk_file: Path) -> None:
    since_ms = {IMAGES: 0, ODOMETRY: 215, INFO: 315, TF_STATIC: 415}
    late = [
        raw._replace(log_time_ns=BEGIN_NS + since_ms[TF_STATIC] * MS) if raw.topic == TF_STATIC else raw for raw in raws
    ]
    robot = Robot(FakeTransport())
    for raw in sorted(late, key=lambda raw: raw.log_time_ns):
        if at_ms(raw) >= since_ms.get(raw.topic, 1e9):
            robot.transport.offer(raw.topic, raw.type, latched=raw.topic == TF_STATIC)
            robot.live_through([raw])
    said = list(dict.fromkeys(robot.wanting))[-3:]
    for each, wanted in zip(said, ("no odometry topic", "no readable message on /odom", "no transform"), strict=True):
        assert wanted in each
    assert robot.times_ms == [100 * n for n in range(3, 12)]  # from where odometry was heard
    assert robot.reader.camera == CAMERA
    require_same([frame for _, frame in robot.frames][1:], list(SequenceReader(walk_file))[4:])


def test_a_publisher_that_comes_back_with_other_reliability_is_heard_again(raws: list[RawMessage]) -> None:
    robot = Robot(offering(raws))
    robot.live_through([raw for raw in raws if at_ms(raw) < 550])
    before = len(robot.transport.subscribed)
    robot.transport.withdraw(IMAGES)
    robot.heard.refresh()
    assert len(robot.transport.subscribed) == before
    robot.transport.offer(IMAGES, "sensor_msgs/CompressedImage", reliable=False)
    robot.live_through([raw for raw in raws if at_ms(raw) > 550])
    assert [(offer.topic, offer.reliable) for offer in robot.transport.subscribed[before:]] == [(IMAGES, False)]
    assert len(robot.frames) == 12


def test_topics_of_no_use_are_not_listened_to(raws: list[RawMessage]) -> None:
    transport = offering(raws)
    for name, kind in (
        ("/scan", "sensor_msgs/LaserScan"),
        ("/tf", "std_msgs/Empty"),
        ("/clock", "rosgraph_msgs/Clock"),
    ):
        transport.offer(name, kind)
    robot = Robot(transport)
    robot.live_through(raws)
    assert len(robot.frames) == 12
    assert {offer.topic for offer in transport.subscribed} == {IMAGES, ODOMETRY, INFO, TF_STATIC}
    assert "/tf" not in robot.heard
    assert robot.reader.streamed == [IMAGES, ODOMETRY, INFO, TF_STATIC]


# --- odometry by tf -------------------------------------------------------------------------------


def tf_record(path: Path, *, num_images: int = 12, tf_topics: Iterable[str] = ("/tf",)) -> Path:
    """A walk whose odometry is on tf only: of one robot or several."""
    parts = [tf_files.images(num_images)]
    for topic in tf_topics:
        parts.append(tf_files.mounted(topic=f"{topic}_static"))
        parts.append(tf_files.tf("odom", "base_link", tf_files.stamps(num_images), tf_files.body, topic))
    return tf_files.record(path, *parts)


def test_odometry_of_tf_says_what_a_topic_would(tmp_path: Path) -> None:
    path = tf_record(tmp_path / "tf.mcap", num_images=20)
    by_tf = lived(messages_of(path))
    require_same([frame for _, frame in by_tf.frames], SequenceReader(path))
    topic = tf_files.odometry(tf_files.stamps(20))
    path = tf_files.record(tmp_path / "topic.mcap", tf_files.images(20), tf_files.mounted(), topic)
    by_topic = lived(messages_of(path))
    assert len(by_tf.frames) == len(by_topic.frames) == 20
    assert by_tf.reader.roles.odometry is None
    for (_, frame), (_, expected) in zip(by_tf.frames[1:], by_topic.frames[1:], strict=True):
        assert frame.odometry is not None
        assert expected.odometry is not None
        assert close(frame.odometry.previous_from_current, expected.odometry.previous_from_current, 1e-3)
        np.testing.assert_allclose(frame.odometry.covariance, expected.odometry.covariance, rtol=0.1, atol=1e-9)
    assert by_tf.reader.odometry_ns == by_topic.reader.odometry_ns
    last = by_tf.reader.odometry_ns
    assert last is not None
    pose = by_tf.reader.odom_from_base(last)
    assert pose is not None
    assert close(pose, tf_files.body(last), 1e-9)


def test_tf_of_one_robot_among_several_is_taken_by_its_name(tmp_path: Path) -> None:
    plain = SequenceReader(tf_record(tmp_path / "tf.mcap"))
    named = tf_record(tmp_path / "robot1.mcap", tf_topics=["/robot1/tf"])
    require_same(list(SequenceReader(named)), plain)  # the only one
    require_same([frame for _, frame in lived(messages_of(named)).frames], plain)
    two = tf_record(tmp_path / "two.mcap", tf_topics=["/robot1/tf", "/robot2/tf"])
    with pytest.raises(SequenceError, match=r"no odometry topic.*; tf is of 2 robots, name one by --tf-topic"):
        SequenceReader(two)
    chosen = SequenceOptions(tf_topic="/robot1/tf")
    require_same(list(SequenceReader(two, chosen)), plain)
    require_same([frame for _, frame in lived(messages_of(two), chosen).frames], plain)
    said = r"no tf on '/robot3/tf' \(--tf-topic\), found: /robot1/tf, /robot2/tf; expected one of these"
    with pytest.raises(NotFoundError, match=said):
        SequenceReader(two, SequenceOptions(tf_topic="/robot3/tf"))


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
