"""nerfstudio in its published form -> images, poses, cameras and stamps."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from sequences.datasets.listing import list_images
from sequences.errors import SequenceError
from sequences.files import UNUSABLE
from sequences.frame import Camera
from sequences.images.undistortion import Lens
from tests.helpers.dot_scene import (
    FX,
    NUM,
    THIRTIETHS,
    WIDTH,
    check,
    check_conversion,
    edit_json,
    leaves_out,
    make_nerfstudio,
    refuse,
)


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


@pytest.mark.parametrize("named", [{"camera_model": "OPENCV_FISHEYE"}, {"is_fisheye": True}])
@pytest.mark.parametrize("numbers", [{"k1": 0.1, "k2": 0.02, "k3": 0.003, "k4": 0.006}, {}])
@pytest.mark.parametrize("per_frame", [False, True])
def test_a_fisheye_is_equidistant_whoever_names_it_so(
    named: dict, numbers: dict, per_frame: bool, tmp_path: Path
) -> None:
    folder = make_nerfstudio(tmp_path / "scene")

    def change(content: dict) -> None:
        del content["camera_model"]
        for place in content["frames"] if per_frame else [content]:
            place.update(named | numbers)

    edit_json(folder / "transforms.json", change)
    for lens in list_images(folder).cameras:
        assert isinstance(lens, Lens)
        assert (lens.model, lens.coefficients) == ("equidistant", tuple(numbers.values()) or (0, 0, 0, 0))


def test_frames_of_a_fisheye_and_a_pinhole_camera_each_have_their_own(tmp_path: Path) -> None:
    folder = make_nerfstudio(tmp_path / "scene")

    def change(content: dict) -> None:
        del content["camera_model"]
        content["frames"][1].update(is_fisheye=True, k1=0.1, fl_x=150.0)  # the first by its name

    edit_json(folder / "transforms.json", change)
    first, second, *_ = list_images(folder).cameras
    assert isinstance(first, Lens)
    assert isinstance(second, Camera)
    assert (first.model, first.camera.fx, second.fx) == ("equidistant", 150.0, FX)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            lambda c: c.update(camera_model="EQUIRECTANGULAR"),
            "frames[0]: camera_model 'EQUIRECTANGULAR', expected perspective images, as `ns-process-data images",
        ),
        (
            lambda c: (c.pop("camera_model"), c.update(latlong=True)),
            "frames[0]: camera_model 'latlong', expected per",
        ),
        (lambda c: c.update(camera_model="FISHEYE624"), "camera_model 'FISHEYE624', expected one of SIMPLE_PINHOLE"),
        (lambda c: c.update(is_fisheye=True), "frames[0]: camera_model OPENCV and is_fisheye, expected OPENCV_FISHEYE"),
        (lambda c: c.update(is_fisheye="yes"), "frames[0]: is_fisheye is 'yes', expected true or false"),
        (lambda c: c.update(camera_model="OPENCV_FISHEYE", p1=0.1), "frames[0]: p1 of OPENCV_FISHEYE is not 0"),
        (lambda c: c.update(k4=0.1), "frames[0]: k4 of OPENCV is not 0"),
        (lambda c: c.update(fl_x="long"), "frames[0]: fl_x is 'long', expected a number"),
        (lambda c: c.update(w=-4), "frames[0]: w is -4, expected a number between"),
        (lambda c: c["frames"][1].pop("file_path"), "frames[1]: no file_path"),
        (lambda c: c["frames"].append(c["frames"][0]), "frames[5]: 'images/frame_11.png' for the second time"),
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


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda frame: frame.pop("transform_matrix"), "frames[2]: transform_matrix: shape ()"),
        (lambda frame: frame["transform_matrix"].pop(), "frames[2]: transform_matrix: shape (3, 4)"),
        (lambda frame: frame["transform_matrix"][0].__setitem__(0, 9), "frames[2]: transform_matrix: the upper"),
    ],
)
def test_a_pose_of_nerfstudio_that_cannot_be_used_is_left_out_and_named(
    change: Callable[[dict], object], said: str, tmp_path: Path
) -> None:
    folder = make_nerfstudio(tmp_path / "scene")
    edit_json(folder / "transforms.json", lambda content: change(content["frames"][2]))
    listed = leaves_out(folder, NUM, "transforms.json", said)
    assert (len(listed), listed.skipped) == (NUM - 1, {UNUSABLE: 1})


def test_what_a_nerfstudio_file_leaves_out_is_counted(tmp_path: Path) -> None:
    folder = make_nerfstudio(tmp_path / "scene")

    def change(content: dict) -> None:
        content["frames"][0]["file_path"] = "images/gone.png"  # in place of frame 3
        content["frames"][1]["transform_matrix"][0][3] = float("nan")  # frame 0

    edit_json(folder / "transforms.json", change)
    assert list_images(folder).skipped == {"no image": 1, "true pose not finite": 1, "image not in the list": 1}
    (folder / "transforms.json").write_text("{")
    refuse(folder, "transforms.json: ", "expected JSON")
