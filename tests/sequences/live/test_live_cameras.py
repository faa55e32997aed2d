"""Frames of several cameras of a running system."""

from collections import Counter
from pathlib import Path

import pytest

from sequences.errors import NotFoundError
from sequences.frame import Frame
from sequences.options import ReadingOptions
from sequences.reader import SequenceReader
from sequences.recordings.source import RawMessage
from tests.helpers.fake_transport import messages_of, offering
from tests.helpers.live_reading import Robot
from tests.helpers.rigs import CAMERA_FROM_LEFT, FRONT, LEFT, NARROW, RIGHT, WIDE, Rig
from tests.helpers.sequence_files import CAMERA, MS, Walk, close

ALL = ReadingOptions(image_topic=f"{FRONT},{LEFT},{RIGHT}")
EVERY = 3


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    rig = Rig({"left": 0, "right": 30 * MS}, {"right": 5})
    return rig.write(tmp_path_factory.mktemp("rig") / "rig.mcap", Walk(30))


@pytest.fixture(scope="module")
def raws(recording: Path) -> list[RawMessage]:
    return messages_of(recording)


def frames_of(robot: Robot) -> list[Frame]:
    return [frame for _, frame in robot.frames]


def test_a_quick_reader_gets_the_frames_of_the_recording(recording: Path, raws: list[RawMessage]) -> None:
    robot = Robot(offering(raws), ALL, late_window_s=0.5)
    robot.live_through(raws)
    recorded = {(f.time_ns // 1000, f.camera_name): f for f in SequenceReader(recording)}
    frames = frames_of(robot)
    assert len(frames) > 50
    for frame in frames:
        other = recorded[frame.time_ns // 1000, frame.camera_name]
        assert frame.camera == other.camera == {FRONT: CAMERA, LEFT: WIDE, RIGHT: NARROW}[frame.camera_name]
        if frame.camera_name == LEFT:
            assert frame.reference_from_camera is not None
            assert close(frame.reference_from_camera, CAMERA_FROM_LEFT, 1e-9)


def test_a_slow_reader_gets_the_cameras_in_turn(raws: list[RawMessage]) -> None:
    robot = Robot(offering(raws), ALL, late_window_s=0.5)
    images = [raw for raw in raws if raw.topic in (FRONT, LEFT, RIGHT)]
    asked = {id(raw) for raw in images[::EVERY]}
    for raw in raws:
        robot.live_through([raw], ask=False)
        if robot.opened is not None and id(raw) in asked and (frame := robot.reader.newest_frame()) is not None:
            robot.frames.append((robot.reader.readings, frame))
    counts = Counter(frame.camera_name for frame in frames_of(robot))
    assert min(counts[FRONT], counts[LEFT]) >= 6
    assert counts[RIGHT] >= 4  # of six at all
    assert robot.reader.counts.read == len(images)


def test_the_cameras_of_a_model_are_read_where_none_is_named(raws: list[RawMessage]) -> None:
    class Knowing(Robot):
        def try_to_open(self) -> None:
            self.heard.refresh()
            if self.opened is None:
                from sequences.live.reader import LiveReader

                try:
                    self.opened = LiveReader(self.heard, self.options, usual_cameras=[RIGHT, "/elsewhere", FRONT])
                except NotFoundError as error:
                    self.wanting.append(str(error))

    robot = Knowing(offering(raws))
    robot.live_through(raws)
    assert [*robot.reader.lenses] == [RIGHT, FRONT]
    assert robot.reader.camera == NARROW
    heard = {offer.topic for offer in robot.transport.subscribed}
    assert LEFT not in heard
