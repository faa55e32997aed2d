"""True poses in files beside a recording: three formats, their clocks, and what is wrong with them."""

import re
from pathlib import Path

import numpy as np
import pytest

from filtering.se3 import Poses
from sequences.datasets.frames import posed_frames
from sequences.errors import SequenceError
from sequences.files import Rows
from sequences.frame import Trajectory
from sequences.options import SequenceOptions
from sequences.reader import SequenceReader
from sequences.trajectories.pose_tables import read_pose_table
from sequences.trajectories.tum import write_tum
from tests.helpers.pose_files import TIMES_NS, TRACK, as_euroc, as_kitti, as_tum
from tests.helpers.sequence_files import BASE_FROM_CAMERA, BEGIN_NS
from tests.helpers.tf_files import MS, body, images, mounted, odometry, record, stamps, told_by

FORMATS = [as_tum, as_euroc, as_kitti]


@pytest.fixture
def walk(tmp_path: Path) -> Path:
    return record(tmp_path / "walk.mcap", images(), mounted(), odometry(stamps()))


@pytest.mark.parametrize("write", FORMATS)
def test_every_format_gives_times_and_poses(write, tmp_path: Path) -> None:
    found = read_pose_table(write(tmp_path))
    np.testing.assert_array_equal(found.times_ns, TIMES_NS)
    np.testing.assert_allclose(found.poses.as_matrix(), TRACK.poses.as_matrix(), atol=2e-9)


@pytest.mark.parametrize("by", ["{0}.{1:09d}", "{0}{1:09d}", "rgb/{0}.{1:09d}.png", "cam0/{0}{1:09d}.png"])
@pytest.mark.parametrize("between", [" ", ", "])
def test_columns_may_be_in_any_order_and_stamps_may_be_names(by: str, between: str, tmp_path: Path) -> None:
    rows = zip(TIMES_NS.tolist(), TRACK.poses.translation, TRACK.poses.as_quat_xyzw(), strict=True)
    lines = [[9, *turned, by.format(*divmod(time_ns, 10**9)), *at[::-1]] for time_ns, at, turned in rows]
    (tmp_path / "a.txt").write_text("\n".join(between.join(map(str, line)) for line in lines))
    found = read_pose_table(tmp_path / "a.txt", columns=f"_ qx qy qz qw {'name' if '/' in by else 'time'} tz ty tx")
    np.testing.assert_array_equal(found.times_ns, TIMES_NS)
    np.testing.assert_allclose(found.poses.as_matrix(), TRACK.poses.as_matrix(), atol=2e-9)


@pytest.mark.parametrize("write", FORMATS)
def test_rows_that_cannot_be_used_are_left_out_and_counted(write, tmp_path: Path) -> None:
    lines = write(tmp_path).read_text().splitlines()
    first = int(lines[0].startswith("#"))
    without = sorted(set(range(len(TIMES_NS))) - {3, 7})
    for i in (3, 7):
        lines[first + i] = re.sub(r"[ ,]-?\d+\.\d+(e-\d+)?", lambda found: f"{found[0][0]}nan", lines[first + i])
    file = write(tmp_path)
    file.write_text("\n".join(lines))
    found = read_pose_table(file, rows=(rows := Rows("poses")))
    np.testing.assert_array_equal(found.times_ns, TIMES_NS[without])
    assert f"2 of {len(TIMES_NS)} poses left out, the first: {file}:{first + 4}: " in rows.notices[0]


@pytest.mark.parametrize("write", [as_tum, as_euroc])
@pytest.mark.parametrize("row", [0, 5])
def test_one_stamp_in_the_future_is_left_out_and_none_behind_it(write, row: int, tmp_path: Path) -> None:
    file = write(tmp_path)
    lines = file.read_text().splitlines()
    at = row + int(lines[0].startswith("#"))
    lines[at] = f"29{lines[at][2:]}"
    file.write_text("\n".join(lines))
    found = read_pose_table(file, rows=(rows := Rows("poses")))
    np.testing.assert_array_equal(found.times_ns, np.delete(TIMES_NS, row))
    assert f"1 of {len(TIMES_NS)} poses left out, the first: {file}:{at + 1}: time 29" in rows.notices[0]


@pytest.mark.parametrize("first", ["time tx ty tz qx qy qz qw", "1.0 2.0 3.0"])
def test_a_header_or_a_first_line_that_was_cut_is_passed_over(first: str, tmp_path: Path) -> None:
    file = as_tum(tmp_path)
    file.write_text(f"{first}\n{file.read_text()}")
    found = read_pose_table(file, rows=Rows("poses"))
    np.testing.assert_array_equal(found.times_ns, TIMES_NS)


def test_a_table_between_semicolons_is_read_by_the_names_of_its_columns(tmp_path: Path) -> None:
    file = as_tum(tmp_path)
    file.write_text(file.read_text().replace(" ", "; "))
    with pytest.raises(
        SequenceError, match=r"poses\.tum:1: 8 columns, expected .* the names of its columns \(--columns;"
    ):
        read_pose_table(file)
    found = read_pose_table(file, columns="time,tx,ty,tz,qx,qy,qz,qw")
    np.testing.assert_allclose(found.poses.as_matrix(), TRACK.poses.as_matrix(), atol=2e-9)


@pytest.mark.parametrize("write", FORMATS)
def test_a_file_gives_a_recording_its_true_poses(write, walk: Path, tmp_path: Path) -> None:
    options = SequenceOptions(poses=write(tmp_path), ground_truth_child_frame="base_link")
    frames = list(posed_frames(walk, options=options))
    assert len(frames) == 12
    for frame in frames:
        assert frame.world_from_camera is not None
        assert frame.odometry is not None or frame is frames[0]
        assert max(frame.world_from_camera.distance(body(frame.time_ns) @ BASE_FROM_CAMERA)) < 1e-3


def test_a_file_goes_before_a_topic_and_is_of_the_camera_by_default(tmp_path: Path) -> None:
    path = record(tmp_path / "a.mcap", images(), mounted(), told_by("geometry_msgs/PoseStamped", stamps()))
    shifted = Trajectory(TIMES_NS, Poses.exp(np.array([0, 0, 9.0, 0, 0, 0])) @ TRACK.poses)
    write_tum(tmp_path / "a.tum", shifted)
    for frame in posed_frames(path, options=SequenceOptions(poses=tmp_path / "a.tum")):
        assert frame.world_from_camera is not None
        np.testing.assert_allclose(
            frame.world_from_camera.translation, body(frame.time_ns).translation + np.array([0, 0, 9]), atol=1e-3
        )


def test_a_file_in_any_order_of_columns_with_unusable_rows_is_told_of(walk: Path, tmp_path: Path) -> None:
    lines = [" ".join(line.split()[::-1]) for line in as_tum(tmp_path).read_text().splitlines()]
    lines[-1] = lines[-1].replace(lines[-1].split()[3], "nan", 1)
    (tmp_path / "a.txt").write_text("\n".join(lines))
    options = SequenceOptions(
        poses=tmp_path / "a.txt", poses_columns="qw qz qy qx tz ty tx time", ground_truth_child_frame="base_link"
    )
    frames = posed_frames(walk, options=options)
    for frame in frames:
        assert frame.world_from_camera is not None
        assert max(frame.world_from_camera.distance(body(frame.time_ns) @ BASE_FROM_CAMERA)) < 1e-3
    assert f"1 of {len(TIMES_NS)} poses left out" in frames.notices[0]
    with pytest.raises(SequenceError, match="columns: 'x' in 'time x', expected"):
        SequenceOptions(poses=tmp_path / "a.txt", poses_columns="time x")


def test_an_offset_is_added_to_the_stamps(walk: Path, tmp_path: Path) -> None:
    write_tum(tmp_path / "a.tum", Trajectory(TIMES_NS - BEGIN_NS + 250 * MS, TRACK.poses))
    options = SequenceOptions(
        poses=tmp_path / "a.tum", time_offset_s=BEGIN_NS * 1e-9 - 0.25, ground_truth_child_frame="base_link"
    )
    for frame in posed_frames(walk, options=options):
        assert frame.world_from_camera is not None
        assert max(frame.world_from_camera.distance(body(frame.time_ns) @ BASE_FROM_CAMERA)) < 1e-3
    without = SequenceOptions(poses=tmp_path / "a.tum")
    with pytest.raises(SequenceError, match=r"a\.tum are from 0\.217 to 1\.\d+ s, images from 1700000000\.123 to"):
        list(posed_frames(walk, options=without))
    reader = SequenceReader(walk, without)
    assert len(list(reader)) == 12
    assert "images from" in reader.notices[0]


@pytest.mark.usefixtures("unchecked")
def test_an_offset_is_found_by_what_odometry_says_of_the_rotation(tmp_path: Path) -> None:
    num_images = 150
    path = record(tmp_path / "a.mcap", images(num_images), mounted(), odometry(stamps(num_images)))
    times_ns = np.array(stamps(num_images, every_ms=33), np.int64)
    turned = Poses.exp(np.array([3.0, 2.0, 1.0, 0.3, -0.5, 2.0]))
    track = turned @ Poses.stack([body(t) for t in times_ns])
    write_tum(tmp_path / "a.tum", Trajectory(times_ns - BEGIN_NS + 1234 * MS, track))
    reader = SequenceReader(path, SequenceOptions(poses=tmp_path / "a.tum", time_offset_s="auto"))
    assert reader.resolved["time_offset_s"] == pytest.approx(BEGIN_NS * 1e-9 - 1.234, abs=0.005)
    assert "time offset" in reader.notices[0]
    with pytest.raises(SequenceError, match=r"no odometry found, expected it for --time-offset-s auto"):
        SequenceReader(path, SequenceOptions(poses=tmp_path / "a.tum", time_offset_s="auto"), odometry="unread")
    short = Trajectory(times_ns[:100], track[:100])
    write_tum(tmp_path / "short.tum", short)
    with pytest.raises(SequenceError, match=r"short\.tum: 3\.27 s of poses, expected 10 to .* give --time-offset"):
        SequenceReader(path, SequenceOptions(poses=tmp_path / "short.tum", time_offset_s="auto"))


def test_a_jump_in_a_file_is_counted(walk: Path, tmp_path: Path) -> None:
    later = np.where(np.arange(len(TRACK)) >= 30, 0.7, 0.0)
    poses = Poses(TRACK.poses.rotation, TRACK.poses.translation + later[:, None])
    times_ns = TIMES_NS + (BEGIN_NS + 500 * MS - int(TIMES_NS[30]) + 7 * MS)  # with an image in between
    write_tum(tmp_path / "a.tum", Trajectory(times_ns, poses))
    frames = posed_frames(walk, options=SequenceOptions(poses=tmp_path / "a.tum"))
    assert BEGIN_NS + 500 * MS not in [frame.time_ns for frame in frames]
    assert frames.skipped["true pose jumps"] == 1
    assert "jump 1 time, " in frames.notices[0]


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("a.txt", "", r"a\.txt: no poses, expected TUM text, EuRoC"),
        ("a.txt", "1 2 3\n", r"a\.txt:1: 3 columns, expected TUM text \(8\)"),
        ("a.csv", "1,0,0,0,1,0,0\n", r"a\.csv:1: 7 columns, expected at least the eight"),
        ("a.csv", "1.5,0,0,0,1,0,0,0\n", r"a\.csv:1: nanoseconds: '1.5', expected a whole number"),
        ("a.csv", "1,0,0,0,2,0,0,0\n", r"a\.csv:1: .*is no finite position and unit quaternion"),
        ("a.csv", "1,0,0,nan,1,0,0,0\n", r"a\.csv:1: .*is no finite position"),
        ("a.csv", "#t\n2,0,0,0,1,0,0,0\n1,0,0,0,1,0,0,0\n", r"a\.csv:3: time 1 ns is not after the line before"),
        ("a.csv", f"{10**25},0,0,0,1,0,0,0\n", r"a\.csv:1: nanoseconds: .* expected a whole number between"),
        ("a.txt", "1 0 0 0 0 1 0 0 0 0 1 0\n", r"times\.txt: no such file, expected the times of a\.txt"),
        ("a.txt", "1 0 0 0 0 1 0 0 0 0 2 0\n", r"a\.txt:1: no finite rotation and translation"),
        ("a.txt", "1 0 0 0 0 1 0 0 0 0 -1 0\n", r"a\.txt:1: a mirroring, no rotation"),
        ("a.txt", "1 0 0 0 0 1 0 0 0 0 x 0\n", r"a\.txt:1: 'x' is no number"),
    ],
)
def test_what_is_wrong_is_said_with_file_and_line(name: str, text: str, said: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(SequenceError, match=said):
        read_pose_table(tmp_path / name)


def test_times_must_be_as_many_as_poses(tmp_path: Path) -> None:
    file = as_kitti(tmp_path)
    (tmp_path / "times.txt").write_text("0.0\n0.1\n")
    with pytest.raises(SequenceError, match=rf"times\.txt: 2 times, expected {len(TIMES_NS)} as there are poses in 00"):
        read_pose_table(file)
    with pytest.raises(SequenceError, match=r"nowhere\.txt: cannot read"):
        read_pose_table(tmp_path / "nowhere.txt")


def test_settings_of_a_file_without_a_file_are_refused() -> None:
    with pytest.raises(SequenceError, match="expected --poses with them"):
        SequenceOptions(time_offset_s="auto")
    with pytest.raises(SequenceError, match="time_offset_s is nan"):
        SequenceOptions(poses=Path("a.tum"), time_offset_s=float("nan"))
