"""Record3D in its published form -> images, poses, cameras and stamps."""

import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest

from sequences.datasets.listing import list_images
from sequences.files import UNUSABLE
from tests.helpers.dot_scene import (
    NUM,
    R3D_SECONDS,
    check,
    check_conversion,
    leaves_out,
    make_r3d,
    make_record3d_export,
    r3d_metadata,
    refuse,
)

R3D_TIMES = [round(seconds * 1e9) for seconds in R3D_SECONDS]


def test_a_record3d_file_is_read_as_it_is_exported(tmp_path: Path) -> None:
    file = make_r3d(tmp_path / "2024-05-14--10-11-12.r3d", r3d_metadata())
    check(file, list(range(NUM)), R3D_TIMES, within_px=1.0)
    listed = list_images(file)
    assert (listed.layout, listed.assumed_hz, listed.skipped) == ("Record3D", None, {})
    assert str(listed.files[1]) == f"{file}:rgbd/1.jpg"
    check_conversion(file, tmp_path, list(range(NUM)), within_px=1.0)


def test_a_record3d_export_without_stamps_and_intrinsics_of_each_frame(tmp_path: Path) -> None:
    metadata = r3d_metadata()
    del metadata["frameTimestamps"], metadata["perFrameIntrinsicCoeffs"]
    folder = make_record3d_export(tmp_path / "export", metadata)
    check(folder, list(range(NUM)), [round(i * 1e9 / 60) for i in range(NUM)], within_px=1.0)
    assert list_images(folder).assumed_hz == 60
    (folder / "rgb").rename(folder / "rgbd")
    (folder / "metadata.json").rename(folder / "metadata")  # an .r3d that was unpacked
    check(folder, list(range(NUM)), None, within_px=1.0)


def test_what_a_record3d_recording_leaves_out_is_counted(tmp_path: Path) -> None:
    metadata = r3d_metadata()
    metadata["poses"] = metadata["poses"][:4]
    metadata["poses"][1][2] = float("nan")
    metadata["frameTimestamps"] = [1.0, 1.1, 1.2, 1.2]
    file = make_r3d(tmp_path / "a.r3d", metadata)
    check(file, [0, 2], [1_000_000_000, 1_200_000_000], within_px=1.0)
    counted = {"no true pose": 1, "true pose not finite": 1, "time stamp not increasing": 1}
    assert list_images(file).skipped == counted


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda m: m.pop("poses"), "no list of poses"),
        (lambda m: m["frameTimestamps"].pop(), "frameTimestamps of shape (4,), expected 5 numbers"),
        (lambda m: m.update(frameTimestamps=True), "frameTimestamps of shape (), expected 5 numbers"),
        (lambda m: m.update(frameTimestamps=None, fps=0), "fps is 0, expected a number between 0.1 and 1000"),
        (lambda m: m.update(perFrameIntrinsicCoeffs=[[1, 2, 3]]), "expected a row `fx fy cx cy` a frame"),
        (lambda m: m.update(perFrameIntrinsicCoeffs=[], K=[1, 2]), "K of shape (2,), expected the nine"),
        (lambda m: m.pop("w"), "width is None, expected a number"),
        (lambda m: m.update(h=0), "camera with height 0, expected between"),
    ],
)
def test_what_is_wrong_with_a_record3d_recording_is_said(
    change: Callable[[dict], object], said: str, tmp_path: Path
) -> None:
    metadata = r3d_metadata()
    change(metadata)
    refuse(make_r3d(tmp_path / "a.r3d", metadata), "a.r3d:metadata", said)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda m: m["poses"][2].pop(), "poses[2]: 6 columns, expected the 7 of `qx qy qz qw tx ty tz`"),
        (lambda m: m["poses"].__setitem__(2, "x"), "poses[2]: 'x', expected a row"),
        (lambda m: m["poses"].__setitem__(2, [0] * 7), "poses[2]: quaternion of length 0"),
    ],
)
def test_a_pose_of_record3d_that_cannot_be_used_is_left_out_and_named(
    change: Callable[[dict], object], said: str, tmp_path: Path
) -> None:
    metadata = r3d_metadata()
    change(metadata)
    listed = leaves_out(make_r3d(tmp_path / "a.r3d", metadata), NUM, "a.r3d:metadata", said)
    assert (len(listed), listed.skipped) == (NUM - 1, {UNUSABLE: 1})


def test_a_record3d_file_that_is_cut_off_is_said(tmp_path: Path) -> None:
    file = make_r3d(tmp_path / "a.r3d", r3d_metadata())
    file.write_bytes(file.read_bytes()[:-300])
    refuse(file, "a.r3d: cannot be read as a zip archive")
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("other", "")
    refuse(file, "member 'metadata' cannot be read")
