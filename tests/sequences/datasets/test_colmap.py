"""COLMAP's models as text: images, cameras, and what is wrong with them."""

import struct
from pathlib import Path

import numpy as np
import pytest

from sequences.datasets.convert import convert
from sequences.datasets.frames import posed_frames
from sequences.datasets.layout_helpers.colmap_binary import NUM_PARAMETERS
from sequences.datasets.listing import list_images
from sequences.errors import SequenceError
from sequences.files import UNUSABLE
from sequences.frame import Camera
from sequences.images.decoding import decode_image_bytes
from sequences.images.undistortion import Lens, pinhole_of, undistorted
from sequences.options import SequenceOptions
from sequences.reader import SequenceReader
from tests.helpers.data_sets import COLMAP_NAMES, THIRTIETH_NS, check, colmap_row, make_colmap, true_pose, write_images
from tests.helpers.dot_scene import leaves_out


@pytest.mark.parametrize(
    ("model", "images", "path"),
    [
        ("sparse/0", "images", "."),
        ("sparse", "images", "."),
        ("sparse/0", "images", "sparse/0"),
        ("model", "images", "model"),
        ("model", "model", "model"),
        ("model", ".", "model"),
        ("model", "model/images", "model"),
    ],
)
def test_a_colmap_model_gives_images_wherever_they_lie(model: str, images: str, path: str, tmp_path: Path) -> None:
    root = make_colmap(tmp_path / "scene", model, images)
    check(root / path, [0, 1, 2], [0, THIRTIETH_NS, THIRTIETH_NS + 1e9])
    listed = list_images(root / path)
    assert (listed.layout, listed.skipped) == ("COLMAP", {})


def test_colmap_cameras_are_each_image_s_own_at_its_size(tmp_path: Path) -> None:
    root = make_colmap(tmp_path / "scene", "sparse/0", "images")
    found = [(c.width, c.height, c.fx, c.fy, c.cx, c.cy) for f in posed_frames(root) if (c := f.camera)]
    # Camera 1 at half its size; the middle of COLMAP's image, 16 and 12, is between the pixels 15 and 16, 11 and 12.
    assert found == [(32, 24, 30, 29, 15.5, 11.5)] * 2 + [(32, 24, 30, 30, 15.5, 11.5)]
    with pytest.raises(SequenceError, match="images of 2 cameras, expected one"):
        convert(root, tmp_path / "out.mcap")


@pytest.mark.parametrize(
    ("parameters", "focal", "distortion"),
    [
        ("SIMPLE_PINHOLE 32 24 30 16 12", (30.0, 30.0), None),
        ("PINHOLE 32 24 30 29 16 12", (30.0, 29.0), None),
        ("SIMPLE_RADIAL 32 24 30 16 12 0", (30.0, 30.0), None),
        ("SIMPLE_RADIAL 32 24 30 16 12 0.1", (30.0, 30.0), ("plumb_bob", 0.1, 0, 0, 0)),
        ("RADIAL 32 24 30 16 12 0.1 0.2", (30.0, 30.0), ("plumb_bob", 0.1, 0.2, 0, 0)),
        ("OPENCV 32 24 30 29 16 12 0.1 0.2 0.03 0.04", (30.0, 29.0), ("plumb_bob", 0.1, 0.2, 0.03, 0.04)),
        (
            "FULL_OPENCV 32 24 30 29 16 12 0.1 0.2 0.03 0.04 0.05 0.06 0.07 0.08",
            (30.0, 29.0),
            ("rational_polynomial", 0.1, 0.2, 0.03, 0.04, 0.05, 0.06, 0.07, 0.08),
        ),
        (
            "BROWN_CONRADY 32 24 30 16 12 0.1 0.2 0.05 0.03 0.04",
            (30.0, 30.0),
            ("plumb_bob", 0.1, 0.2, 0.03, 0.04, 0.05),
        ),
        ("SIMPLE_FISHEYE 32 24 30 16 12", (30.0, 30.0), ("equidistant", 0, 0, 0, 0)),
        ("FISHEYE 32 24 30 29 16 12", (30.0, 29.0), ("equidistant", 0, 0, 0, 0)),
        ("SIMPLE_RADIAL_FISHEYE 32 24 30 16 12 0", (30.0, 30.0), ("equidistant", 0, 0, 0, 0)),
        ("RADIAL_FISHEYE 32 24 30 16 12 0.1 0.2", (30.0, 30.0), ("equidistant", 0.1, 0.2, 0, 0)),
        ("OPENCV_FISHEYE 32 24 30 29 16 12 0.1 0.2 0.3 0.4", (30.0, 29.0), ("equidistant", 0.1, 0.2, 0.3, 0.4)),
    ],
)
def test_colmap_camera_models(
    parameters: str, focal: tuple[float, float], distortion: tuple | None, tmp_path: Path
) -> None:
    root = make_colmap(tmp_path / "scene", "sparse/0", "images")
    (root / "sparse" / "0" / "cameras.txt").write_text(f"1 {parameters}\n2 {parameters}\n")
    stated = Camera(32, 24, *focal, 15.5, 11.5)
    lens = Lens(stated, distortion[0], tuple(map(float, distortion[1:]))) if distortion else stated
    assert list_images(root).cameras == [lens] * 3
    shown = decode_image_bytes((root / "images" / COLMAP_NAMES[0]).read_bytes())
    frame = next(posed_frames(root))
    assert frame.camera == pinhole_of(lens)
    np.testing.assert_array_equal(frame.image, undistorted(shown, lens)[0])
    as_it_is = next(posed_frames(root, options=SequenceOptions(undistort=False)))
    assert as_it_is.camera == stated
    np.testing.assert_array_equal(as_it_is.image, shown)
    # Images are copied with their distortion, which is undone in reading.
    assert convert(root, tmp_path / "out.mcap").num_images == 3
    reader = SequenceReader(tmp_path / "out.mcap", odometry="unread")
    assert reader.camera is not None
    assert frame.camera is not None
    assert reader.camera.fx == pytest.approx(frame.camera.fx, rel=1e-6)
    np.testing.assert_array_equal(next(iter(reader)).image, frame.image)


@pytest.mark.parametrize(
    ("line", "said"),
    [
        (
            "1 NEWEST 32 24 30 29 16 12",
            "camera model 'NEWEST' cannot be undistorted here, expected one of",
        ),
        ("1 PINHOLE 32 24 30 16 12", "3 parameters, expected the 4 of PINHOLE"),
        ("1 PINHOLE 32", "3 columns, expected `CAMERA_ID MODEL WIDTH HEIGHT PARAMS"),
        ("1 PINHOLE 32 24 30 x 16 12", "'x' is no number"),
        ("1 PINHOLE 32 24 30 nan 16 12", "fy is nan, expected a number"),
        ("1 PINHOLE 32 24 30 0 16 12", "camera with fy 0.0, expected between"),
        ("2 PINHOLE 32 24 30 29 16 12", "camera '2' for the second time"),
    ],
)
def test_a_colmap_camera_that_is_wrong_is_named(line: str, said: str, tmp_path: Path) -> None:
    root = make_colmap(tmp_path / "scene", "sparse/0", "images")
    (root / "sparse" / "0" / "cameras.txt").write_text(f"# cameras\n2 SIMPLE_PINHOLE 32 24 30 16 12\n{line}\n")
    with pytest.raises(SequenceError, match=rf"cameras\.txt:3: .*{said}"):
        list_images(root)


REFUSED = {7: "FOV", 10: "THIN_PRISM_FISHEYE", 17: "EQUIRECTANGULAR"}


@pytest.mark.parametrize("suffix", [".txt", ".bin"])
@pytest.mark.parametrize("number", REFUSED)
def test_a_colmap_camera_that_cannot_be_undistorted_is_refused_by_name_with_a_way_out(
    number: int, suffix: str, tmp_path: Path
) -> None:
    root, name = make_colmap(tmp_path / "scene", "sparse/0", "images"), REFUSED[number]
    file = root / "sparse" / "0" / f"cameras{suffix}"
    parameters = [0.5] * NUM_PARAMETERS[name]
    file.write_text(f"1 {name} 32 24 {' '.join(map(str, parameters))}\n")
    if suffix == ".bin":
        (root / "sparse" / "0" / "images.bin").write_bytes(struct.pack("<Q", 0))
        file.write_bytes(struct.pack(f"<QiiQQ{len(parameters)}d", 1, 1, number, 32, 24, *parameters))
    way_out = "colmap image_undistorter .* --output_type COLMAP"
    with pytest.raises(SequenceError, match=rf"cameras\{suffix}:1: camera model '{name}' cannot .*{way_out}"):
        list_images(root)


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        (["1 1 0 0 0 0 0 0 1"], "1: 9 columns, expected the 10 of `id qw"),
        (["1 1 0 0 0 0 0 y 1 a/frame9.png", ""], "1: 'y' is no number"),
        (["1 0 0 0 0 0 0 0 1 a/frame9.png", ""], "1: quaternion of length 0"),
        (["1 1 0 0 0 0 0 0 7 a/frame9.png", ""], r"1: camera '7', expected one of those in cameras\.txt"),
        (
            ["1 1 0 0 0 0 0 0 1 a/frame9.png", "", "2 1 0 0 0 0 0 0 1 a/frame9.png"],
            "3: 'a/frame9.png' is on line 1 too",
        ),
        (["1 1 0 0 0 0 0 0 1 a/frame9.png", "2 1 0 0 0 0 0 0 1 x.png"], "2: 10 columns, expected keypoints of 'a/fr"),
        (["1 1 0 0 0 0 0 0 1 nowhere.png"], r" none of its images found, looked in .*scene/images,"),
    ],
)
def test_a_colmap_image_that_is_wrong_is_named(rows: list[str], said: str, tmp_path: Path) -> None:
    root = make_colmap(tmp_path / "scene", "sparse/0", "images")
    (root / "sparse" / "0" / "images.txt").write_text("\n".join(rows))
    with pytest.raises(SequenceError, match=rf"images\.txt:{said}"):
        list_images(root)


@pytest.mark.parametrize(
    ("row", "said"),
    [
        ("1 0 0 0 0 0 0 0 1 a/frame9.png", "images.txt:1: quaternion of length 0"),
        ("1 0 0 0 0 0 0 1 a/frame9.png", "images.txt:1: 9 columns, expected the 10 of `id qw"),
    ],
)
def test_an_image_of_a_colmap_model_that_cannot_be_used_is_left_out_and_named(
    row: str, said: str, tmp_path: Path
) -> None:
    root = make_colmap(tmp_path / "scene", "sparse/0", "images")
    rows = [
        row,
        "",
        colmap_row(2, true_pose(1), 1, "a/frame10.png"),
        "",
        colmap_row(3, true_pose(2), 2, COLMAP_NAMES[2]),
    ]
    (root / "sparse" / "0" / "images.txt").write_text("\n".join(rows))
    check(root, [1, 2])
    assert leaves_out(root, 3, said).skipped[UNUSABLE] == 1


def test_what_a_colmap_model_leaves_out_is_counted(tmp_path: Path) -> None:
    root = make_colmap(tmp_path / "scene", "sparse/0", "images")
    rows = [
        "1 nan 0 0 0 0 0 0 1 a/frame9.png",
        "",
        colmap_row(2, true_pose(1), 1, "a/frame10.png"),
        "",
        "3 1 0 0 0 0 0 0 2 gone.png",
    ]
    (root / "sparse" / "0" / "images.txt").write_text("\n".join(rows))
    write_images(root / "images", {7: "a/frame11.png"})
    check(root, [1])
    counted = {"true pose not finite": 1, "no image": 1, "image not in the list": 2}  # one in a folder of its own
    assert list_images(root).skipped == counted
