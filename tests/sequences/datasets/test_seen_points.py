"""Which points of a COLMAP model its images show, and where."""

import struct
from pathlib import Path

import cv2
import numpy as np
import pytest

from sequences.datasets.frames import posed_frames
from sequences.datasets.layout_helpers.colmap_binary import keypoint_rows
from sequences.datasets.points import PointsOfImages, seen_points
from sequences.errors import SequenceError
from sequences.frame import Camera
from sequences.images.undistortion import DistortionModel, Lens, rays_of
from sequences.options import SequenceOptions
from tests.helpers.data_sets import COLMAP_NAMES, colmap_row, make_colmap, true_pose
from tests.helpers.dot_scene import make_colmap_binary

POINTS = "# points\n" + "".join(f"{number} {number} 2 3 1 2 3 0.5 5 0\n" for number in (900, 7, 30))
KEYPOINTS = {0: "32 24 7 10.5 12.5 -1 62 34 900", 1: "32 24 900 5 6 30", 2: ""}


def model(root: Path, keypoints: dict[int, str], points: str = POINTS) -> Path:
    """A model as text: images 0 and 1 of a camera of 64 x 48 pixels, f = (60, 58), and image 2 of another."""
    root = make_colmap(root, "sparse/0", "images")
    rows = [
        f"{colmap_row(index + 5, true_pose(index), 2 if index == 2 else 1, COLMAP_NAMES[index])}\n{keypoints[index]}\n"
        for index in (1, 2, 0)
    ]
    (root / "sparse" / "0" / "images.txt").write_text("".join(rows))
    (root / "sparse" / "0" / "points3D.txt").write_text(points)
    return root


def test_the_images_of_a_model_say_which_points_they_show_and_along_which_rays(tmp_path: Path) -> None:
    frames = posed_frames(model(tmp_path / "scene", KEYPOINTS))
    seen = [frames.seen_points()[frame.time_ns] for frame in frames]
    first, second, third = seen
    # COLMAP has the first pixel's centre at (0.5, 0.5), so that (32, 24) is the principal point of camera 1.
    np.testing.assert_allclose(first.rays, [[0, 0], [30 / 60, 10 / 58]])
    np.testing.assert_allclose(second.rays, [[0, 0], [-27 / 60, -18 / 58]])
    assert len({*first.point.tolist(), *second.point.tolist()}) == 3
    assert first.point[1] == second.point[0]  # both are of point 900
    assert not len(third.point)
    assert frames.notices == []


def test_the_binary_model_says_the_same(tmp_path: Path) -> None:
    root = make_colmap_binary(tmp_path / "scene")  # of images 1 to 4 keypoint 0, at (0, 2.5), is of point 12
    (root / "sparse" / "0" / "points3D.bin").write_bytes(
        struct.pack("<Q", 1) + struct.pack("<Q3d3BdQ", 12, 1.0, 2.0, 3.0, 1, 2, 3, 0.5, 1) + struct.pack("<ii", 4, 5)
    )
    frames = posed_frames(root)
    found = [(frames.seen_points()[frame.time_ns], frame.camera) for frame in frames]
    assert [len(seen.point) for seen, _ in found] == [0, 1, 1, 1, 1]
    for seen, camera in found[1:]:
        assert camera is not None
        np.testing.assert_allclose(seen.rays * (camera.fx, camera.fy) + (camera.cx, camera.cy), [[-0.5, 2.0]])


@pytest.mark.parametrize(
    ("keypoints", "said"),
    [(2, r"images\.bin: ends at byte \d+ within a record"), (1_000_001, "9 b.png' has 1000001 keypoints, expected")],
)
def test_binary_keypoints_that_a_file_cannot_have_are_refused(keypoints: int, said: str, tmp_path: Path) -> None:
    images = make_colmap_binary(tmp_path / "scene") / "sparse" / "0" / "images.bin"
    whole = images.read_bytes()
    begin = whole.index(b"/9 b.png\0") + len(b"/9 b.png\0")
    head = whole[whole.index(struct.pack("<i", 89), 8) : begin]
    images.write_bytes(struct.pack("<Q", 1) + head + struct.pack("<Q", keypoints) + bytes(24))
    with pytest.raises(SequenceError, match=said):
        list(keypoint_rows(images))


def test_a_model_without_points_shows_none(tmp_path: Path) -> None:
    root = model(tmp_path / "scene", KEYPOINTS)
    (root / "sparse" / "0" / "points3D.txt").write_text("# none\n")
    frames = posed_frames(root)
    assert not any(len(seen.point) for seen in frames.seen_points().values())
    (root / "sparse" / "0" / "points3D.txt").unlink()
    assert posed_frames(root).seen_points() == {}


def test_sightings_that_cannot_be_are_left_out_and_counted(tmp_path: Path) -> None:
    keypoints = {0: "32 24 7 64.5 24 7 32 -1 900 nan 5 7 32 24 8", 1: "inf 24 900 5 6 30", 2: ""}
    points = f"{POINTS}8 nan 0 0 1 2 3 0.5\n"
    frames = posed_frames(model(tmp_path / "scene", keypoints, points))
    assert sum(len(seen.point) for seen in frames.seen_points().values()) == 2
    assert len(frames.notices) == 1
    assert "5 of 7 sightings of points left out: outside of their image, or of unknown points" in frames.notices[0]


@pytest.mark.parametrize(
    ("keypoints", "said"),
    [("32 up 7", "'up' is no number"), ("32 24 seven", "'seven', expected a whole number"), ("32 24 1e3", "'1e3'")],
)
def test_damaged_keypoints_are_refused_where_they_are(keypoints: str, said: str, tmp_path: Path) -> None:
    frames = posed_frames(model(tmp_path / "scene", {**KEYPOINTS, 2: keypoints}))
    with pytest.raises(SequenceError, match=rf"images\.txt:4: .*{said}"):
        frames.seen_points()


def test_a_model_with_more_sightings_than_memory_shall_hold_shows_none(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sequences.datasets.points._MOST", 3)
    stated = [(Path(name), Camera(9, 9, 5.0, 5.0, 4.0, 4.0), np.zeros((2, 2)), np.arange(2)) for name in "ab"]
    said = "model: more than 3 sightings of points, so none is used"
    assert seen_points("model", stated, np.arange(2), True) == PointsOfImages({}, (said,))


@pytest.mark.parametrize(
    ("model", "coefficients"),
    [("plumb_bob", (-0.2, 0.05, 0.003, -0.002)), ("equidistant", (0.05, -0.01, 0.0, 0.0))],
)
def test_rays_are_those_that_a_lens_sees_at_pixels(model: DistortionModel, coefficients: tuple[float, ...]) -> None:
    lens = Lens(Camera(64, 48, 60.0, 58.0, 31.5, 23.5), model, coefficients)
    rays = np.random.default_rng(0).uniform(-0.4, 0.4, (20, 2))
    matrix = np.array([[60, 0, 31.5], [0, 58, 23.5], [0, 0, 1.0]])
    if model == "equidistant":
        pixels = cv2.fisheye.distortPoints(rays[:, None], matrix, np.array(coefficients))[:, 0]
    else:
        points = np.concatenate([rays, np.ones((20, 1))], axis=1)
        pixels = cv2.projectPoints(points, np.zeros(3), np.zeros(3), matrix, np.array(coefficients))[0][:, 0]
    np.testing.assert_allclose(rays_of(pixels, lens), rays, atol=1e-6)
    assert np.abs(rays_of(pixels, lens.camera) - rays).max() > 1e-3
    assert rays_of(np.empty((0, 2)), lens).shape == (0, 2)


def test_where_distortion_folds_there_is_no_ray() -> None:
    lens = Lens(Camera(640, 480, 300.0, 300.0, 319.5, 239.5), "plumb_bob", (-0.5, 0.0, 0.0, 0.0))
    rays = rays_of(np.array([[319.5, 239.5], [639.0, 479.0]]), lens)  # no ray comes out as far as the corner
    np.testing.assert_allclose(rays[0], 0.0, atol=1e-9)
    assert np.isnan(rays[1]).all()


def test_images_that_are_left_distorted_show_points_where_they_are_in_them(tmp_path: Path) -> None:
    root = model(tmp_path / "scene", KEYPOINTS)
    lens = "1 SIMPLE_RADIAL 64 48 60 32 24 -0.2\n2 SIMPLE_PINHOLE 32 24 30 16 12\n"
    (root / "sparse" / "0" / "cameras.txt").write_text(lens)
    as_it_is, straight = (
        next(iter(posed_frames(root, options=SequenceOptions(undistort=undistort)).seen_points().values()))
        for undistort in (False, True)
    )
    np.testing.assert_allclose(as_it_is.rays[1], [30 / 60, 10 / 60])
    assert straight.rays[1, 0] > 0.51
