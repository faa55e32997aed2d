"""Recordings that are published as they were logged."""

from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import islice, pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from filtering.errors import VaporTrackError
from filtering.se3 import Poses
from sequences.errors import SequenceError
from sequences.live.replay import Replayed, ReplayOptions, replay
from sequences.live.transport import Publish
from sequences.recordings.bag import Bag
from sequences.recordings.message_definitions import decoder
from sequences.recordings.source import TF, TF_STATIC, RawMessage
from tests.helpers import foxglove_files, tf_files
from tests.helpers.fake_transport import FakeTransport
from tests.helpers.inertial_files import IMU, inertial_messages, with_messages
from tests.helpers.sequence_files import BEGIN_NS, FORMS, IMAGES, ODOMETRY, rewrite

SECOND = 10**9
CLOCK = "/clock"
NOW_NS = 1_800_000_000_000_000_123


@dataclass
class Clock:
    """A machine's clocks, which go on while somebody sleeps, and by nothing else."""

    now_s: float = 0.0
    sleeps_s: list[float] = field(default_factory=list)

    def sleep(self, seconds: float) -> None:
        assert seconds >= 0
        self.sleeps_s.append(seconds)
        self.now_s += seconds

    def monotonic(self) -> float:
        return self.now_s

    def time_ns(self) -> int:
        return NOW_NS + round(self.now_s * 1e9)


@pytest.fixture(autouse=True)
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr("sequences.live.replay.time", clock)
    return clock


@dataclass
class Listening(FakeTransport):
    """A system that notes when everything was published."""

    clock: Clock = field(default_factory=Clock)
    at_s: dict[str, list[float]] = field(default_factory=dict)

    def advertise(self, topic: str, message_type: str, *, latched: bool = False) -> Publish:
        publish = super().advertise(topic, message_type, latched=latched)
        times = self.at_s.setdefault(topic, [])

        def noted(data: bytes) -> None:
            times.append(self.clock.now_s)
            publish(data)

        return noted


@pytest.fixture
def system(clock: Clock) -> Listening:
    return Listening(clock=clock)


def logged(path: Path) -> list[RawMessage]:
    """What is to be published one by one."""
    bag = Bag(path)
    return [raw for raw in bag.messages([*bag.topics]) if raw.topic != TF_STATIC]


def without_stamps(value: Any, take: Callable[[int], None]) -> Any:
    """Fields of a message but its stamps, which are given away."""
    if hasattr(value, "sec"):
        take(value.sec * SECOND + value.nanosec)
        return "a stamp"
    if hasattr(value, "__msgtype__"):
        return {name: without_stamps(each, take) for name, each in vars(value).items()}
    if isinstance(value, np.ndarray):
        return value.tolist()
    return [without_stamps(each, take) for each in value] if isinstance(value, list) else value


# --- what, and when -------------------------------------------------------------------------------


@pytest.mark.parametrize("form", [None, *FORMS])
def test_all_messages_are_published_in_their_order_as_they_are(
    form: Callable[[Path, Path], Path] | None, walk_file: Path, tmp_path: Path, system: Listening
) -> None:
    path = walk_file if form is None else form(walk_file, tmp_path)
    steps = list(replay(path, system))
    expected = logged(path)
    assert [topic for topic in system.in_order if topic != TF_STATIC] == [raw.topic for raw in expected]
    for topic in {raw.topic for raw in expected}:
        assert system.published[topic] == [raw.data for raw in expected if raw.topic == topic]
    assert steps == [Replayed(n + 1, 0) for n in range(len(expected))]
    types = {raw.topic: (raw.type, False) for raw in expected}
    assert system.advertised == {**types, TF_STATIC: ("tf2_msgs/TFMessage", True)}


@pytest.mark.parametrize(("rate", "delay_s"), [(1.0, 1.0), (4.0, 0.0), (0.5, 2.5), (1000.0, 0.0)])
def test_messages_are_published_when_they_were_logged(
    rate: float, delay_s: float, walk_file: Path, system: Listening
) -> None:
    for _ in replay(walk_file, system, ReplayOptions(rate=rate, delay_s=delay_s)):
        pass
    raws = logged(walk_file)
    for topic in (IMAGES, ODOMETRY):
        due_s = [delay_s + (raw.log_time_ns - raws[0].log_time_ns) * 1e-9 / rate for raw in raws if raw.topic == topic]
        np.testing.assert_allclose(system.at_s[topic], due_s, atol=1e-6)
    assert system.at_s[TF_STATIC] == [0.0]  # before those who listen were waited for
    assert max(system.clock.sleeps_s) <= max(delay_s, 0.1)  # who wants to end it does not wait for long


def test_a_recording_is_begun_anew_again_and_again(walk_file: Path, system: Listening) -> None:
    raws = logged(walk_file)
    number = len(raws)
    steps = list(islice(replay(walk_file, system, ReplayOptions(loop=True, delay_s=0.0)), 3 * (number + 1)))
    assert [step.rounds for step in steps] == [0] * number + [1] * (number + 1) + [2] * (number + 1) + [3]
    assert steps[-1].messages == 3 * number
    images = [raw.data for raw in raws if raw.topic == IMAGES]
    assert system.published[IMAGES] == images * 3
    assert len(system.published[TF_STATIC]) == 1
    begins = system.at_s[IMAGES][:: len(images)]
    duration_s = (raws[-1].log_time_ns - raws[0].log_time_ns) * 1e-9
    np.testing.assert_allclose(np.diff(begins), duration_s, atol=1e-6)


# --- transforms that never change -----------------------------------------------------------------


def test_transforms_that_never_change_are_kept_as_one_message_for_those_who_come_late(
    tmp_path: Path, system: Listening
) -> None:
    def static(parent: str, child: str, metres: float, at_ms: int) -> list[tf_files.Event]:
        pose = Poses.exp(np.array([metres, 0.0, 0.0, 0.0, 0.0, 0.3]))
        return tf_files.tf(parent, child, [BEGIN_NS + at_ms * tf_files.MS], lambda _: pose, TF_STATIC)

    path = tf_files.record(
        tmp_path / "tf.mcap",
        tf_files.images(),
        static("base_link", "camera", 1.0, 0),
        static("base_link", "lidar", 2.0, 300),
        static("base_link", "camera", 3.0, 600),
        static("map", "odom", 4.0, 700),
    )
    list(replay(path, system))
    assert system.advertised[TF_STATIC] == ("tf2_msgs/TFMessage", True)
    (data,) = system.published[TF_STATIC]
    told = {t.child_frame_id: t for t in decoder("tf2_msgs/TFMessage")(data).transforms}
    expected = {
        t.child_frame_id: t
        for raw in Bag(path).messages([TF_STATIC])
        for t in decoder("tf2_msgs/TFMessage")(raw.data).transforms
    }
    assert told == expected
    assert {name: t.transform.translation.x for name, t in told.items()} == pytest.approx(
        {"camera": 3.0, "lidar": 2.0, "odom": 4.0}, abs=0.1
    )
    assert system.in_order[0] == TF_STATIC


# --- the clock ------------------------------------------------------------------------------------


@pytest.mark.parametrize("rate", [0.5, 1.0, 10.0])
def test_the_time_of_the_recording_goes_on_evenly_on_clock(rate: float, walk_file: Path, system: Listening) -> None:
    list(replay(walk_file, system, ReplayOptions(rate=rate, clock=True, delay_s=0.0)))
    assert system.advertised[CLOCK] == ("rosgraph_msgs/Clock", False)
    messages = [decoder("rosgraph_msgs/Clock")(data).clock for data in system.published[CLOCK]]
    times = [message.sec * SECOND + message.nanosec for message in messages]
    raws = logged(walk_file)
    assert all(after > before for before, after in pairwise(times))
    assert max(after - before for before, after in pairwise(times)) < 10_000_000 * max(rate, 1.0)
    assert times[0] == raws[0].log_time_ns
    assert 0 <= raws[-1].log_time_ns - times[-1] <= 5_000_000 * max(rate, 1)
    np.testing.assert_allclose(system.at_s[CLOCK], [(t - raws[0].log_time_ns) * 1e-9 / rate for t in times], atol=2e-6)


# --- stamps ---------------------------------------------------------------------------------------


def robot(path: Path) -> Path:
    """A recording of many types: with headers, with transforms, and with neither."""
    return tf_files.record(
        path,
        tf_files.images(),
        tf_files.mounted(),
        tf_files.odometry(tf_files.stamps()),
        tf_files.tf("odom", "base_link", tf_files.stamps(), tf_files.body),
        tf_files.tf("map", "odom", tf_files.stamps(every_ms=90), tf_files.body),
        tf_files.told_by("geometry_msgs/PoseWithCovarianceStamped", tf_files.stamps(), topic="/pose"),
        tf_files.told_by("geometry_msgs/TransformStamped", tf_files.stamps(), topic="/mocap"),
        [tf_files.Event(BEGIN_NS + 5, "/start", "std_msgs/Empty", {})],
        [tf_files.Event(BEGIN_NS + 6, "/point", "geometry_msgs/Point", {"x": 1.0, "y": 2.0, "z": 3.0})],
        [tf_files.Event(BEGIN_NS + 7, "/none", "tf2_msgs/TFMessage", {"transforms": []})],
    )


def test_stamps_are_shifted_to_now_by_the_same_time_and_nothing_else_changes(tmp_path: Path, system: Listening) -> None:
    path = robot(tmp_path / "robot.mcap")
    list(replay(path, system, ReplayOptions(restamp=True, delay_s=3.0)))
    raws = logged(path)
    shift_ns = NOW_NS + 3 * SECOND - raws[0].log_time_ns
    numbers = dict.fromkeys(system.published, 0)
    for raw in raws:
        data = system.published[raw.topic][numbers[raw.topic]]
        numbers[raw.topic] += 1
        stamps: list[int] = []
        expected_stamps: list[int] = []
        read = decoder(raw.type)
        told = without_stamps(read(data), stamps.append)
        assert told == without_stamps(read(raw.data), expected_stamps.append)
        assert stamps == pytest.approx([each + shift_ns for each in expected_stamps], abs=1)  # rounded to nanoseconds
        assert len(stamps) == (raw.topic not in ("/start", "/point", "/none"))
        assert len(data) == len(raw.data)
    assert {topic: len(found) for topic, found in system.published.items()} == {**numbers, TF_STATIC: 1}
    assert {TF, "/odom", "/pose", "/mocap", "/start", "/point", "/none", "/image/compressed"} <= numbers.keys()


# --- what cannot be published ---------------------------------------------------------------------


@pytest.mark.parametrize("encoding", ["protobuf", "json"])
def test_a_recording_without_messages_as_ros_2_encodes_them_is_refused(
    encoding: str, tmp_path: Path, system: Listening
) -> None:
    path = foxglove_files.write(tmp_path / "foxglove.mcap", encoding, foxglove_files.images())
    with pytest.raises(
        SequenceError, match=r"foxglove\.mcap: no topic of ROS 2 \(CDR\), expected messages that can be"
    ):
        next(replay(path, system))
    assert not system.advertised


def test_topics_that_cannot_be_published_are_told_and_the_others_published(
    walk_file: Path, tmp_path: Path, system: Listening
) -> None:
    bag = tmp_path / "bag"
    bag.mkdir()
    rewrite(walk_file, bag / "walk.mcap", keep=lambda topic, _: topic in (IMAGES, ODOMETRY))
    foxglove_files.write(bag / "foxglove.mcap", "protobuf", foxglove_files.images(topic="/foxglove"))
    (bag / "metadata.yaml").write_text("relative_file_paths:\n- walk.mcap\n- foxglove.mcap\n")
    told: list[str] = []
    list(replay(bag, system, notify=told.append))
    assert told == ["not published: /foxglove"]
    assert {topic: len(found) for topic, found in system.published.items()} == {IMAGES: 12, ODOMETRY: 62}
    assert TF_STATIC not in system.advertised


@pytest.mark.parametrize(("name", "value"), [("rate", 0.0), ("rate", np.nan), ("rate", 1e4), ("delay_s", -1.0)])
def test_options_that_cannot_be_are_refused(name: str, value: float) -> None:
    with pytest.raises(VaporTrackError, match=name):
        ReplayOptions(**{name: value})  # pyright: ignore[reportArgumentType]


def test_inertial_units_and_barometers_are_published_as_well(walk_file: Path, tmp_path: Path) -> None:
    imu = with_messages(walk_file, tmp_path / "imu.mcap", IMU, "sensor_msgs/Imu", inertial_messages(seconds=0.5))
    pressures = [(BEGIN_NS + n * 10**8, {"fluid_pressure": 101_325.0}) for n in range(5)]
    path = with_messages(imu, tmp_path / "both.mcap", "/pressure", "sensor_msgs/FluidPressure", pressures)
    transport = FakeTransport()
    for _ in replay(path, transport):
        pass
    assert (transport.advertised[IMU], len(transport.published[IMU])) == (("sensor_msgs/Imu", False), 50)
    assert len(transport.published["/pressure"]) == 5
