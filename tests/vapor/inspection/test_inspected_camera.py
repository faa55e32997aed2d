"""Intrinsics in an inspection: those that fit images and their true poses, beside those that are stated."""

import json
import re
import tempfile
from dataclasses import replace
from io import BytesIO

import cv2
import numpy as np
import pytest

from filtering.se3 import Poses
from sequences.frame import Frame
from sequences.writer import SequenceWriter
from tests.helpers.corridors import recorded
from tests.helpers.data_sets import COLMAP_NAMES, colmap_row, make_colmap, true_pose
from tests.helpers.full import full
from tests.helpers.inspected import BEGIN_NS, only
from tests.helpers.textured_room import CAMERA, Room, walk
from vapor.calibration.camera_fit import fit_camera, material_of
from vapor.commands.inspect import parts
from vapor.inspection.camera import CameraViews
from vapor.inspection.inspect import inspect
from vapor.training_data.entries import open_sequences
from vapor.training_data.load import load_training_set

pytestmark = pytest.mark.usefixtures("unchecked")

_WRONG = replace(CAMERA, fx=0.85 * CAMERA.fx, fy=0.85 * CAMERA.fy)


@pytest.fixture(autouse=True)
def few_features(monkeypatch):
    """Maps of fewer features are made in a third of the time."""
    monkeypatch.setattr("vapor.landmarks.build._FEATURES", 350)


@pytest.fixture(scope="module")
def room():
    return Room()


def _checked(room, poses, *, stated, image=None):
    with tempfile.TemporaryFile() as file:
        views = CameraViews(None, file)
        for number, pose in enumerate(poses[i] for i in range(len(poses))):
            shown = room.view(pose) if image is None else image
            views.take(Frame(number, shown, None, pose, stated), number)
        return views.check(recorded(poses))


def _recorded(room, path, stated, count=30):
    """A walk through the room, whose images come with this camera."""
    poses = walk(count)
    with SequenceWriter(path, camera=stated, base_from_camera=Poses.identity(), metadata={}) as writer:
        for i in range(len(poses)):
            writer.write_image(BEGIN_NS + i * 10**8, room.view(poses[i]))
            writer.write_true_pose(BEGIN_NS + i * 10**8, poses[i])
    return path


def test_intrinsics_that_are_right_are_not_doubted(room):
    found = _checked(room, walk(30), stated=CAMERA)
    assert not found.disagrees
    assert found.in_words.startswith("200 px stated, ")
    assert found.fit.apart_px < 0.5
    assert found.found.fx == pytest.approx(CAMERA.fx, rel=0.02)
    alike = replace(found.fit, by_stated=found.fit.by_found, errors_m=(0.0081, 0.0079)).in_words(CAMERA.width)
    agreeing = f"{found.fit.by_found.agreeing:.0%}"
    assert alike.endswith(f"{agreeing} of matches agree either way, and images are localized within 0.8 cm either way")


def test_a_wrong_focal_length_is_said_once_with_what_fits(room, tmp_path, monkeypatch):
    path = _recorded(room, tmp_path / "w.mcap", _WRONG)
    files, temporary_file = [], tempfile.TemporaryFile
    monkeypatch.setattr(tempfile, "TemporaryFile", lambda: files.append(temporary_file()) or files[-1])
    found = inspect([path])
    assert [file.closed for file in files] == [True]  # one of a camera
    assert any(check.focal is not None for walk in found.walks for check in walk.checks)
    sentence = only(found, "intrinsics")
    assert sentence in found.verdict.advice
    assert sentence.startswith("correct the intrinsics (camera_info, intrinsics.json)")
    assert "170 px stated, " in sentence
    assert sentence.endswith(str(dict(parts(found))["Camera"][0]))
    report = json.loads(json.dumps(found.as_json(), allow_nan=False))["camera"]
    assert report["stated"]["fx"] == _WRONG.fx
    assert report["fits"]["fx"] == pytest.approx(CAMERA.fx, rel=0.02)
    assert report["fits_clearly_better"]
    assert report["median_distance_px"] > 10.0
    errors_m = report["localization_error_m"]
    assert errors_m["fits"] < 0.03
    assert errors_m["stated"] is None or errors_m["stated"] > 2.0 * errors_m["fits"]


def test_a_wrong_focal_length_is_advice_beside_a_recording_of_other_intrinsics_too(room, tmp_path):
    found = inspect(
        [_recorded(room, tmp_path / f"{k}.mcap", stated, 25) for k, stated in (("w", _WRONG), ("r", CAMERA))]
    )
    assert not any("intrinsics" in sentence for sentence in found.verdict.faults)
    assert any("intrinsics" in sentence for sentence in found.verdict.advice)
    assert only(found, "w.mcap: by true poses the images move as through a focal length ")


def test_what_tells_nothing_of_a_camera_is_no_failure(room):
    white = np.full((CAMERA.height, CAMERA.width, 3), 255, np.uint8)
    turned = walk(20, moves=False)
    others = Poses(np.swapaxes(turned.rotation, 1, 2), walk(20, seed=3).translation)
    for found in (
        CameraViews(None, BytesIO()).check(None),
        _checked(room, walk(20)[:1], stated=CAMERA),
        _checked(room, walk(20), stated=CAMERA, image=white),
        _checked(room, turned, stated=CAMERA),
        _checked(room, others, stated=CAMERA, image=room.view(turned[0])),
    ):
        assert found.fit is None
        assert not found.disagrees
        assert re.match(
            "unknown: (too few points are seen from two sides|one image has a true pose|no image has)", found.in_words
        )
        assert set(found.as_json()) == {"images", "unknown"}


@full
def test_what_is_said_of_the_camera_is_what_a_training_says(room, tmp_path):
    path, poses = tmp_path / "w.mcap", walk(40)
    wrong = replace(CAMERA, fx=0.93 * CAMERA.fx, fy=0.93 * CAMERA.fy)
    with SequenceWriter(path, camera=wrong, base_from_camera=Poses.identity(), metadata={}) as writer:
        for i in range(len(poses)):
            writer.write_image(BEGIN_NS + i * 10**8, room.view(poses[i]))
            writer.write_true_pose(BEGIN_NS + i * 10**8, poses[i])
    data = [f"{path}@:25", f"{path}@25:"]
    (check,) = inspect(data).cameras.values()
    images = load_training_set(open_sequences(data), (32, 32), views=True)
    fit = fit_camera(material_of(images))
    assert check.fit.errors_m is not None
    assert check.in_words == fit.in_words(wrong.width)


def _of_two_cameras(root, room, poses):
    """A COLMAP model in whose order of time the rare camera comes first."""
    zoomed = replace(CAMERA, fx=300.0, fy=300.0)
    (root / "images").mkdir(parents=True)
    rows = []
    for number in range(len(poses)):
        rare, name = number % 5 == 0, f"{number:03d}.png"
        image = room.view(poses[number], zoomed if rare else CAMERA)
        cv2.imwrite(str(root / "images" / name), image[:, :, ::-1])
        rows.append(colmap_row(number + 1, poses[number], 2 if rare else 1, name) + "\n\n")
    cameras = [
        f"{n} PINHOLE {c.width} {c.height} {c.fx} {c.fy} {c.cx + 0.5} {c.cy + 0.5}\n"
        for n, c in ((1, CAMERA), (2, zoomed))
    ]
    (root / "sparse").mkdir()
    (root / "sparse" / "cameras.txt").write_text("".join(cameras))
    (root / "sparse" / "images.txt").write_text("".join(rows))
    return root


def test_images_of_other_intrinsics_are_resampled_to_those_of_most_images_as_for_a_training(room, tmp_path):
    root = _of_two_cameras(tmp_path / "place", room, walk(30))
    (check,) = inspect([root]).cameras.values()
    assert (check.images, check.of_all) == (30, False)
    assert check.camera.fx == pytest.approx(CAMERA.fx)
    images = load_training_set(open_sequences([root]), (32, 32), views=True)
    assert check.in_words == fit_camera(material_of(images)).in_words(CAMERA.width)


def test_the_points_of_a_reconstruction_are_those_of_a_training(tmp_path, monkeypatch):
    data = [make_colmap(tmp_path / name, "sparse", "images") for name in ("a", "b")]
    for root in data:
        rows = [colmap_row(i + 5, true_pose(i), 1, COLMAP_NAMES[i]) + f"\n{10 + i} 20 7 5 6 9\n" for i in (0, 1, 2)]
        (root / "sparse" / "images.txt").write_text("".join(rows))
        (root / "sparse" / "points3D.txt").write_text("7 1 2 3 1 2 3 0.5 1 0\n9 1 2 3 1 2 3 0.5 1 0\n")
    seen = []
    monkeypatch.setattr("vapor.inspection.camera.material_of", lambda images, _: seen.append(images) or None)
    inspect(data)
    found, expected = seen[0].seen_points, load_training_set(open_sequences(data), (32, 32), views=True).seen_points
    assert len(found) == len(expected) == 6
    for mine, other in zip(found, expected, strict=True):
        assert mine.point.tolist() == other.point.tolist()
        np.testing.assert_array_equal(mine.rays, other.rays)
    assert not set(found[0].point) & set(found[3].point)


def test_where_none_are_stated_those_that_fit_are_said(room):
    found = _checked(room, walk(30), stated=None)
    assert found.found.fx == pytest.approx(CAMERA.fx, rel=0.02)
    assert found.in_words.startswith("no focal length is stated, ")
    assert not found.disagrees
    assert found.as_json()["stated"] is None
