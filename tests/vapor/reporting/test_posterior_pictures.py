import itertools

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from filtering.se3 import Poses
from sequences.synthesize import synthesize, write_synthetic
from tests.helpers.pages import entities_of
from tests.helpers.tiny_model import write_tiny_model
from vapor.reporting.posterior_pictures import draw_posterior, hopf_coordinates, level_axis
from vapor.reporting.rerun_shapes import frusta
from vapor.track import main

LEVEL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])  # a camera that looks along the world's x


def about(axis: list[float], degrees: float) -> np.ndarray:
    return Rotation.from_rotvec(np.radians(degrees) * np.array(axis, float)).as_matrix()


def test_every_rotation_comes_back_from_its_coordinates():
    rotations = Poses.exp(np.random.default_rng(0).standard_normal((50, 6))).rotation
    longitude, latitude, angle = hopf_coordinates(rotations, axis=1)
    axis = np.stack(
        [np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude), np.sin(latitude)], axis=1
    )
    east = np.stack([-np.sin(longitude), np.cos(longitude), 0 * longitude], axis=1)
    north = np.cross(axis, east)
    np.testing.assert_allclose(axis, rotations[:, :, 1], atol=1e-9)
    np.testing.assert_allclose(
        np.cos(angle)[:, None] * east + np.sin(angle)[:, None] * north, rotations[:, :, 2], atol=1e-9
    )


def test_the_axis_that_is_shown_is_a_level_one():
    assert level_axis(LEVEL[None]) in (0, 2)
    upward = np.stack([about([0, 0, 1], turn) @ np.diag([1.0, -1.0, -1.0]) for turn in (10.0, 200.0)])
    assert level_axis(upward) in (0, 1)


def test_a_frustum_has_every_edge_of_a_camera_that_looks_ahead():
    pose = Poses(LEVEL, np.array([1.0, 2.0, 3.0]))
    (line,) = frusta(Poses.stack([pose]), 0.4)
    corners = {tuple(np.round(p, 4)) for p in line}
    assert (1.0, 2.0, 3.0) in corners
    assert len(corners) == 5
    assert sum(abs(x - 1.4) < 1e-4 for x, _, _ in corners) == 4  # the image lies ahead
    steps = {frozenset((tuple(np.round(a, 4)), tuple(np.round(b, 4)))) for a, b in itertools.pairwise(line)}
    assert len(steps) == 8


@pytest.mark.parametrize("known", [True, False])
def test_a_picture_is_drawn_even_of_a_scene_without_extent(tmp_path, known):
    samples = Poses(np.broadcast_to(LEVEL, (30, 3, 3)).copy(), np.full((30, 3), 2.0))
    image = np.full((30, 40, 3), 128, np.uint8)
    truth = samples[0] if known else None
    path = tmp_path / "p.png"
    draw_posterior(path, samples, image=image, surroundings=np.full((5, 3), 2.0), truth=truth, title="flat")
    picture = cv2.imread(str(path))
    assert picture is not None
    assert picture.std() > 10


@pytest.fixture
def words(tmp_path) -> list[str]:
    write_synthetic(synthesize("dinner-table", seed=0, num_frames=4, width=64, height=48), tmp_path / "s.mcap")
    model, output = write_tiny_model(tmp_path / "m.safetensors"), tmp_path / "p.png"
    return ["posterior", f"{tmp_path}/s.mcap", "--model", str(model), "--output", str(output), "--num-samples", "40"]


def test_the_command_draws_one_image_and_says_how_good_its_posterior_is(words, tmp_path, capfd):
    assert main([*words, "--image", "3"]) == 0
    assert "off; fewer than 10% of the samples within 0.3m/20deg" in capfd.readouterr().out
    assert (tmp_path / "p.png").stat().st_size > 5000
    assert main([*words, "--image", "4"]) == 1
    assert "no image with a true pose in frames 4:5" in capfd.readouterr().err


def test_the_command_records_the_posterior_in_space_when_asked_and_replaces_only_recordings(words, tmp_path, capfd):
    assert main(words) == 0
    assert not (tmp_path / "p.rrd").exists()
    for _ in range(2):  # the second time over its own
        assert main([*words, "--recording"]) == 0
        assert f"rerun {tmp_path / 'p.rrd'}" in capfd.readouterr().out
    entities = entities_of(tmp_path / "p.rrd")
    shown = {"/world/posterior", "/world/posterior/cameras", "/world/modes", "/world/camera", "/legend"}
    assert shown | {"/world/place/posterior_samples_of_training_images"} <= entities
    (tmp_path / "p.rrd").write_bytes(b"mine")
    assert main([*words, "--recording"]) == 1
    assert "p.rrd: exists and is no recording of Rerun" in capfd.readouterr().err
    assert (tmp_path / "p.rrd").read_bytes() == b"mine"
