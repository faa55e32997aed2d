"""EuRoC MAV in its published form -> images, poses, cameras and stamps."""

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from filtering.se3 import Poses
from sequences.datasets.convert import convert
from sequences.datasets.frames import posed_frames
from sequences.datasets.listing import list_images
from sequences.frame import Frame
from sequences.images.undistortion import Lens
from sequences.reader import SequenceReader
from tests.helpers import dot_scene
from tests.helpers.dot_scene import (
    BEGIN_NS,
    EUROC_DISTORTION,
    FX,
    GT_HEADER,
    NUM,
    check,
    check_conversion,
    drawn,
    edit,
    leaves_out,
    make_euroc,
    misses,
    opencv,
    opencv_pixels,
    refuse,
    sensor_yaml,
)

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
    assert list_images(folder).skipped == {"no true pose near its time": 1}
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
        ("state_groundtruth_estimate0/data.csv", lambda text: text.replace(",", ",nan,"), "no finite position"),
    ],
)
def test_what_is_wrong_with_a_euroc_sequence_is_said(
    file: str, change: Callable[[str], str], said: str, tmp_path: Path
) -> None:
    folder = make_euroc(tmp_path / "MH_01")
    edit(folder / "mav0" / file, change)
    refuse(folder, said)


@pytest.mark.parametrize(
    ("file", "change", "num_rows", "said"),
    [
        ("cam0/data.csv", lambda rows: [*rows, "1,2,3"], 6, "data.csv:7: '1,2,3', expected `timestamp [ns],filename`"),
        ("cam0/data.csv", lambda rows: [*rows, "1.5,a.png"], 6, "data.csv:7: nanoseconds: '1.5', expected a whole"),
        (
            "state_groundtruth_estimate0/data.csv",
            lambda rows: [*rows[:3], rows[3].replace(",", ",nan,"), *rows[4:]],
            40,
            "data.csv:4: [nan, ",
        ),
    ],
)
def test_a_row_of_a_euroc_list_that_cannot_be_used_is_left_out_and_named(
    file: str, change: Callable[[list[str]], list[str]], num_rows: int, said: str, tmp_path: Path
) -> None:
    folder = make_euroc(tmp_path / "MH_01")
    edit(folder / "mav0" / file, lambda text: "\n".join(change(text.splitlines())))
    assert len(leaves_out(folder, num_rows, said)) == NUM - 1


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
        "no true pose near its time": 1,
        "image not in the list": 1,
    }
    (folder / "mav0" / "state_groundtruth_estimate0" / "data.csv").unlink()
    refuse(folder, "state_groundtruth_estimate0/data.csv: no such file, expected the true poses")


def test_both_cameras_of_euroc_are_converted_with_their_mounts(tmp_path: Path) -> None:
    folder = make_euroc(tmp_path / "MH_01")
    mav, moved = folder / "mav0", Poses.exp(np.array([0.11, 0.0, 0.01, 0.0, 0.02, 0.0]))
    shutil.copytree(mav / "cam0", mav / "cam1")
    body_from_left = np.array(dot_scene.T_BS).reshape(4, 4)
    body_from_right = body_from_left @ moved.as_matrix()
    text = sensor_yaml([0.0] * 4)
    numbers = ", ".join(f"{value!r}" for value in body_from_right.reshape(-1).tolist())
    begin, end = text.index("data: [") + 7, text.index("]", text.index("data: ["))
    (mav / "cam1" / "sensor.yaml").write_text(text[:begin] + numbers + text[end:])
    (more, mount) = list_images(folder).others["cam1"]
    assert len(more) == len(EUROC_TIMES)
    assert mount.distance(moved)[0] < 1e-6
    summary = convert(folder, tmp_path / "both.mcap")
    assert summary.num_images == 2 * len(EUROC_TIMES)
    reader = SequenceReader(tmp_path / "both.mcap", odometry="unread")
    frames = list(reader)
    assert reader.camera_names == ("/camera/image/compressed", "/camera_cam1/image/compressed")
    for left, right in zip(frames[::2], frames[1::2], strict=True):
        np.testing.assert_array_equal(left.image, right.image)
        assert (left.camera_name, right.camera_name) == reader.camera_names
        assert right.reference_from_camera is not None
        assert right.reference_from_camera.distance(moved)[0] < 1e-6
