"""Data sets of phones and laboratories, each written in its published form -> images, poses, cameras and stamps.

Images are synthetic: coloured dots, drawn by the projection that the format itself describes (see `dot_scene`).
"""

import json
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from filtering.se3 import Poses
from sequences.datasets.convert import convert
from sequences.datasets.frames import count_frames, posed_frames
from sequences.datasets.listing import list_images
from sequences.errors import SequenceError
from sequences.frame import Camera, Frame
from sequences.images.undistortion import Lens
from tests import dot_scene
from tests.dot_scene import CX, CY, FX, FY, HEIGHT, WIDTH, drawn, misses, opencv, opencv_pixels, opengl
from tests.phone_data_sets import (
    BEGIN_NS,
    EUROC_DISTORTION,
    GT_HEADER,
    NUM,
    R3D_SECONDS,
    STRAY_TIMES,
    make_colmap_binary,
    make_euroc,
    make_nerfstudio,
    make_r3d,
    make_record3d_export,
    make_stray,
    r3d_metadata,
    sensor_yaml,
)


def check(path: Path, indices: list[int], times_ns: list[int] | None, *, within_px: float = 0.7) -> list[Frame]:
    """Every dot is where the pose and the camera that were read put it, in all images, and these are of their times."""
    frames = list(posed_frames(path))
    assert count_frames(path) == len(indices) == len(frames)
    for index, frame in zip(indices, frames, strict=True):
        metres, radians = frame.world_from_camera.distance(dot_scene.true_pose(index))
        assert metres < 1e-5
        assert radians < 1e-5
        assert misses(frame).max() < within_px
    if times_ns is not None:
        assert [frame.time_ns for frame in frames] == times_ns
    return frames


def check_conversion(path: Path, folder: Path, indices: list[int], *, within_px: float = 0.7) -> None:
    """What `convert` writes is read back as the same images, poses and times."""
    assert convert(path, folder / "out.mcap").num_images == len(indices)
    check(folder / "out.mcap", indices, [frame.time_ns for frame in posed_frames(path)], within_px=within_px)


def refuse(path: Path, *said: str) -> None:
    """Reading fails with one line that says all this."""
    with pytest.raises(SequenceError) as error:
        list_images(path)
    line = str(error.value)
    assert "\n" not in line
    for words in said:
        assert words in line, line


def edit(file: Path, change: Callable[[str], str]) -> None:
    before = file.read_text()
    after = change(before)
    assert after != before
    file.write_text(after)


def edit_json(file: Path, change: Callable[[dict], object]) -> None:
    content = json.loads(file.read_text())
    change(content)
    file.write_text(json.dumps(content))


# --- EuRoC MAV -------------------------------------------------------------------------------------

# Of the left camera of the published sequences: it is turned by a quarter about its axis against the body.


EUROC_TIMES = [BEGIN_NS + i * 50_000_000 for i in range(NUM - 1)]  # the truth ends before the last image


def test_euroc_images_have_the_interpolated_pose_of_the_left_camera(tmp_path: Path) -> None:
    folder = make_euroc(tmp_path / "MH_01")
    rows = (folder / "mav0" / "state_groundtruth_estimate0" / "data.csv").read_text().splitlines()
    images = [
        str(time_ns) for time_ns in EUROC_TIMES[1:]
    ]  # what lies on the images is taken out: no pose is only copied
    kept = [row for row in rows if row.split(",")[0] not in images]
    (folder / "mav0" / "state_groundtruth_estimate0" / "data.csv").write_text("\n".join(kept))
    frames = check_near(folder, [0, 1, 2, 3], EUROC_TIMES)
    assert list_images(folder).layout == "EuRoC MAV"
    assert list_images(folder).skipped == {"true pose does not cover": 1}
    assert [frame.time_ns for frame in posed_frames(folder / "mav0")] == [frame.time_ns for frame in frames]


def check_near(path: Path, indices: list[int], times_ns: list[int]) -> list[Frame]:
    """As `check`, but for corners between images that interpolation rounds off."""
    frames = list(posed_frames(path))
    assert [frame.time_ns for frame in frames] == times_ns
    for index, frame in zip(indices, frames, strict=True):
        metres, radians = frame.world_from_camera.distance(dot_scene.true_pose(index))
        assert metres < 0.005
        assert radians < 0.005
        assert misses(frame).max() < 1.0
    return frames


def test_euroc_is_converted_with_the_distortion_of_its_lens(tmp_path: Path) -> None:
    folder = make_euroc(tmp_path / "MH_01", distorted=True)
    lens = list_images(folder).cameras[0]
    assert isinstance(lens, Lens)
    assert (lens.model, lens.coefficients, lens.camera.fx) == ("plumb_bob", tuple(EUROC_DISTORTION), FX)
    check(folder, [0, 1, 2, 3], EUROC_TIMES)
    check_conversion(folder, tmp_path, [0, 1, 2, 3])
    plain = make_euroc(tmp_path / "plain")
    (plain / "mav0" / "cam0" / "sensor.yaml").write_text(sensor_yaml(EUROC_DISTORTION))
    assert max(misses(frame).max() for frame in posed_frames(plain)) > 1.0  # what undistortion is worth here


def test_euroc_truth_of_another_sensor_is_brought_to_the_body(tmp_path: Path) -> None:
    folder = make_euroc(tmp_path / "V1")
    truth = folder / "mav0" / "state_groundtruth_estimate0"
    body_from_sensor = Poses.exp(np.array([0.1, -0.2, 0.05, 0.3, -0.4, 0.9]))
    lines = (truth / "data.csv").read_text().splitlines()
    rows = [GT_HEADER]
    for line in lines[1:]:
        stamp, *values = line.split(",")
        x, y, z, w, qx, qy, qz = map(float, values[:7])
        pose = Poses.from_quat_xyzw(np.array([x, y, z]), np.array([qx, qy, qz, w])) @ body_from_sensor
        qx, qy, qz, w = pose.as_quat_xyzw()
        rows.append(f"{stamp}," + ",".join(f"{v:.9f}" for v in (*pose.translation, w, qx, qy, qz)))
    (truth / "data.csv").write_text("\n".join(rows))
    data = ", ".join(map(str, body_from_sensor.as_matrix().ravel().tolist()))
    (truth / "sensor.yaml").write_text(
        f"%YAML:1.0\n---\nT_BS: !!opencv-matrix\n   rows: 4\n   cols: 4\n   dt: d\n   data: [{data}]\n"
    )
    check(folder, [0, 1, 2, 3], EUROC_TIMES)


@pytest.mark.parametrize(
    ("file", "change", "said"),
    [
        ("cam0/data.csv", lambda text: text + "1,2,3\n", "data.csv:7: '1,2,3', expected `timestamp [ns],filename`"),
        ("cam0/data.csv", lambda text: text + "1.5,a.png\n", "data.csv:7: nanoseconds: '1.5', expected a whole number"),
        ("cam0/sensor.yaml", lambda text: text.replace("pinhole", "omni"), "camera_model 'omni', expected pinhole"),
        ("cam0/sensor.yaml", lambda text: text.replace("0.999557249008", ".nan"), "T_BS is not finite"),
        (
            "cam0/sensor.yaml",
            lambda text: text.replace("0.999557249008", "0.5"),
            "T_BS: the upper left 3 x 3 is no rot",
        ),
        ("cam0/sensor.yaml", lambda text: text.replace("T_BS", "T_SB"), "T_BS is None, expected its data: 16 numbers"),
        (
            "cam0/sensor.yaml",
            lambda text: text.replace(f"[{FX}, ", "["),
            "intrinsics is [104.0, 83.0, 57.0], expected 4",
        ),
        ("cam0/sensor.yaml", lambda text: text.replace(f"[{FX}", "[-1"), "camera with fx -1.0, expected between"),
        ("cam0/sensor.yaml", lambda text: text + "x: [\n", "sensor.yaml: while parsing"),
        (
            "cam0/sensor.yaml",
            lambda text: text.replace("radial-tangential", "fov").replace("[0.0, 0.0,", "[0.9, 0.0,"),
            "distortion_model 'fov', expected one of radial-tangential",
        ),
        ("state_groundtruth_estimate0/data.csv", lambda text: text.replace(",0.1", ",nan"), "no finite position"),
    ],
)
def test_what_is_wrong_with_a_euroc_sequence_is_said(
    file: str, change: Callable[[str], str], said: str, tmp_path: Path
) -> None:
    folder = make_euroc(tmp_path / "MH_01")
    if file.startswith("state"):

        def change(text: str) -> str:
            return text.replace(text.splitlines()[1].split(",")[2], "nan")

    edit(folder / "mav0" / file, change)
    refuse(folder, said)


def test_what_a_euroc_sequence_leaves_out_is_counted(tmp_path: Path) -> None:
    folder = make_euroc(tmp_path / "MH_01")
    data = folder / "mav0" / "cam0" / "data"
    (data / f"{EUROC_TIMES[1]}.png").unlink()
    dot_scene.write(data / "7.png", drawn(opencv(0), opencv_pixels))
    edit(folder / "mav0" / "cam0" / "data.csv", lambda text: text + f"{EUROC_TIMES[0]},{EUROC_TIMES[0]}.png\r\n")
    check(folder, [0, 2, 3], [EUROC_TIMES[i] for i in (0, 2, 3)])
    assert list_images(folder).skipped == {
        "no image": 1,
        "time stamp not increasing": 1,
        "true pose does not cover": 1,
        "image not in the list": 1,
    }
    (folder / "mav0" / "state_groundtruth_estimate0" / "data.csv").unlink()
    refuse(folder, "state_groundtruth_estimate0/data.csv: no such file, expected the true poses")


# --- Stray Scanner ---------------------------------------------------------------------------------


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
        ("odometry.csv", lambda text: text + ", 1", "odometry.csv:6: 10 columns, expected the 9 of the header"),
        (
            "odometry.csv",
            lambda text: text.replace("000002", "two"),
            "odometry.csv:4: number of a frame: 'two', expected a whole number",
        ),
        ("odometry.csv", lambda text: text.replace("000002", "000001"), "odometry.csv:4: frame 1 is on line 3 too"),
        ("odometry.csv", lambda text: text.replace("25841.1234", "yesterday"), "odometry.csv:2: time 'yesterday"),
        ("odometry.csv", lambda text: text.rsplit(", ", 1)[0] + ", 7", "odometry.csv:6: quaternion of length 7"),
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


def test_a_video_that_is_cut_off_or_missing_is_said(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    folder = make_stray(tmp_path / "scan")
    content = (folder / "rgb.mp4").read_bytes()
    (folder / "rgb.mp4").write_bytes(content[: len(content) // 2])  # before its index, as of a phone that lost power
    refuse(folder, "rgb.mp4: cannot be opened as a video, expected a complete file")
    assert capfd.readouterr().err == ""
    (folder / "rgb.mp4").unlink()
    refuse(folder, "rgb.mp4: no such file, expected the video, or its frames in rgb/")


# --- Record3D --------------------------------------------------------------------------------------

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
        (lambda m: m["poses"][2].pop(), "poses[2]: 6 columns, expected the 7 of `qx qy qz qw tx ty tz`"),
        (lambda m: m["poses"].__setitem__(2, "x"), "poses[2]: 'x', expected a row"),
        (lambda m: m["poses"].__setitem__(2, [0] * 7), "poses[2]: quaternion of length 0"),
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


def test_a_record3d_file_that_is_cut_off_is_said(tmp_path: Path) -> None:
    file = make_r3d(tmp_path / "a.r3d", r3d_metadata())
    file.write_bytes(file.read_bytes()[:-300])
    refuse(file, "a.r3d: cannot be read as a zip archive")
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("other", "")
    refuse(file, "member 'metadata' cannot be read")


# --- nerfstudio ------------------------------------------------------------------------------------


THIRTIETHS = [i * 1_000_000_000 // 30 for i in range(NUM)]


def test_a_nerfstudio_folder_gives_its_images_in_the_order_of_their_names(tmp_path: Path) -> None:
    folder = make_nerfstudio(tmp_path / "scene")
    check(folder, list(range(NUM)), THIRTIETHS, within_px=0.4)
    listed = list_images(folder)
    assert (listed.layout, listed.assumed_hz, listed.skipped) == ("nerfstudio", 30, {})
    check_conversion(folder, tmp_path, list(range(NUM)), within_px=0.4)


def test_nerfstudio_intrinsics_of_single_frames_and_of_names_without_a_suffix(tmp_path: Path) -> None:
    folder = make_nerfstudio(tmp_path / "scene")

    def change(content: dict) -> None:
        for key in ("fl_x", "fl_y", "cx", "cy", "w", "h"):
            value = content.pop(key)
            for frame in content["frames"]:
                frame[key] = value
        for frame in content["frames"]:
            frame["file_path"] = "./" + frame["file_path"].removesuffix(".png")

    edit_json(folder / "transforms.json", change)
    (folder / "transforms.json").rename(folder / "transforms_train.json")
    check(folder / "transforms_train.json", list(range(NUM)), THIRTIETHS, within_px=0.4)
    with pytest.raises(SequenceError, match="looked for"):
        list_images(folder)


def test_nerfstudio_camera_angle_and_applied_scale(tmp_path: Path) -> None:
    folder = make_nerfstudio(tmp_path / "scene")

    def change(content: dict) -> None:
        del content["fl_x"], content["w"], content["h"]
        content.update(camera_angle_x=2 * np.arctan(WIDTH / 2 / FX), applied_scale=0.25)
        for frame in content["frames"]:
            for row in frame["transform_matrix"][:3]:
                row[3] *= 0.25

    edit_json(folder / "transforms.json", change)
    check(folder, list(range(NUM)), THIRTIETHS, within_px=0.4)


def test_nerfstudio_distortion_is_in_opencv_s_order(tmp_path: Path) -> None:
    folder = make_nerfstudio(tmp_path / "scene")
    numbers = {"k1": 0.1, "k2": 0.02, "k3": 0.003, "p1": 0.004, "p2": 0.005}
    edit_json(folder / "transforms.json", lambda content: content.update(numbers))
    lens = list_images(folder).cameras[0]
    assert isinstance(lens, Lens)
    assert (lens.model, lens.coefficients) == ("plumb_bob", (0.1, 0.02, 0.004, 0.005, 0.003))
    fisheye = {"camera_model": "OPENCV_FISHEYE", "k4": 0.006}
    edit_json(folder / "transforms.json", lambda content: content.update(fisheye))
    lens = list_images(folder).cameras[0]
    assert isinstance(lens, Lens)
    assert (lens.model, lens.coefficients) == ("equidistant", (0.1, 0.02, 0.003, 0.006))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            lambda c: c.update(camera_model="EQUIRECTANGULAR"),
            "frames[0]: camera_model 'EQUIRECTANGULAR', expected one of",
        ),
        (lambda c: c.update(k4=0.1), "frames[0]: k4 of OPENCV is not 0"),
        (lambda c: c.update(fl_x="long"), "frames[0]: fl_x is 'long', expected a number"),
        (lambda c: c.update(w=-4), "frames[0]: w is -4, expected a number between"),
        (lambda c: c["frames"][1].pop("file_path"), "frames[1]: no file_path"),
        (lambda c: c["frames"].append(c["frames"][0]), "frames[5]: 'images/frame_11.png' for the second time"),
        (lambda c: c["frames"][2].pop("transform_matrix"), "frames[2]: transform_matrix: shape ()"),
        (lambda c: c["frames"][2]["transform_matrix"].pop(), "frames[2]: transform_matrix: shape (3, 4)"),
        (lambda c: c["frames"][2]["transform_matrix"][0].__setitem__(0, 9), "frames[2]: transform_matrix: the upper"),
        (lambda c: c.update(frames=7), "no list of frames"),
        (lambda c: c.update(applied_scale=0), "applied_scale is 0, expected a number between"),
    ],
)
def test_what_is_wrong_with_a_nerfstudio_file_is_said(
    change: Callable[[dict], object], said: str, tmp_path: Path
) -> None:
    folder = make_nerfstudio(tmp_path / "scene")
    edit_json(folder / "transforms.json", change)
    refuse(folder, "transforms.json", said)


def test_what_a_nerfstudio_file_leaves_out_is_counted(tmp_path: Path) -> None:
    folder = make_nerfstudio(tmp_path / "scene")

    def change(content: dict) -> None:
        content["frames"][0]["file_path"] = "images/gone.png"  # in place of frame 3
        content["frames"][1]["transform_matrix"][0][3] = float("nan")  # frame 0

    edit_json(folder / "transforms.json", change)
    assert list_images(folder).skipped == {"no image": 1, "true pose not finite": 1, "image not in the list": 1}
    (folder / "transforms.json").write_text("{")
    refuse(folder, "transforms.json: ", "expected JSON")


# --- COLMAP's binary model -------------------------------------------------------------------------


def test_a_binary_colmap_model_gives_what_it_says(tmp_path: Path) -> None:
    root = make_colmap_binary(tmp_path / "scene")
    check(root, list(range(NUM)), THIRTIETHS, within_px=0.4)
    assert list_images(root).layout == "COLMAP"
    (root / "sparse" / "0" / "images.txt").write_text("stale")
    (root / "sparse" / "0" / "cameras.txt").write_text("stale")
    check_conversion(root, tmp_path, list(range(NUM)), within_px=0.4)


@pytest.mark.parametrize(
    ("file", "change", "said"),
    [
        ("images.bin", lambda data: data[:-1], "images.bin: ends at byte"),
        ("images.bin", lambda data: data[:30], "images.bin: ends at byte 30 within a record"),
        ("images.bin", lambda data: data[:8] + data[8:].replace(b"\0", b"\1"), "images.bin: ends at byte"),
        ("images.bin", lambda data: b"", "images.bin: ends at byte 0 within a record"),
        ("images.bin", lambda data: data.replace("ü".encode(), b"\xff\xff"), "is no UTF-8 text"),
        ("images.bin", lambda data: data.replace(b"9 b.png", b"8 b.png"), "8 b.png' is image 2 too, expected it once"),
        (
            "cameras.bin",
            lambda data: data[:12] + b"\x63" + data[13:],
            "cameras.bin:1: camera model 99, expected one of",
        ),
        ("cameras.bin", lambda data: data[:-8], "cameras.bin: ends at byte"),
        ("cameras.bin", lambda data: data[:8] + b"\x08" + data[9:], "camera '7', expected one of those in cameras.bin"),
    ],
)
def test_what_is_wrong_with_a_binary_colmap_model_is_said(
    file: str, change: Callable[[bytes], bytes], said: str, tmp_path: Path
) -> None:
    root = make_colmap_binary(tmp_path / "scene")
    path = root / "sparse" / "0" / file
    path.write_bytes(change(path.read_bytes()))
    refuse(root, said)


# --- all of them -----------------------------------------------------------------------------------


def test_the_dots_tell_one_convention_from_another() -> None:
    """The check itself can fail: other axes, another pose or the inverse put no dot where it is."""
    image = drawn(opencv(1), opencv_pixels)[..., ::-1]
    camera = Camera(WIDTH, HEIGHT, FX, FY, CX, CY)
    assert misses(Frame(0, image, None, dot_scene.true_pose(1), camera)).max() < 0.3
    for matrix in (opengl(1), opencv(2), np.linalg.inv(opencv(1))):
        assert misses(Frame(0, image, None, Poses.from_matrix(matrix), camera)).max() > 2.0


def test_a_folder_of_no_layout_is_told_of_these_too(tmp_path: Path) -> None:
    refuse(tmp_path, "mav0/cam0/data.csv", "odometry.csv", ".r3d", "transforms.json", "images.bin")
