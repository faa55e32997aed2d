"""A walk that is played to `live` for any duration, and what is measured of the answers."""

import json
import os
import shlex
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from filtering.errors import VaporTrackError
from filtering.se3 import Poses
from sequences.reader import SequenceReader
from sequences.recordings.mcap_writer import ros_header
from sequences.recordings.message_definitions import decoder, encoder
from sequences.recordings.messages import odometry_from_message
from tests.helpers.fake_transport import FakeTransport
from tests.helpers.full import full
from tests.helpers.tiny_model import SMALL
from vapor.benchmark.__main__ import main
from vapor.benchmark.live.measure import first_and_last, latency_of, require_alone
from vapor.benchmark.live.traffic import (
    IMAGE,
    ODOMETRY,
    Timeline,
    Traffic,
    folded,
    image_positions,
    play,
    read_walk,
    stamp_of,
    with_stamp,
)


def test_one_goes_there_and_back_again():
    assert [folded(way, 3) for way in range(9)] == [0, 1, 2, 3, 2, 1, 0, 1, 2]
    np.testing.assert_array_equal(folded(np.arange(9), 3), [0, 1, 2, 3, 2, 1, 0, 1, 2])


@pytest.mark.parametrize("number", [3, 4, 5, 30, 31])
@pytest.mark.parametrize("step", [1.0, 1.1, 1.5, 2.0, 3.0, 10 / 3])
def test_no_image_is_sent_twice_in_a_row(number: int, step: float):
    positions = list(islice(image_positions(number, step), 500))
    images = [folded(position, number - 1) for position in positions]
    assert np.diff(positions).min() >= 1
    assert np.diff(images).all()
    if step < number - 1:
        np.testing.assert_allclose(positions, step * np.arange(500), atol=1.5)
        assert set(images) == set(range(number)) or step > 1


def test_images_are_where_the_walk_is_at_their_time():
    times_ns = np.array([0, 100, 205, 300, 395, 500]) * 1_000_000 + 7  # not quite evenly
    for rate, speed in ((10.0, 1.0), (4.0, 1.0), (30.0, 3.0)):
        timeline = Timeline(times_ns, rate)
        assert timeline.speed == speed
        assert timeline.duration_s == pytest.approx(1.0 / speed)
        at_s, images = zip(*islice(timeline.images(), 40), strict=True)
        assert np.diff(at_s).min() > 0
        np.testing.assert_allclose(at_s, np.arange(40) / rate, atol=0.11 / speed)
        np.testing.assert_allclose(timeline.recorded_ns(np.array(at_s)), times_ns[list(images)], atol=2)


def test_a_message_gets_another_stamp():
    data = encoder("geometry_msgs/PoseStamped")({"header": ros_header(5, "map"), "pose": [1, 2, 3, 0, 0, 0, 1]})
    later = decoder("geometry_msgs/PoseStamped")(with_stamp(data, 1_700_000_000_123_456_789))
    assert (later.header.stamp.sec, later.header.stamp.nanosec) == (1_700_000_000, 123_456_789)
    assert (later.header.frame_id, later.pose.position.z) == ("map", 3.0)
    assert stamp_of(data) == 5


def test_the_odometry_that_is_played_leads_from_image_to_image_as_recorded(walk_of_25: Path):
    walk = read_walk(walk_of_25)
    traffic = Traffic(walk, 30.0, (64, 48))
    assert traffic.timeline.speed == pytest.approx(3.0)
    transport, at_s, images = FakeTransport(), [], 0
    for sent in play(transport, traffic):
        images += sent.topic == IMAGE
        at_s.append(sent.at_ns * 1e-9)
        if images == 6:
            break
    assert at_s[-1] - at_s[0] == pytest.approx(5 / 30, abs=0.1)
    info = decoder("sensor_msgs/CameraInfo")(transport.published["/camera/camera_info"][0])
    assert (info.width, info.height, info.k[0]) == (64, 48, pytest.approx(walk.camera.fx * 64 / walk.camera.width))
    messages = [decoder("nav_msgs/Odometry")(data) for data in transport.published[ODOMETRY]]
    samples = [odometry_from_message(message) for message in messages]
    stamps_ns = [stamp_of(data) for data in transport.published[IMAGE]]
    np.testing.assert_allclose(np.diff(stamps_ns), 1e9 / 30, rtol=1e-3)
    first, last = (min(samples, key=lambda sample: abs(sample.time_ns - t)) for t in (stamps_ns[0], stamps_ns[-1]))
    frames = list(islice(SequenceReader(walk_of_25), 6))
    moved = Poses.identity()
    variance = 0.0
    for frame in frames[1:]:
        assert frame.odometry is not None
        moved = moved @ frame.odometry.previous_from_current
        variance += np.trace(frame.odometry.covariance[:3, :3])
    camera = walk.base_from_camera
    played = camera.inverse() @ first.odom_from_base.between(last.odom_from_base) @ camera
    assert float(played.distance(moved)[0]) < 0.02  # odometry comes each 5 ms, and so not just with the image
    interval_s = np.median(np.diff([sample.time_ns for sample in samples])) * 1e-9
    stated = sum(np.trace(sample.twist_covariance[:3, :3]) for sample in samples) * interval_s**2
    assert stated == pytest.approx(variance, rel=0.3)


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
    walk_of_25: Path, tiny_model: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    words = ["live", "--model", str(tiny_model), "--sequence", str(walk_of_25), "--rates", "20"]
    words += ["--sizes", "160x120", "--minutes", "0.05", "--domain", str(1 + os.getpid() % 100)]
    assert main([*words, f"--live={shlex.join(SMALL)}", "--output", str(tmp_path / "out")]) == 0
    assert "160x120" in capsys.readouterr().out
    (measured,) = json.loads((tmp_path / "out" / "live.json").read_text())["measured"]
    assert 40 <= measured["pose"]["sent"] <= 62
    assert measured["pose"]["answered"] > 0.5 * measured["pose"]["sent"]
    assert 0 < measured["pose"]["median_ms"] < 1000
    assert 400 <= measured["base_pose"]["sent"] <= 612  # 200 a second for 3 s, and until the last image is out
    assert measured["usage"]["last_mb"] > 50


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
