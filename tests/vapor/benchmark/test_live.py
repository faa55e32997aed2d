"""A walk that is played to `live` for any duration, and what is measured of the answers."""

import os
import shlex
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from filtering.errors import VaporTrackError
from sequences.live.replay import replay
from sequences.reader import SequenceReader
from sequences.recordings.mcap_writer import ros_header
from sequences.recordings.message_definitions import decoder, encoder
from tests.helpers.fake_transport import FakeTransport
from tests.helpers.full import full
from tests.helpers.tiny_model import SMALL
from vapor.benchmark.__main__ import main
from vapor.benchmark.commands import live as command
from vapor.benchmark.live.measure import first_and_last, latency_of, measure, require_alone
from vapor.benchmark.live.traffic import (
    IMAGE,
    ODOMETRY,
    REPLAYED,
    AlteringTransport,
    Timeline,
    read_walk,
    stamp_of,
    with_stamp,
    write_walk,
)


@pytest.mark.parametrize("number", [3, 4, 5, 30, 31])
@pytest.mark.parametrize("rate", [20.0, 10.0, 9.1, 6.6, 5.0, 3.3, 3.0])
def test_the_walk_goes_there_and_back_and_no_image_is_sent_twice_in_a_row(number: int, rate: float):
    """Recorded at ten images a second."""
    timeline = Timeline(np.arange(number) * 100_000_000, rate)
    images, round_s = np.tile(timeline.numbers, 2), timeline.duration_s
    at_s = np.concatenate([timeline.at_s, round_s + timeline.at_s])
    assert np.diff(at_s).min() > 0
    assert np.diff(images).all()
    if rate >= 10.0:
        assert timeline.numbers.tolist() == [*range(number), *range(number - 2, 0, -1)]
    elif number >= 30:
        assert len(timeline.at_s) / round_s == pytest.approx(rate, rel=0.1)


def test_images_are_where_the_walk_is_at_their_time():
    times_ns = np.array([0, 100, 205, 300, 395, 500]) * 1_000_000 + 7  # not quite evenly
    for rate, speed in ((10.0, 1.0), (4.0, 1.0), (30.0, 3.0)):
        timeline = Timeline(times_ns, rate)
        assert timeline.speed == pytest.approx(speed)
        assert timeline.duration_s == pytest.approx(1.0 / speed)
        np.testing.assert_allclose(timeline.at_s, np.arange(len(timeline.at_s)) / rate, atol=0.11 / speed)
        for turn in (0, 3):
            at_s = turn * timeline.duration_s + timeline.at_s
            np.testing.assert_allclose(timeline.recorded_ns(at_s), times_ns[timeline.numbers], atol=2)


def test_a_message_gets_another_stamp():
    data = encoder("geometry_msgs/PoseStamped")({"header": ros_header(5, "map"), "pose": [1, 2, 3, 0, 0, 0, 1]})
    later = decoder("geometry_msgs/PoseStamped")(with_stamp(data, 1_700_000_000_123_456_789))
    assert (later.header.stamp.sec, later.header.stamp.nanosec) == (1_700_000_000, 123_456_789)
    assert (later.header.frame_id, later.pose.position.z) == ("map", 3.0)
    assert stamp_of(data) == 5


@pytest.mark.parametrize("from_s", [0.0, 0.7])
def test_the_walk_that_is_played_has_odometry_from_image_to_image_as_recorded(
    from_s: float, walk_of_25: Path, tmp_path: Path
):
    walk = read_walk(walk_of_25)
    timeline = write_walk(tmp_path / "played.mcap", walk, 30.0, (64, 48), from_s=from_s)
    assert timeline.speed == pytest.approx(3.0)
    reader = SequenceReader(tmp_path / "played.mcap")
    assert reader.camera is not None
    assert (reader.camera.width, reader.camera.height) == (64, 48)
    assert reader.camera.fx == pytest.approx(walk.camera.fx * 64 / walk.camera.width)
    played, recorded = list(reader), list(SequenceReader(walk_of_25))
    assert len(played) == 2 * len(recorded) - 2
    np.testing.assert_allclose(np.diff([frame.time_ns for frame in played]), 1e9 / 30, rtol=1e-3)
    at = 0 if from_s == 0.0 else round(2 * len(recorded) - 2 - 30 * from_s)  # where the recording's begin is
    ours, theirs = played[at + 1 : at + 6], recorded[1:6]
    for one, other in zip(ours, theirs, strict=True):
        assert one.odometry is not None
        assert other.odometry is not None
        apart_m, apart_rad = one.odometry.previous_from_current.distance(other.odometry.previous_from_current)
        assert (float(apart_m) < 5e-3, float(apart_rad) < 5e-3) == (True, True)
    stated = sum(np.trace(frame.odometry.covariance) for frame in ours if frame.odometry is not None)
    assert stated == pytest.approx(sum(np.trace(f.odometry.covariance) for f in theirs if f.odometry), rel=0.05)


def test_messages_are_altered_but_static_transforms(walk_of_25: Path, tmp_path: Path):
    write_walk(tmp_path / "played.mcap", read_walk(walk_of_25), 30.0, (64, 48))
    transport, topics = FakeTransport(), []

    def alter(topic: str, data: bytes) -> bytes | None:
        topics.append(topic)
        return None if topic == ODOMETRY else with_stamp(data, 7)

    for _ in islice(replay(tmp_path / "played.mcap", AlteringTransport(transport, alter), REPLAYED), 60):
        pass
    assert {stamp_of(data) for data in transport.published[IMAGE]} == {7}
    assert not transport.published.get(ODOMETRY)
    assert len(transport.published["/tf_static"]) == 1
    assert set(topics) == {IMAGE, ODOMETRY, "/camera/camera_info"}


def test_latency_is_that_of_first_answers():
    sent_ns = {10: 1_000_000, 20: 2_000_000, 30: 3_000_000}
    arrived_ns = [(10, 3_000_000), (5, 4_000_000), (20, 6_000_000), (10, 9_000_000)]
    latency = latency_of(sent_ns, arrived_ns)
    assert (latency.sent, latency.answered, latency.median_ms, latency.max_ms) == (3, 2, 3.0, 4.0)
    none = latency_of(sent_ns, [])
    assert (none.sent, none.answered) == (3, 0)
    assert np.isnan(none.median_ms)


def test_memory_is_compared_once_warm_with_the_end():
    times_s = np.arange(3601.0)
    values = np.where(times_s < 20, 100.0, np.where(times_s <= 320, 200.0, np.where(times_s < 3300, 900.0, 210.0)))
    assert first_and_last(list(times_s), list(values)) == (200.0, 210.0)
    assert first_and_last([0.0], [5.0]) == (5.0, 5.0)
    assert first_and_last([0.0, 1.0, 2.0, 3.0], [9.0, 4.0, 4.0, 6.0])[1] == 6.0


def test_nobody_else_may_be_in_the_domain():
    transport = FakeTransport()
    require_alone(transport)
    transport.offer("/odom", "nav_msgs/Odometry")
    with pytest.raises(VaporTrackError, match="others publish /odom"):
        require_alone(transport)


@full
def test_the_command_measures_live(
    walk_of_25: Path, tiny_model: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    words = ["live", "--model", str(tiny_model), "--sequence", str(walk_of_25), "--rates", "20"]
    words += ["--sizes", "160x120", "--minutes", "0.05", "--domain", str(1 + os.getpid() % 100)]
    measured = []

    def noted(*words, **more):
        measured.append(measure(*words, **more))
        return measured[0]

    monkeypatch.setattr(command, "measure", noted)
    assert main([*words, f"--live={shlex.join(SMALL)}"]) == 0
    assert "160x120, 20 Hz" in capsys.readouterr().out
    pose, base_pose = measured[0].pose, measured[0].base_pose
    assert 40 <= pose.sent <= 62
    assert pose.answered > 0.5 * pose.sent
    assert 0 < pose.median_ms < 1000
    assert 400 <= base_pose.sent <= 612  # 200 a second for 3 s, and until the last image is out
    assert measured[0].last_mb > 50


@pytest.mark.parametrize(
    ("word", "value", "said"),
    [
        ("--sizes", "wide", "--sizes"),
        ("--sizes", "4x4", "expected sides of 16"),
        ("--rates", "0", "expected numbers from 0.1"),
        ("--live", "'", "expected options"),
    ],
)
def test_options_that_make_no_sense(word: str, value: str, said: str, capsys: pytest.CaptureFixture[str]):
    with pytest.raises(SystemExit):
        main(["live", "--model", "staircase", "--sequence", "x.mcap", word, value])
    assert said in capsys.readouterr().err
