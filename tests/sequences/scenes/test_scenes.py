import subprocess
import sys

import cv2
import numpy as np
import pytest

from filtering.se3 import Poses
from sequences.frame import Camera
from sequences.rendering.render import LitScene, pixel_rays, render, sees_cue
from sequences.scenes import SCENES, ceiling, corridor, find_scene, stairwell
from sequences.synthesize import synthesize
from tests.helpers import views
from tests.helpers.views import depth_and_quads, fraction_that_differs, shifted

CAMERA = Camera(96, 72, 60.0, 60.0, 47.5, 35.5)

# What looks alike shares its paint and light, however finely light is sampled.
pytestmark = pytest.mark.usefixtures("unchecked", "rough_light")


@pytest.fixture(scope="module", params=SCENES)
def name(request) -> str:
    return request.param


def look(position: tuple[float, float, float], yaw: float, pitch_down: float = 0.1) -> Poses:
    forward = np.array([np.cos(yaw) * np.cos(pitch_down), np.sin(yaw) * np.cos(pitch_down), -np.sin(pitch_down)])
    right = np.array([np.sin(yaw), -np.cos(yaw), 0.0])
    return Poses(np.stack([right, np.cross(forward, right), forward], axis=1), np.array(position, float))


def upward(x: float, y: float, yaw: float) -> Poses:
    right, up = np.array([np.sin(yaw), -np.cos(yaw), 0.0]), np.array([0.0, 0.0, 1.0])
    return Poses(np.stack([right, np.cross(up, right), up], axis=1), np.array([x, y, 0.9]))


def picture(scene: LitScene, pose: Poses) -> np.ndarray:
    return views.picture(scene, CAMERA, pose)


def load_scene(name: str) -> LitScene:
    return find_scene(name).build("test", 0)


def matt(name: str) -> LitScene:
    return views.matt(load_scene(name))


# --- specifications --------------------------------------------------------------------------------


def test_scenes_go_by_their_names_and_seed_numbers_which_never_change():
    numbers = {"staircase": (0,), "ceiling": (1,), "round-table": (2,), "dinner-table": (3,), "corridor": (4,)}
    numbers["building-7"] = (1000, 7)
    assert {find_scene(name).name: find_scene(name).seed_numbers for name in [*SCENES, "building-7"]} == numbers


@pytest.mark.parametrize("name", [*SCENES, "building-0"])
def test_a_scene_says_whether_anything_in_it_is_unique(name):
    scene = find_scene(name)
    assert scene.has_cues == any(placement.part.cue for placement in scene.placements("test", 0))


def test_a_scene_is_imported_when_it_is_asked_for_and_not_before():
    code = (
        "import sys; from sequences.scenes import find_scene, is_scene; is_scene('ceiling'); find_scene('ceiling');"
        "print([m for m in sys.modules if m in ('sequences.scenes.ceiling', 'sequences.scenes.corridor')])"
    )
    printed = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert printed.strip() == "['sequences.scenes.ceiling']"


# --- ambiguity: what looks the same, and what does not ---------------------------------------------

STAIR_VIEWS = [look((1.0, 0.6, 1.6), 0.0), look((2.5, 0.6, 2.2), 0.1, 0.2), look((3.9, 1.9, 3.1), -0.4)]


@pytest.mark.parametrize(("view", "levels"), [(0, (2, 4)), (1, (2, 4)), (2, (0, 2, 3))])
def test_two_floors_look_the_same_from_the_same_place_on_them(view, levels):
    scene, pose = matt("staircase"), STAIR_VIEWS[view]
    first = picture(scene, shifted(pose, 0, 0, stairwell.FLOOR_HEIGHT))
    for level in levels:
        second = picture(scene, shifted(pose, 0, 0, level * stairwell.FLOOR_HEIGHT))
        assert fraction_that_differs(first, second) < 0.01  # all but hairlines of rounding
    nearby = picture(scene, shifted(pose, 0.15, 0, stairwell.FLOOR_HEIGHT))
    assert fraction_that_differs(first, nearby) > 0.2  # the measure does see a step aside


@pytest.mark.parametrize(("x", "y", "heading"), [(8.9, 6.5, 0.3), (6.5, 7.7, 2.0)])
def test_two_cells_of_the_ceiling_look_the_same_and_a_panel_further_does_not(x, y, heading):
    scene, (dx, dy) = load_scene("ceiling"), np.array(ceiling.CELL) * ceiling.PANEL
    pose = upward(x, y, heading)
    assert not sees_cue(scene, CAMERA, Poses.stack([pose, shifted(pose, dx, -dy, 0)]), min_fraction=1e-9).any()
    first = picture(scene, pose)
    assert fraction_that_differs(first, picture(scene, shifted(pose, dx, -dy, 0))) < 0.03
    assert fraction_that_differs(first, picture(scene, shifted(pose, ceiling.PANEL, 0, 0))) > 0.1
    assert fraction_that_differs(first, picture(scene, upward(x, y, heading + np.pi))) > 0.1


@pytest.mark.parametrize(
    ("place", "unlike"),
    [
        (look((2.4, 0.6, 2.1 + 3 * stairwell.FLOOR_HEIGHT), np.pi, 0.3), 2 * stairwell.FLOOR_HEIGHT),  # the poster
        (look((2.0, 0.6, 1.8), np.pi, 0.2), -2 * stairwell.FLOOR_HEIGHT),  # the entrance
        (look((0.6, 1.6, 1.6 + 5 * stairwell.FLOOR_HEIGHT), 0.0), 3 * stairwell.FLOOR_HEIGHT),  # the top
    ],
    ids=["poster", "entrance", "top"],
)
def test_unique_things_of_the_staircase_change_the_image_clearly(place, unlike):
    scene, elsewhere = load_scene("staircase"), shifted(place, 0, 0, -unlike)
    assert sees_cue(scene, CAMERA, Poses.stack([place, elsewhere])).tolist() == [True, False]
    assert fraction_that_differs(picture(scene, place), picture(scene, elsewhere)) > 0.05


def test_each_unique_thing_of_the_ceiling_is_seen_from_below_it():
    spots = [(np.array(panel) + 0.5) * ceiling.PANEL for panel in (ceiling.OUTLET_AT, ceiling.HOLE_AT)]
    spots += [
        (np.mean(ceiling.STAIN_AT, axis=0) + 0.5) * ceiling.PANEL,
        *map(np.array, (ceiling.PROJECTOR_AT, ceiling.SIGN_AT)),
    ]
    poses = Poses.stack([upward(float(x), float(y), 1.0) for x, y in spots])
    assert sees_cue(load_scene("ceiling"), CAMERA, poses).all()
    assert not sees_cue(load_scene("ceiling"), CAMERA, Poses.stack([upward(9.8, 8.2, 0.0)])).any()


CORRIDOR_VIEWS = [look((31.3, 1.0, 1.5), 0.1), look((44.0, 1.5, 1.55), np.pi - 0.2), look((37.0, 1.2, 1.5), 1.2)]


@pytest.mark.parametrize("view", CORRIDOR_VIEWS, ids=["along", "back", "aside"])
def test_both_floors_of_the_corridor_look_the_same_and_other_places_along_it_do_not(view):
    scene = matt("corridor")
    assert not sees_cue(scene, CAMERA, Poses.stack([view]), min_fraction=1e-9).any()
    first = picture(scene, view)
    assert fraction_that_differs(first, picture(scene, shifted(view, 0, 0, corridor.FLOOR_HEIGHT))) < 0.01
    assert fraction_that_differs(first, picture(scene, shifted(view, 0.3, 0, 0))) > 0.15
    assert fraction_that_differs(first, picture(scene, shifted(view, corridor.REPEAT, 0, 0))) > 0.05  # walls and boards


@pytest.mark.parametrize("floor", [0, 1])
@pytest.mark.parametrize(("x", "yaw"), [(4.0, np.pi), (71.0, 0.0)], ids=["window", "door"])
def test_each_end_of_the_corridor_shows_the_floor(floor, x, yaw):
    scene, up = load_scene("corridor"), floor * corridor.FLOOR_HEIGHT
    here, there = look((x, 1.2, 1.5 + up), yaw), look((x, 1.2, 1.5 + corridor.FLOOR_HEIGHT - up), yaw)
    assert sees_cue(scene, CAMERA, Poses.stack([here])).all()
    assert fraction_that_differs(picture(scene, here), picture(scene, there)) > 0.05


def turned(pose: Poses, angle: float) -> Poses:
    """The pose carried about the z axis of the world."""
    return Poses.exp(np.array([0, 0, 0, 0, 0, angle])) @ pose


@pytest.mark.parametrize(("scene_name", "modes"), [("round-table", 4), ("dinner-table", 2)])
@pytest.mark.parametrize("index", [0, 40, 110])
def test_a_table_looks_the_same_from_four_sides_or_two_and_from_no_more(scene_name, modes, index):
    scene = matt(scene_name)
    pose = synthesize(scene_name, seed=0, num_frames=120, width=64, height=48).world_from_camera[index]
    first = picture(scene, pose)
    for turn in range(1, modes):
        assert fraction_that_differs(first, picture(scene, turned(pose, 2 * np.pi * turn / modes))) < 0.01
    between = turned(pose, np.pi / modes)  # half of the way to the next
    assert fraction_that_differs(first, picture(scene, between)) > 0.1
    assert fraction_that_differs(first, picture(scene, turned(pose, 0.05))) > 0.2  # nor from anywhere nearby


# --- poses and images agree ------------------------------------------------------------------------


def test_depth_carries_the_picture_of_one_pose_onto_that_of_the_next(name):
    sequence = synthesize(name, seed=4, num_frames=60)
    scene, camera = sequence.scene, Camera(160, 120, 100.0, 100.0, 79.5, 59.5)
    agreement, disagreement = [], []
    for index in range(0, 50, 16):
        first, second = sequence.world_from_camera[index], sequence.world_from_camera[index + 4]
        pictures = [render(scene, camera, Poses.stack([p] * 4), rng=np.random.default_rng(0)) for p in (first, second)]
        agreement.append(_photometric_error(scene, camera, pictures, first, second))
        wrong = second @ Poses.exp(np.array([0.05, 0.05, 0, 0.04, 0.04, 0.04]))
        disagreement.append(_photometric_error(scene, camera, pictures, first, wrong))
    assert np.median(agreement) < 0.03
    assert np.median(disagreement) > 2 * np.median(agreement)


def _photometric_error(scene, camera, pictures, first: Poses, second: Poses) -> float:
    """Mean difference of log brightness where a pixel of the first pose is seen, unhidden, from the second."""
    depth, _ = depth_and_quads(scene, camera, first)
    depth_there, _ = depth_and_quads(scene, camera, second)
    there = second.inverse() @ first
    points = pixel_rays(camera).astype(np.float64) * depth[..., None]
    points = points @ there.rotation.T + there.translation
    u = (camera.fx * points[..., 0] / points[..., 2] + camera.cx).astype(np.float32)
    v = (camera.fy * points[..., 1] / points[..., 2] + camera.cy).astype(np.float32)
    # Texture is finer than pixels.
    grey = [np.log(0.02 + cv2.GaussianBlur(p.mean(axis=2), (0, 0), 1.5)) for p in pictures]
    seen = cv2.remap(depth_there, u, v, cv2.INTER_NEAREST, borderValue=-1.0)
    visible = (np.abs(seen - points[..., 2]) < 0.03 * points[..., 2]) & (points[..., 2] > 0.1)
    assert visible.mean() > 0.2
    warped = cv2.remap(grey[1], u, v, cv2.INTER_LINEAR)
    return float(np.median(np.abs(warped - grey[0])[visible]))


def test_true_camera_poses_are_base_poses_times_extrinsics_at_the_stamps(name):
    sequence = synthesize(name, seed=1, num_frames=30)
    seconds = (sequence.odometry_times_ns - sequence.odometry_times_ns[0]) * 1e-9
    at = (sequence.image_times_ns - sequence.odometry_times_ns[0]) * 1e-9
    base = sequence.world_from_camera @ sequence.base_from_camera.inverse()
    expected = np.stack([np.interp(at, seconds, sequence.world_from_base.translation[:, k]) for k in range(3)], axis=1)
    np.testing.assert_allclose(base.translation, expected, atol=1e-4)


def test_no_camera_passes_through_a_wall_or_comes_too_near_to_one(name):
    walks = synthesize(name, seed=0, num_frames=1500, split="train"), synthesize(name, seed=1, num_frames=1500)
    for sequence in walks:
        eyes = (sequence.world_from_base @ sequence.base_from_camera).translation
        assert views.require_free(load_scene(name), eyes).max() < 40  # and never out of the building


# --- walks -----------------------------------------------------------------------------------------


ENDS = {
    "staircase": ([3.3276, 0.5989, 2.742], [0.0255, -1.4504, -1.1107]),
    "ceiling": ([11.0065, 7.0164, 0.8945], [-0.4055, -0.6479, -0.0017]),
    "round-table": ([1.9309, -0.601, 1.6053], [3.1823, 2.059, 0.7003]),
    "dinner-table": ([1.4634, 0.5725, 1.4555], [1.7075, -1.6805, 0.3792]),
    "corridor": ([1.3551, 1.206, 4.7524], [6.6938, -1.1055, -0.3833]),
    "building-2": ([4.2679, 5.3222, 3.6492], [3.3364, -3.8364, 2.7706]),
}


@pytest.mark.parametrize("name", ENDS)
def test_a_seed_gives_the_walk_and_the_odometry_that_it_has_always_given(name):
    """If others are wanted, count up `SYNTHESIS`: stored recordings and models are of these."""
    sequence = synthesize(name, seed=1, num_frames=60, split="train", width=32, height=24)
    ends = [sequence.world_from_camera.translation[-1], sequence.odom_from_base.translation[-1]]
    np.testing.assert_allclose(ends, ENDS[name], atol=1e-3)
