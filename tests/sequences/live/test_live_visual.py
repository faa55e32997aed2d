"""Odometry that images of a running system show: alone, beside what is published, and where there is none."""

from collections import Counter
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from filtering.motion import Odometry
from sequences.frame import Frame
from sequences.live.frames import LiveFrames
from sequences.live.reader import LiveReader
from sequences.options import ReadingOptions
from sequences.reader import SequenceReader
from sequences.reading.counts import BETWEEN, OVERTAKEN
from sequences.recordings.source import TF_STATIC, RawMessage
from sequences.visual_odometry.frames import TRACKED_HZ, VisualFrames
from sequences.visual_odometry.sequence import VisualSequence
from sequences.writer import MountedCamera, SequenceWriter
from tests.helpers.boards import CAMERA, STEP_NS, images_of, walk
from tests.helpers.fake_transport import messages_of, offering
from tests.helpers.live_reading import SECOND, Robot, at_ms, stamp_of, stamped
from tests.helpers.sequence_files import BASE_FROM_CAMERA, BEGIN_NS, MS, close
from tests.helpers.simulation import motion
from tests.helpers.waiting import Wait

IMAGES = images_of(walk("sideways", 60))


def recorded(path: Path, *, odometry: bool = False) -> Path:
    """Two seconds of textured boards, thirty images a second, with or without odometry."""
    poses = walk("sideways", 60)
    base = BASE_FROM_CAMERA
    with SequenceWriter(path, camera=CAMERA, base_from_camera=base) as writer:
        for i, image in enumerate(IMAGES):
            time_ns = BEGIN_NS + STEP_NS * i
            if odometry:
                writer.write_odometry(time_ns, base @ poses[i] @ base.inverse(), 1e-3 * np.eye(6))
            writer.write_encoded_image(time_ns, cv2.imencode(".png", image)[1].tobytes(), "png")
    return path


@pytest.fixture(scope="module")
def walked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return recorded(tmp_path_factory.mktemp("walk") / "walk.mcap")


def seen(reader: LiveReader, *, beside: bool = False) -> LiveFrames:
    """Frames with odometry from their images."""
    return LiveFrames(reader, visual=lambda: VisualFrames(CAMERA, beside=beside, most_hz=TRACKED_HZ))


def looking(raws: list[RawMessage]) -> Robot:
    return Robot(offering(raws), odometry="ignored", made=seen)


def test_frames_have_the_motion_of_a_recording_of_the_same_images(walked: Path) -> None:
    robot = looking(messages_of(walked))
    robot.live_through(messages_of(walked))
    frames = [frame for _, frame in robot.frames]
    expected = list(VisualSequence(SequenceReader(walked, odometry="ignored"), CAMERA, most_hz=TRACKED_HZ))
    assert [frame.time_ns for frame in frames] == [frame.time_ns for frame in expected]
    assert len(frames) == 31
    for frame, other in zip(frames, expected, strict=True):
        assert (frame.odometry is None) == (other.odometry is None)
        if frame.odometry is not None and other.odometry is not None:
            moved, same = frame.odometry.previous_from_current, other.odometry.previous_from_current
            np.testing.assert_array_equal(moved.as_matrix(), same.as_matrix())
    assert sum(frame.odometry is not None for frame in frames) > 25
    assert robot.reader.counts.skipped == {BETWEEN: 30}
    assert not robot.reader.has_odometry
    assert robot.reader.latest_ns == frames[-1].time_ns
    assert close(robot.reader.base_from_camera, BASE_FROM_CAMERA)


def test_the_motion_of_images_that_nobody_asked_for_is_not_lost(walked: Path) -> None:
    every, some = looking(messages_of(walked)), looking(messages_of(walked))
    every.live_through(messages_of(walked))
    some.live_through([raw for raw in messages_of(walked) if at_ms(raw) < 1010])
    some.live_through([raw for raw in messages_of(walked) if at_ms(raw) > 1010], ask=False)
    last = some.maker.newest()
    assert last is not None
    assert last.odometry is not None
    whole = Odometry.still()
    for _, frame in every.frames:
        if frame.time_ns > some.frames[-1][1].time_ns:
            assert frame.odometry is not None
            whole = whole.then(frame.odometry)
    assert close(last.odometry.previous_from_current, whole.previous_from_current, 1e-9)
    counts = some.reader.counts
    assert counts.skipped == {BETWEEN: 30, OVERTAKEN: 31 - len(some.frames) - 1}
    assert counts.are_complete
    assert some.maker.newest() is None


def test_images_that_nobody_asks_for_are_forgotten_but_for_their_motion(walked: Path) -> None:
    robot = looking(messages_of(walked))
    robot.live_through(messages_of(walked), ask=False)
    assert len(robot.maker._tracked) == 16
    assert robot.reader.counts.skipped == {BETWEEN: 30, OVERTAKEN: 14}
    assert len(robot.frames) == 1  # at the beginning


def test_a_clock_that_is_set_begins_anew(walked: Path) -> None:
    raws = [
        stamped(raw, stamp_of(raw) - 5 * SECOND) if raw.topic != TF_STATIC and at_ms(raw) > 1000 else raw
        for raw in messages_of(walked)
    ]
    robot = looking(raws)
    robot.live_through(raws)
    after = [frame for number, frame in robot.frames if number == robot.reader.readings]
    assert robot.reader.readings == 2
    assert after[0].odometry is None
    assert sum(frame.odometry is not None for frame in after) > 8
    assert robot.reader.counts.are_complete


def test_beside_published_odometry_both_make_the_motion(tmp_path: Path) -> None:
    raws = messages_of(recorded(tmp_path / "both.mcap", odometry=True))
    robot = Robot(offering(raws), made=lambda reader: seen(reader, beside=True))
    robot.live_through(raws)
    poses = walk("sideways", 60)
    assert robot.reader.has_odometry
    known = [frame for _, frame in robot.frames if frame.odometry is not None]
    assert len(known) == 30
    for frame in known[3:]:
        number = round((frame.time_ns - BEGIN_NS) / STEP_NS)
        true = poses[number - 2].inverse() @ poses[number]
        assert frame.odometry is not None
        assert close(frame.odometry.previous_from_current, true, 0.01)
        assert frame.odometry.covariance[0, 0] < 1e-3 * 2 * STEP_NS * 1e-9  # published alone
    time_ns = robot.reader.odometry_ns
    assert time_ns is not None
    assert robot.maker.moved_until(time_ns).duration_s <= 2 * STEP_NS * 1e-9


def test_an_image_that_comes_late_is_left_out_as_features_are_tracked_in_order(walked: Path) -> None:
    raws = messages_of(walked)
    image = next(raw for raw in raws if "Image" in raw.type and at_ms(raw) > 500)
    robot = Robot(offering(raws), odometry="ignored", made=seen, late_window_s=0.5)
    robot.live_through([raw for raw in raws if raw is not image and at_ms(raw) < 700])
    robot.live_through([image])
    robot.live_through([raw for raw in raws if at_ms(raw) > 700])
    assert [frame.time_ns for _, frame in robot.frames] == sorted({frame.time_ns for _, frame in robot.frames})
    assert robot.reader.counts.skipped["time stamp not increasing"] == 1
    assert robot.reader.counts.are_complete


@pytest.mark.parametrize("slow", ["/camera/image/compressed", "/left/image/compressed"])
def test_of_two_cameras_one_may_come_later_than_the_other(slow: str, tmp_path: Path) -> None:
    left = {"left": MountedCamera(CAMERA, BASE_FROM_CAMERA)}
    with SequenceWriter(tmp_path / "two.mcap", camera=CAMERA, base_from_camera=BASE_FROM_CAMERA, others=left) as writer:
        for i, image in enumerate(IMAGES[::2]):
            data = cv2.imencode(".png", image)[1].tobytes()
            writer.write_encoded_image(BEGIN_NS + 2 * STEP_NS * i, data, "png")
            writer.write_encoded_image(BEGIN_NS + 2 * STEP_NS * i + STEP_NS, data, "png", "left")
    raws = messages_of(tmp_path / "two.mcap")
    raws = [raw._replace(log_time_ns=raw.log_time_ns + 50 * MS * (raw.topic == slow)) for raw in raws]
    raws = sorted(raws, key=lambda raw: raw.log_time_ns)
    options = ReadingOptions(image_topic="/camera/image/compressed,/left/image/compressed")
    robot = Robot(offering(raws), options, odometry="ignored", made=seen)
    robot.live_through(raws)
    frames = [frame for _, frame in robot.frames]
    assert Counter(frame.camera_name for frame in frames).most_common()[-1][1] >= 28  # of thirty
    assert sum(frame.odometry is not None for frame in frames) > 50
    assert "time stamp not increasing" not in robot.reader.counts.skipped


class Given:
    """A reader of frames at hand."""

    def __init__(self, frames: list[Frame]) -> None:
        self.frames, self.readings, self.has_odometry = frames, 1, False
        self.lenses = dict.fromkeys(frame.camera_name for frame in frames)
        self.given_up: list[str] = []
        self.sensors = SimpleNamespace(begin=lambda **_: None, seen=lambda frame, before_ns: frame)

    def ready_frames(self) -> list[Frame]:
        ready, self.frames = self.frames, []
        return ready

    def take_in_order(self) -> None:
        pass

    def give_up(self, reason: str) -> None:
        self.given_up.append(reason)


@pytest.mark.usefixtures("unchecked")
def test_of_several_cameras_each_has_its_turn() -> None:
    still, mount = motion(0, 0, 0.01, 0, 0, 0, duration_s=0.05), BASE_FROM_CAMERA
    image = IMAGES[0]
    frames = [
        Frame(50 * MS * n, image, still, camera_name="ab"[n % 2], reference_from_camera=(None, mount)[n % 2])
        for n in range(12)
    ]
    reader = Given(frames)
    as_given = SimpleNamespace(num_between=0, disagreement=[], take=lambda frame: [frame], since=None)
    made = LiveFrames(reader, visual=lambda: as_given)
    found = []
    for _ in range(4):
        frame = made.newest()
        found.append(None if frame is None else (frame.time_ns // MS, frame.camera_name))
    assert found == [(500, "a"), (550, "b"), None, None]
    assert reader.given_up == [OVERTAKEN] * 10


# --- without any ----------------------------------------------------------------------------------


@pytest.fixture
def wait(walked: Path, monkeypatch: pytest.MonkeyPatch) -> Wait:
    wait = Wait(messages_of(walked))
    monkeypatch.setattr("sequences.live.opening.time", SimpleNamespace(monotonic=lambda: wait.now_s))
    return wait


def test_where_odometry_alone_is_missing_it_goes_on_without_after_ten_seconds(wait: Wait) -> None:
    topics = {raw.topic for raw in wait.raws}
    wait.changes = [(4.0, lambda: wait.offer(*topics)), (6.0, lambda: wait.say(*topics))]
    reader = wait.open(odometry="auto")
    assert not reader.has_odometry
    assert 16 <= wait.now_s < 17
    assert any(
        line.startswith("no odometry topic") and line.endswith("it goes on without odometry after 10 s")
        for _, line in wait.said
    )


def test_odometry_that_is_to_be_ignored_is_not_waited_for(wait: Wait) -> None:
    topics = {raw.topic for raw in wait.raws}
    wait.offer(*topics)
    wait.changes = [(2.0, lambda: wait.say(*topics))]
    reader = wait.open(odometry="ignored")
    assert not reader.has_odometry
    assert wait.now_s < 3


def test_odometry_that_comes_after_the_start_is_told(wait: Wait) -> None:
    topics = {raw.topic for raw in wait.raws}
    wait.offer(*topics)
    wait.changes = [(2.0, lambda: wait.say(*topics))]
    reader = wait.open(odometry="ignored")
    assert reader.notices == []
    wait.transport.offer("/odom", "nav_msgs/Odometry")
    reader.heard.refresh()
    (told,) = reader.notices
    assert told.startswith("/odom came after the start")
