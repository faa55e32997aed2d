"""Poses of images alone: a small room, mapped by COLMAP."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from filtering.se3 import Poses
from sequences.datasets.listing import list_images
from sequences.errors import SequenceError
from sequences.mapping.config import MapConfig
from sequences.mapping.map import map_images
from sequences.outputs import verify
from tests.helpers.room_walks import BEGIN_NS, CAMERA, STEP_NS, views, write_images, write_recording
from tests.helpers.textured_room import walk

FIRST, SECOND = walk(12, 1), walk(10, 2)


@pytest.fixture(scope="module")
def inputs(tmp_path_factory) -> list[Path]:
    """A recording with odometry, and images alone, of one room."""
    folder = tmp_path_factory.mktemp("walks")
    return [write_recording(folder / "robot.mcap", FIRST), write_images(folder / "phone", views(SECOND))]


@pytest.fixture(scope="module")
def mapped(inputs, tmp_path_factory):
    """The folder, the result, and the stages that were reported."""
    stages: dict[str, tuple[int, int | None]] = {}
    output = tmp_path_factory.mktemp("map") / "place"
    result = map_images(inputs, output, progress=lambda stage, done, total: stages.update({stage: (done, total)}))
    return output, result, stages


def true_poses(images) -> Poses:
    """Those of the images of a data set, by their names."""
    known = {"robot": FIRST, "phone": SECOND}
    stamp = [int(file.stem.replace(".", "")) for file in images.files]
    return Poses.stack(
        [known[f.parent.name][round((s - BEGIN_NS) / STEP_NS)] for f, s in zip(images.files, stamp, strict=True)]
    )


def similarity(found: np.ndarray, true: np.ndarray) -> tuple[float, np.ndarray]:
    """Scale and rotation that map the one to the other (Umeyama 1991)."""
    a, b = found - found.mean(axis=0), true - true.mean(axis=0)
    u, s, vt = np.linalg.svd(b.T @ a)
    sign = np.diag([1, 1, np.sign(np.linalg.det(u @ vt))])
    return float((s * np.diag(sign)).sum() / (a**2).sum()), u @ sign @ vt


def test_images_get_their_poses_in_metres_and_in_one_frame_for_all_walks(mapped):
    output, result, _ = mapped
    images, true = list_images(output), true_poses(list_images(output))
    assert result.placed == result.images == len(images) == 22
    assert result.walks == {"robot": (12, 12), "phone": (10, 10)}
    scale, rotation = similarity(images.world_from_camera.translation, true.translation)
    assert scale == pytest.approx(1.0, abs=0.01)
    aligned = images.world_from_camera.translation @ rotation.T
    away = aligned - aligned.mean(axis=0) - true.translation + true.translation.mean(axis=0)
    assert np.linalg.norm(away, axis=1).max() < 0.02
    turned = Poses(rotation @ images.world_from_camera.rotation, true.translation)
    assert np.degrees(turned.distance(true)[1]).max() < 0.5


def test_z_is_up_and_the_origin_is_the_first_image(mapped):
    images = list_images(mapped[0])
    _, rotation = similarity(images.world_from_camera.translation, true_poses(images).translation)
    assert np.degrees(np.arccos(rotation[:, 2] @ [0, -1, 0])) < 5.0  # in the room y is down
    np.testing.assert_allclose(images.world_from_camera.translation[images.files.index(first(images))], 0, atol=1e-6)


def first(images):
    return min((file for file in images.files if file.parent.name == "robot"), key=lambda file: file.name)


def test_images_keep_their_times_and_walks_are_sequences(mapped):
    images = list_images(mapped[0])
    assert images.assumed_hz is None
    assert images.sequence is not None
    for number in (0, 1):
        times = images.times_ns[images.sequence == number]
        np.testing.assert_array_equal(np.diff(times), STEP_NS)
    assert (np.diff(images.times_ns) > 0).all()
    assert images.read_points is not None


def test_intrinsics_that_are_known_hardly_change_and_others_are_found(mapped):
    images = list_images(mapped[0])
    by_walk = {file.parent.name: camera for file, camera in zip(images.files, images.cameras, strict=True)}
    robot, phone = by_walk["robot"], by_walk["phone"]
    assert (robot.fx, robot.cx) == (pytest.approx(CAMERA.fx, rel=0.01), CAMERA.cx)
    assert getattr(phone, "camera", phone).fx == pytest.approx(CAMERA.fx, rel=0.03)


def test_every_stage_is_reported(mapped):
    assert mapped[2] == {
        "choosing images": (22, None),
        "finding features": (22, 22),
        "matching pairs": (231, 231),
        "placing images": (22, 22),
    }


def test_the_folder_says_what_was_made_and_its_manifest_holds(mapped, tmp_path):
    (made, result, _), output = mapped, tmp_path / "place"
    shutil.copytree(made, output)
    stated = json.loads((output / "map.json").read_text())
    assert stated["scale"]["source"] == "recorded odometry of robot"
    assert stated["placed"] == result.placed
    verify(output, ["images", "sparse"])
    (next((output / "images" / "phone").iterdir())).unlink()
    with pytest.raises(SequenceError, match="images: differs from what"):
        verify(output, ["images"])


@pytest.mark.parametrize(
    ("poses", "said"),
    [
        (walk(10, 1, moves=False), "the camera turned on the spot"),
        (walk(1, 1)[[0] * 10], "the picture stands still"),
    ],
)
def test_it_says_why_no_image_could_be_placed(poses, said, tmp_path):
    folder = write_images(tmp_path / "walk", views(poses))
    with pytest.raises(SequenceError, match=f"walk: no image could be placed: {said}"):
        map_images([folder], tmp_path / "place")
    assert [entry.name for entry in tmp_path.iterdir()] == ["walk"]


def test_images_without_features_and_too_few_images_are_said(tmp_path):
    grey = [np.full((60, 80, 3), 100, np.uint8)] * 12
    folder = write_images(tmp_path / "walk", grey)
    with pytest.raises(SequenceError, match="12 of 12 images have hardly any features"):
        map_images([folder], tmp_path / "place")
    with pytest.raises(SequenceError, match="walk: 4 images, expected at least 10"):
        map_images([folder], tmp_path / "place", MapConfig(images=4))


def test_the_same_images_give_the_same_poses_and_replace_an_earlier_map(inputs, tmp_path):
    output, folder = tmp_path / "place", tmp_path / "walk"
    shutil.copytree(inputs[1], folder)
    models = []
    for _ in range(2):
        assert map_images([folder], output, MapConfig(distance_m=2.0)).placed == 10
        models.append(list_images(output).world_from_camera)
    metres, radians = models[0].distance(models[1])
    assert metres.max() < 0.02
    assert np.degrees(radians.max()) < 0.5
    ends = models[1].translation[[0, -1]]
    assert np.linalg.norm(ends[1] - ends[0]) == pytest.approx(2.0, abs=1e-6)
    (output / "mine.txt").write_text("mine")
    with pytest.raises(SequenceError, match=r"holds mine\.txt, expected an empty folder or unchanged results"):
        map_images([folder], output)


def test_a_failed_map_keeps_the_earlier_one(inputs, mapped, tmp_path):
    place = tmp_path / "place"
    shutil.copytree(mapped[0], place)
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    with pytest.raises(SequenceError, match="--between soup@end: no such input, expected one of robot, phone"):
        map_images(inputs, place, MapConfig(distance_m=1.0, between=("start", "soup@end")), overwrite=True)
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before
