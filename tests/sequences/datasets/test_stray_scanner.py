"""Stray Scanner in its published form -> images, poses, cameras and stamps."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from sequences.datasets.frames import posed_frames
from sequences.datasets.listing import list_images
from sequences.files import UNUSABLE
from tests.helpers.dot_scene import (
    CX,
    CY,
    FX,
    FY,
    NUM,
    STRAY_TIMES,
    check,
    check_conversion,
    edit,
    leaves_out,
    make_stray,
    misses,
    refuse,
)


@pytest.mark.parametrize("video", [True, False])
def test_a_stray_scanner_recording_gives_the_frames_of_its_video_or_folder(video: bool, tmp_path: Path) -> None:
    folder = make_stray(tmp_path / "71de12f9", video=video)
    check(folder, list(range(NUM)), STRAY_TIMES, within_px=1.0)
    listed = list_images(folder)
    assert (listed.layout, listed.assumed_hz, listed.skipped) == ("Stray Scanner", None, {})
    check_conversion(folder, tmp_path, list(range(NUM)), within_px=1.0)


def test_frames_of_a_video_are_the_same_in_any_order_and_one_by_one(tmp_path: Path) -> None:
    folder = make_stray(tmp_path / "scan")
    images = list_images(folder)
    forwards = [file.read_bytes() for file in images.files]
    assert [images.files[i].read_bytes() for i in (4, 1, 3, 3, 0)] == [forwards[i] for i in (4, 1, 3, 3, 0)]
    some = list(posed_frames(folder, frames=slice(2, 5, 2)))
    assert [frame.time_ns for frame in some] == [STRAY_TIMES[2], STRAY_TIMES[4]]
    assert max(misses(frame).max() for frame in some) < 1.0


def test_images_in_a_container_are_told_apart_where_training_data_must_not_be_shared(tmp_path: Path) -> None:
    scan = make_stray(tmp_path / "scan")
    (tmp_path / "link").symlink_to(scan)
    assert {file.resolve() for file in list_images(scan).files} == {
        file.resolve() for file in list_images(tmp_path / "link").files
    }
    first, last = list_images(scan)[:2].files, list_images(scan)[2:].files
    assert not set(first) & set(last)


def test_what_a_stray_scanner_recording_leaves_out_is_counted(tmp_path: Path) -> None:
    folder = make_stray(tmp_path / "scan", extra=2)
    rows = (folder / "odometry.csv").read_text().splitlines()
    rows[2] = ", ".join([*rows[2].split(", ")[:3], "nan", *rows[2].split(", ")[4:]])  # frame 1
    rows[4] = f"{rows[1].split(', ')[0]}, {', '.join(rows[4].split(', ')[1:])}"  # frame 3, at the time of frame 0
    rows.append(rows[5].replace("000004", "000099").replace("25841.", "25849."))
    (folder / "odometry.csv").write_text("\n".join(rows))
    check(folder, [0, 2, 4], [STRAY_TIMES[i] for i in (0, 2, 4)], within_px=1.0)
    assert list_images(folder).skipped == {
        "true pose not finite": 1,
        "time stamp not increasing": 1,
        "no image": 1,
        "no true pose": 2,
    }


def test_rows_with_intrinsics_of_their_own_give_the_medians(tmp_path: Path) -> None:
    folder = make_stray(tmp_path / "scan")
    rows = (folder / "odometry.csv").read_text().splitlines()
    rows = [rows[0] + ", fx, fy, cx, cy"] + [f"{r}, {FX + i - 2}, {FY}, {CX}, {CY}" for i, r in enumerate(rows[1:])]
    (folder / "odometry.csv").write_text("\n".join(rows))
    np.savetxt(folder / "camera_matrix.csv", [[1, 0, CX], [0, 2, CY], [0, 0, 1]], delimiter=",")
    check(folder, list(range(NUM)), STRAY_TIMES, within_px=1.0)


@pytest.mark.parametrize(
    ("file", "change", "said"),
    [
        ("odometry.csv", lambda text: text.split("\n", 1)[1], "odometry.csv:1: '25841.123456789, 000000"),
        ("odometry.csv", lambda text: text.replace("000002", "000001"), "odometry.csv:4: frame 1 is on line 3 too"),
        ("odometry.csv", lambda text: "", "odometry.csv: empty, expected the header"),
        ("camera_matrix.csv", lambda text: text.split("\n", 1)[1], "rows of [3, 3] columns, expected a 3 x 3"),
        ("camera_matrix.csv", lambda text: text.replace("83.0", "9e9"), "camera_matrix.csv: fx 110, fy 104, cx inf"),
        ("camera_matrix.csv", lambda text: text.replace("110.0", "x"), "camera_matrix.csv:1: 'x00000' is no number"),
    ],
)
def test_what_is_wrong_with_a_stray_scanner_recording_is_said(
    file: str, change: Callable[[str], str], said: str, tmp_path: Path
) -> None:
    folder = make_stray(tmp_path / "scan")
    edit(folder / file, change)
    refuse(folder, said)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda text: text + ", 1", "odometry.csv:6: 10 columns, expected the 9 of the header"),
        (lambda text: text.replace("000002", "two"), "odometry.csv:4: number of a frame: 'two', expected a whole"),
        (lambda text: text.replace("25841.1234", "yesterday"), "odometry.csv:2: time 'yesterday"),
        (lambda text: text.rsplit(", ", 1)[0] + ", 7", "odometry.csv:6: quaternion of length 7"),
    ],
)
def test_a_row_of_stray_scanner_that_cannot_be_used_is_left_out_and_named(
    change: Callable[[str], str], said: str, tmp_path: Path
) -> None:
    folder = make_stray(tmp_path / "scan")
    edit(folder / "odometry.csv", change)
    listed = leaves_out(folder, NUM, said)
    assert (len(listed), listed.skipped[UNUSABLE]) == (NUM - 1, 1)


def test_a_video_that_is_cut_off_or_missing_is_said(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    folder = make_stray(tmp_path / "scan")
    content = (folder / "rgb.mp4").read_bytes()
    (folder / "rgb.mp4").write_bytes(content[: len(content) // 2])  # before its index, as of a phone that lost power
    refuse(folder, "rgb.mp4: cannot be opened as a video, expected a complete file")
    assert capfd.readouterr().err == ""
    (folder / "rgb.mp4").unlink()
    refuse(folder, "rgb.mp4: no such file, expected the video, or its frames in rgb/")
