"""Trajectories as text."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from filtering.se3 import Poses
from sequences.errors import SequenceError
from sequences.frame import Trajectory
from sequences.trajectories import tum
from sequences.trajectories.tum import format_time, read_tum, write_tum
from sequences.values import parse_time_ns

GOOD = "1.0 0 0 0 0 0 0 1"


def test_a_trajectory_survives_its_file(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    times_ns = 1_700_000_000_000_000_001 + np.cumsum(rng.integers(1, 10**9, 50))
    poses = Poses.exp(rng.normal(scale=2.0, size=(50, 6)))
    write_tum(tmp_path / "t.tum", Trajectory(times_ns, poses))
    back = read_tum(tmp_path / "t.tum")
    np.testing.assert_array_equal(back.times_ns, times_ns)
    np.testing.assert_allclose(back.poses.as_matrix(), poses.as_matrix(), atol=5e-9)
    assert [path.name for path in tmp_path.iterdir()] == ["t.tum"]


def test_evo_reads_what_is_written_and_its_own_files_are_read(tmp_path: Path) -> None:
    evo = pytest.importorskip("evo.tools.file_interface", reason="evo is an extra: GPL")
    times_ns = 1_700_000_000_000_000_000 + 50_000_000 * np.arange(20)
    poses = Poses.exp(np.random.default_rng(0).normal(scale=2.0, size=(20, 6)))
    write_tum(tmp_path / "ours.tum", Trajectory(times_ns, poses))
    theirs = evo.read_tum_trajectory_file(tmp_path / "ours.tum")
    np.testing.assert_allclose(theirs.poses_se3, poses.as_matrix(), atol=5e-9)
    np.testing.assert_allclose(theirs.timestamps, times_ns * 1e-9, atol=1e-6)
    evo.write_tum_trajectory_file(tmp_path / "theirs.tum", theirs)
    back = read_tum(tmp_path / "theirs.tum")
    np.testing.assert_allclose(back.poses.as_matrix(), poses.as_matrix(), atol=1e-8)
    assert np.abs(back.times_ns - times_ns).max() < 1000  # evo has seconds as floats


@given(st.integers(-(2**62), 2**62))
def test_times_lose_no_nanosecond(time_ns: int) -> None:
    assert parse_time_ns(format_time(time_ns), "") == time_ns


@pytest.mark.parametrize(
    ("text", "time_ns"),
    [
        ("1305031102.175304", 1305031102175304000),
        ("1.305031102160407066e+09", 1305031102160407066),
        ("3", 3_000_000_000),
        ("-0.5", -500_000_000),
        ("0.1234567894", 123456789),
    ],
)
def test_times_are_read_as_others_write_them(text: str, time_ns: int) -> None:
    assert parse_time_ns(text, "") == time_ns


def test_comments_and_empty_lines_are_passed_over(tmp_path: Path) -> None:
    path = tmp_path / "t.tum"
    path.write_text(f"# time tx ty\n\n{GOOD}\n  # more\n2.0 1 2 3 0 0 2 0\n")
    trajectory = read_tum(path)
    assert len(trajectory) == 2
    # The quaternion of length 2 is a half turn about z.
    np.testing.assert_allclose(trajectory.poses[1].apply(np.array([1.0, 1, 1])), [0, 1, 4], atol=1e-12)


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("2.0 0 0 0 0 0 1", "7 columns, expected the eight"),
        ("2.0,0,0,0,0,0,0,1", "1 columns"),
        ("2.0 0 0 x 0 0 0 1", "'x' is no number"),
        ("two 0 0 0 0 0 0 1", "time 'two'"),
        ("nan 0 0 0 0 0 0 1", "time 'nan'"),
        ("2.0 0 nan 0 0 0 0 1", "not finite"),
        ("2.0 0 0 0 0 0 0 0", "zero length"),
        ("1.0 0 0 0 0 0 0 1", "not after"),
        ("0.5 0 0 0 0 0 0 1", "not after"),
    ],
)
def test_a_bad_line_is_named_with_its_number(line: str, said: str, tmp_path: Path) -> None:
    path = tmp_path / "t.tum"
    path.write_text(f"# comment\n{GOOD}\n{line}\n3.0 0 0 0 0 0 0 1\n")
    with pytest.raises(SequenceError, match=rf"t\.tum:3: .*{said}"):
        read_tum(path)


def test_files_that_are_missing_or_no_text_are_named(tmp_path: Path) -> None:
    with pytest.raises(SequenceError, match=r"t\.tum: cannot read: No such file"):
        read_tum(tmp_path / "t.tum")
    (tmp_path / "b.tum").write_bytes(b"\xff\xfe\x00\x81")
    with pytest.raises(SequenceError, match=r"b\.tum:1: byte 0 is no UTF-8"):
        read_tum(tmp_path / "b.tum")


def test_a_missing_folder_is_named_and_nothing_is_left_of_a_failed_write(tmp_path: Path, monkeypatch) -> None:
    with pytest.raises(SequenceError, match="expected the folder"):
        write_tum(tmp_path / "nowhere" / "t.tum", Trajectory(np.zeros(0, np.int64), Poses.identity(0)))
    (tmp_path / "t.tum").write_text("before")

    def full(time_ns: int) -> str:
        if time_ns == 2:
            raise OSError("no space left")
        return format_time(time_ns)

    monkeypatch.setattr(tum, "format_time", full)
    with pytest.raises(SequenceError, match="no space left"):
        write_tum(tmp_path / "t.tum", Trajectory(np.array([1, 2]), Poses.identity(2)))
    assert (tmp_path / "t.tum").read_text() == "before"
    assert [path.name for path in tmp_path.iterdir()] == ["t.tum"]


def test_real_trajectories_are_read(shared_data: Path) -> None:
    folder = shared_data / "tum_fr1" / "rgbd_dataset_freiburg1_xyz"
    truth = read_tum(folder / "groundtruth.txt")
    assert len(truth) == 3000
    assert truth.times_ns[0] == 1305031098665900000
    np.testing.assert_allclose(truth.poses[0].translation, [1.3563, 0.6305, 1.6380])


def test_a_trajectory_has_as_many_times_as_poses(unchecked):
    with pytest.raises(SequenceError, match=r"shapes \(2,\) and \(3,\), expected \(n,\) both"):
        Trajectory(np.arange(2), Poses.identity(3))
