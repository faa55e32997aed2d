"""Control messages, snapshots and recordings of live localization."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from filtering.errors import VaporTrackError
from sequences.reader import SequenceReader
from sequences.recordings.bag import Bag
from sequences.recordings.messages import pose_from_message
from sequences.recordings.source import RawMessage
from tests.helpers.fake_transport import messages_of
from tests.helpers.live_session import hurry, replayed, running
from tests.helpers.live_system import stamp
from tests.helpers.sequence_files import ODOMETRY, Walk, world_from_base, world_from_camera

NS = 1_000_000_000


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    hurry(monkeypatch)


def test_a_message_on_initialpose_begins_anew_there(walk: Path) -> None:
    with running(walk) as run:
        replayed(run, walk, images=3)
        far = {"position": (70.0, -3.0, 0.0), "orientation": (0.0, 0.0, 0.0, 1.0)}
        covariance = np.diag([0.25, 0.25, 0.0, 0.0, 0.0, 0.068]).ravel()
        kind = "geometry_msgs/PoseWithCovarianceStamped"
        told = {"pose": {"pose": far, "covariance": covariance}}
        run.control("/initialpose", kind, header={"frame_id": "odom"}, **told)
        run.wait_told("expected one in 'map'")
        run.control("/initialpose", kind, header={"frame_id": "map"}, **told)
        run.wait_told("by /initialpose")
        belief: Any = run.session._belief
        best = belief.localizer.predicted(None).modes[0].world_from_camera
        base = best @ SequenceReader(walk).base_from_camera.inverse()  # pyright: ignore[reportOptionalMemberAccess]
        assert np.allclose(base.translation[:2], [70.0, -3.0])


def test_a_damaged_message_of_a_control_is_told_and_ends_nothing(walk: Path) -> None:
    with running(walk) as run:
        replayed(run, walk, images=2)
        kind = "geometry_msgs/PoseWithCovarianceStamped"
        run.transport.say(RawMessage("/initialpose", 0, b"\x00\x01\x00\x00\x05", kind, "cdr", b""))
        run.wait_told("/initialpose: ")
        assert run.error is None


def test_a_snapshot_has_the_image_and_what_was_believed(walk: Path, tmp_path: Path) -> None:
    with running(walk, snapshots=tmp_path) as run:
        run.wait_until_subscribed()
        run.control("/estimate/save_snapshot")
        run.wait_told("expected an estimate to save")
        replayed(run, walk, images=3)
        run.control("/estimate/save_snapshot")
        run.wait_told("snapshot ")
    (file,) = tmp_path.glob("snapshot-*.mcap")
    assert {*Bag(file).topics} == {"/image", "/estimate/pose", "/estimate/modes", "/estimate/particles"}


def test_what_comes_is_recorded_so_that_a_reader_finds_the_same_frames(walk: Path, tmp_path: Path) -> None:
    with running(walk, record=tmp_path / "drive.mcap") as run:
        replayed(run, walk)
        assert (tmp_path / "drive.mcap.incomplete").exists()
        assert not (tmp_path / "drive.mcap").exists()
    assert [file.name for file in tmp_path.iterdir()] == ["drive.mcap"]
    recorded, original = list(SequenceReader(tmp_path / "drive.mcap")), list(SequenceReader(walk))
    assert [frame.time_ns for frame in recorded] == [frame.time_ns for frame in original]
    for one, other in zip(recorded[1:], original[1:], strict=True):
        assert one.odometry is not None
        assert other.odometry is not None
        assert np.array_equal(one.odometry.covariance, other.odometry.covariance)


def test_a_full_disk_ends_the_recording_and_not_the_localization(
    walk: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("vapor.robot.recorder.Writer.add_message", full)
    with running(walk, record=tmp_path / "drive.mcap") as run:
        replayed(run, walk)
        run.wait_told("No space left on device")
        assert len(run.estimates) == 12
    assert [file.name for file in tmp_path.iterdir()] == ["drive.mcap.incomplete"]


def test_a_recording_is_never_overwritten(walk: Path, tmp_path: Path) -> None:
    (tmp_path / "drive.mcap").write_bytes(b"of yesterday")
    with running(walk, record=tmp_path / "drive.mcap") as run:
        error = run.wait_for_error()
    assert isinstance(error, VaporTrackError)
    assert "exists, expected the name of a new recording" in str(error)
    assert (tmp_path / "drive.mcap").read_bytes() == b"of yesterday"


def test_a_stated_pose_is_of_now_and_not_of_the_last_image(walk: Path, tmp_path: Path) -> None:
    raws = messages_of(Walk(40).write(tmp_path / "long.mcap"))
    with running(walk) as run:
        replayed(run, walk, images=3)
        for raw in raws:  # it drives on, and nobody sees where
            if raw.topic == ODOMETRY and raw.log_time_ns > run.estimates[-1].time_ns:
                run.transport.say(raw)
        last_ns = raws[-1].log_time_ns
        belief: Any = run.session._belief
        reader = belief.reader
        run.wait(lambda: reader.odometry_ns > last_ns - NS // 10)
        base = world_from_base(np.array(reader.odometry_ns))
        numbers = np.array([*base.translation, *base.as_quat_xyzw()])
        told = {"pose": numbers, "covariance": (1e-4 * np.eye(6)).ravel()}
        run.control("/initialpose", "geometry_msgs/PoseWithCovarianceStamped", header={"frame_id": "map"}, pose=told)
        run.wait_told("by /initialpose")
        pose = run.messages("pose")[-1]
        believed = pose_from_message(pose.pose.pose)
        assert float(believed.distance(world_from_camera(stamp(pose.header)))[0]) < 0.05
        run.wait(lambda: len(run.messages("base_pose")) > 0)
        assert reader.frame_ns == reader.odometry_ns
