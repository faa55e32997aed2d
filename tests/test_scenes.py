from dataclasses import replace
from itertools import islice
from typing import Literal

import cv2
import numpy as np
import pytest

from filtering.se3 import Poses
from sequences import synthesize as synthesize_module
from sequences.errors import SequenceError
from sequences.frame import Camera
from sequences.place import SCENES, load_scene
from sequences.render import depth_and_quads, render, sees_cue
from sequences.scenes import ceiling, corridor, staircase
from sequences.scenes.paths import circle_table, roll_through_hall, walk_corridor, walk_stairs
from sequences.scenes.surface import Scene
from sequences.synthesize import Stand, SyntheticSequence, synthesize

pytestmark = pytest.mark.usefixtures("unchecked")

CAMERA = Camera(96, 72, 60.0, 60.0, 47.5, 35.5)


@pytest.fixture(scope="module", params=SCENES)
def name(request) -> str:
    return request.param


@pytest.fixture(scope="module", params=["staircase", "ceiling", "corridor"])
def name_with_cues(request) -> str:
    """Of a scene that has something unique."""
    return request.param


def look(position: tuple[float, float, float], yaw: float, pitch_down: float = 0.1) -> Poses:
    forward = np.array([np.cos(yaw) * np.cos(pitch_down), np.sin(yaw) * np.cos(pitch_down), -np.sin(pitch_down)])
    right = np.array([np.sin(yaw), -np.cos(yaw), 0.0])
    return Poses(np.stack([right, np.cross(forward, right), forward], axis=1), np.array(position, float))


def upward(x: float, y: float, yaw: float) -> Poses:
    right, up = np.array([np.sin(yaw), -np.cos(yaw), 0.0]), np.array([0.0, 0.0, 1.0])
    return Poses(np.stack([right, np.cross(up, right), up], axis=1), np.array([x, y, 0.9]))


def shifted(pose: Poses, x: float, y: float, z: float) -> Poses:
    return Poses(pose.rotation, pose.translation + np.array([x, y, z]))


def picture(scene: Scene, pose: Poses) -> np.ndarray:
    return render(scene, CAMERA, Poses.stack([pose] * 4), rng=np.random.default_rng(0))


def matt(name: str) -> Scene:
    """The scene without its glossy reflections, which scatter at random."""
    scene = load_scene(name)
    return replace(scene, gloss=np.zeros_like(scene.gloss))


def share_that_differs(first: np.ndarray, second: np.ndarray) -> float:
    return float((np.abs(first - second).max(axis=2) > 0.1 * (0.05 + first.mean(axis=2))).mean())


# --- ambiguity: what looks the same, and what does not ---------------------------------------------

STAIR_VIEWS = [look((1.0, 0.6, 1.6), 0.0), look((2.5, 0.6, 2.2), 0.1, 0.2), look((3.9, 1.9, 3.1), -0.4)]


@pytest.mark.parametrize(("view", "levels"), [(0, (2, 4)), (1, (2, 4)), (2, (0, 2, 3))])
def test_two_floors_look_the_same_from_the_same_place_on_them(view, levels):
    scene, pose = matt("staircase"), STAIR_VIEWS[view]
    first = picture(scene, shifted(pose, 0, 0, staircase.FLOOR_HEIGHT))
    for level in levels:
        second = picture(scene, shifted(pose, 0, 0, level * staircase.FLOOR_HEIGHT))
        assert share_that_differs(first, second) < 0.01  # all but hairlines of rounding
    nearby = picture(scene, shifted(pose, 0.15, 0, staircase.FLOOR_HEIGHT))
    assert share_that_differs(first, nearby) > 0.2  # the measure does see a step aside


@pytest.mark.parametrize(("x", "y", "heading"), [(8.9, 6.5, 0.3), (6.5, 7.7, 2.0)])
def test_two_cells_of_the_ceiling_look_the_same_and_a_panel_further_does_not(x, y, heading):
    scene, (dx, dy) = load_scene("ceiling"), np.array(ceiling.CELL) * ceiling.PANEL
    pose = upward(x, y, heading)
    assert not sees_cue(scene, CAMERA, Poses.stack([pose, shifted(pose, dx, -dy, 0)]), min_share=1e-9).any()
    first = picture(scene, pose)
    assert share_that_differs(first, picture(scene, shifted(pose, dx, -dy, 0))) < 0.03
    assert share_that_differs(first, picture(scene, shifted(pose, ceiling.PANEL, 0, 0))) > 0.1
    assert share_that_differs(first, picture(scene, upward(x, y, heading + np.pi))) > 0.1


@pytest.mark.parametrize(
    ("place", "unlike"),
    [
        (look((2.4, 0.6, 2.1 + 3 * staircase.FLOOR_HEIGHT), np.pi, 0.3), 2 * staircase.FLOOR_HEIGHT),  # the poster
        (look((2.0, 0.6, 1.8), np.pi, 0.2), -2 * staircase.FLOOR_HEIGHT),  # the entrance
        (look((0.6, 1.6, 1.6 + 5 * staircase.FLOOR_HEIGHT), 0.0), 3 * staircase.FLOOR_HEIGHT),  # the top
    ],
    ids=["poster", "entrance", "top"],
)
def test_unique_things_of_the_staircase_change_the_image_clearly(place, unlike):
    scene, elsewhere = load_scene("staircase"), shifted(place, 0, 0, -unlike)
    assert sees_cue(scene, CAMERA, Poses.stack([place, elsewhere])).tolist() == [True, False]
    assert share_that_differs(picture(scene, place), picture(scene, elsewhere)) > 0.05


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
    assert not sees_cue(scene, CAMERA, Poses.stack([view]), min_share=1e-9).any()
    first = picture(scene, view)
    assert share_that_differs(first, picture(scene, shifted(view, 0, 0, corridor.FLOOR_HEIGHT))) < 0.01
    assert share_that_differs(first, picture(scene, shifted(view, 0.3, 0, 0))) > 0.15
    assert share_that_differs(first, picture(scene, shifted(view, corridor.REPEAT, 0, 0))) > 0.05  # walls and boards


@pytest.mark.parametrize("floor", [0, 1])
@pytest.mark.parametrize(("x", "yaw"), [(4.0, np.pi), (71.0, 0.0)], ids=["window", "door"])
def test_each_end_of_the_corridor_shows_the_floor(floor, x, yaw):
    scene, up = load_scene("corridor"), floor * corridor.FLOOR_HEIGHT
    here, there = look((x, 1.2, 1.5 + up), yaw), look((x, 1.2, 1.5 + corridor.FLOOR_HEIGHT - up), yaw)
    assert sees_cue(scene, CAMERA, Poses.stack([here])).all()
    assert share_that_differs(picture(scene, here), picture(scene, there)) > 0.05


def test_the_two_ends_of_the_corridor_differ_without_the_painted_walls():
    scene = load_scene("corridor")
    ends = [look((2.0, 1.2, 1.5), np.pi, 0.0), look((73.0, 1.2, 1.5), 0.0, 0.0)]
    pictures = [picture(scene, end)[18:54, 24:72] for end in ends]
    assert share_that_differs(*pictures) > 0.5


def turned(pose: Poses, angle: float) -> Poses:
    """The pose carried about the z axis of the world."""
    return Poses.exp(np.array([0, 0, 0, 0, 0, angle])) @ pose


@pytest.mark.parametrize(("scene_name", "modes"), [("round-table", 4), ("dinner-table", 2)])
@pytest.mark.parametrize("index", [0, 40, 110])
def test_a_table_looks_the_same_from_as_many_sides_as_it_has_modes_and_from_no_more(scene_name, modes, index):
    scene = matt(scene_name)
    pose = synthesize(scene_name, seed=0, num_frames=120, width=64, height=48).world_from_camera[index]
    first = picture(scene, pose)
    for turn in range(1, modes):
        assert share_that_differs(first, picture(scene, turned(pose, 2 * np.pi * turn / modes))) < 0.01
    assert share_that_differs(first, picture(scene, turned(pose, np.pi / modes))) > 0.1  # half of the way to the next
    assert share_that_differs(first, picture(scene, turned(pose, 0.05))) > 0.2  # nor from anywhere nearby


@pytest.mark.parametrize("scene_name", ["round-table", "dinner-table"])
def test_images_of_a_table_from_two_like_poses_differ_by_noise_alone(scene_name):
    sequence = synthesize(scene_name, seed=3, num_frames=1, width=96, height=72)
    half_turn = Poses.exp(np.array([0, 0, 0, 0, 0, np.pi]))
    opposite = replace(sequence, world_from_base=half_turn @ sequence.world_from_base)
    again = replace(sequence, seed=np.random.SeedSequence(7))
    original, other, noisy = (next(s.images()).astype(float) for s in (sequence, opposite, again))
    noise = np.abs(noisy - original).mean()
    assert noise > 0.5  # of 255: there is some
    assert np.abs(other - original).mean() < 1.1 * noise


def test_walks_about_a_table_see_it_from_all_sides():
    walks = [circle_table(200.0, rng=np.random.default_rng(seed)) for seed in range(3)]
    xy = np.concatenate([walk.translation[:, :2] for walk in walks])
    sides, _ = np.histogram(np.arctan2(xy[:, 1], xy[:, 0]), bins=8, range=(-np.pi, np.pi))
    assert sides.min() > 0.05 * sides.sum()
    distance = np.linalg.norm(xy, axis=1)
    assert distance.min() > 1.2
    assert distance.max() < 2.6
    steps = np.concatenate([np.linalg.norm(np.diff(walk.translation, axis=0), axis=1) for walk in walks])
    assert steps.max() < 0.02 * 1.5  # metres in 20 ms


# --- poses and images agree ------------------------------------------------------------------------


def test_depth_carries_the_picture_of_one_pose_onto_that_of_the_next(name):
    sequence = synthesize(name, seed=4, num_frames=60)
    scene, camera = sequence.scene, Camera(160, 120, 100.0, 100.0, 79.5, 59.5)
    agreement, disagreement = [], []
    for index in range(0, 50, 7):
        first, second = sequence.world_from_camera[index], sequence.world_from_camera[index + 4]
        pictures = [render(scene, camera, Poses.stack([p] * 4), rng=np.random.default_rng(0)) for p in (first, second)]
        agreement.append(_photometric_error(scene, camera, pictures, first, second))
        wrong = second @ Poses.exp(np.array([0.05, 0.05, 0, 0.04, 0.04, 0.04]))
        disagreement.append(_photometric_error(scene, camera, pictures, first, wrong))
    assert np.median(agreement) < 0.03
    assert np.median(disagreement) > 2 * np.median(agreement)


def _photometric_error(scene, camera, pictures, first: Poses, second: Poses) -> float:
    """Mean difference of log brightness where a pixel of the first pose is seen, unhidden, from the second."""
    from sequences.render import pixel_rays

    depth, _ = depth_and_quads(scene, camera, first)
    depth_there, _ = depth_and_quads(scene, camera, second)
    there = second.inverse() @ first
    points = pixel_rays(camera).astype(np.float64) * depth[..., None]
    points = points @ there.rotation.T + there.translation
    u = (camera.fx * points[..., 0] / points[..., 2] + camera.cx).astype(np.float32)
    v = (camera.fy * points[..., 1] / points[..., 2] + camera.cy).astype(np.float32)
    grey = [
        np.log(0.02 + cv2.GaussianBlur(p.mean(axis=2), (0, 0), 1.5)) for p in pictures
    ]  # texture is finer than pixels
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
    scene = load_scene(name)
    walks = synthesize(name, seed=0, num_frames=1500, split="train"), synthesize(name, seed=1, num_frames=1500)
    for sequence in walks:
        eye = (sequence.world_from_base @ sequence.base_from_camera).translation
        assert not scene.tracer.blocked(eye[:-1], np.diff(eye, axis=0)).any()
        around = np.random.default_rng(0).standard_normal((40, 3))
        around /= np.linalg.norm(around, axis=1, keepdims=True)
        some = eye[::5]
        assert not scene.tracer.blocked(np.repeat(some, 40, axis=0), 0.1 * np.tile(around, (len(some), 1))).any()
        _, _, _, far = scene.tracer.first_hit(np.repeat(some, 40, axis=0), np.tile(around, (len(some), 1)))
        assert far.max() < 40  # and never out of the building


# --- sequences -------------------------------------------------------------------------------------


def test_the_same_seed_gives_the_same_bytes_and_another_seed_or_split_does_not(name):
    def first_images(seed: int, split: Literal["train", "test"]) -> np.ndarray:
        return np.stack(
            list(islice(synthesize(name, seed=seed, num_frames=30, split=split, width=64, height=48).images(), 3))
        )

    original = first_images(5, "test")
    assert original.dtype == np.uint8
    assert original.shape == (3, 48, 64, 3)
    np.testing.assert_array_equal(original, first_images(5, "test"))
    assert (original != first_images(6, "test")).mean() > 0.3
    assert (original != first_images(5, "train")).mean() > 0.3


def test_images_can_be_iterated_again_and_are_as_many_as_their_stamps(name):
    sequence = synthesize(name, seed=2, num_frames=4, width=64, height=48)
    once, again = list(sequence.images()), list(sequence.images())
    assert len(once) == len(sequence.image_times_ns) == len(sequence.world_from_camera) == 4
    np.testing.assert_array_equal(np.stack(once), np.stack(again))


def test_odometry_at_50_hz_covers_images_at_10_hz_with_a_margin(name):
    sequence = synthesize(name, seed=0, num_frames=25)
    assert set(np.diff(sequence.image_times_ns)) == {100_000_000}
    assert set(np.diff(sequence.odometry_times_ns)) == {20_000_000}
    assert sequence.odometry_times_ns[0] < sequence.image_times_ns[0] - 200_000_000
    assert sequence.odometry_times_ns[-1] > sequence.image_times_ns[-1] + 200_000_000
    np.testing.assert_array_equal(sequence.odom_from_base.as_matrix()[0], np.eye(4))
    assert len(sequence.odom_from_base) == len(sequence.twist_covariances) == len(sequence.odometry_times_ns)


def test_test_paths_pass_something_unique_in_their_first_half_but_seldom(name_with_cues):
    for seed in range(8):
        sequence = synthesize(name_with_cues, seed=seed, num_frames=300, width=64, height=48)
        seen = sees_cue(sequence.scene, sequence.camera, sequence.world_from_camera)
        assert seen[:150].sum() >= 5
        assert seen.mean() < 0.25


def test_paths_without_anything_unique_show_none_of_it_even_at_full_resolution(name_with_cues):
    for seed in range(3):
        sequence = synthesize(name_with_cues, seed=seed, num_frames=120, cues="none", width=160, height=120)
        assert len(sequence.world_from_camera) == 120
        assert sequence.odometry_times_ns[-1] > sequence.image_times_ns[-1] + 200_000_000
        scene = sequence.scene
        quads = [depth_and_quads(scene, sequence.camera, pose)[1] for pose in sequence.world_from_camera[::6]]
        assert max((scene.geometry.cue[seen] & (seen >= 0)).mean() for seen in quads) < 0.002


def test_cues_follow_from_the_split_where_they_are_not_asked_for(name_with_cues):
    def path(**options) -> np.ndarray:
        return synthesize(
            name_with_cues, seed=5, num_frames=150, width=64, height=48, **options
        ).world_from_camera.as_matrix()

    of_test = path()
    np.testing.assert_array_equal(of_test, path(cues="early"))
    np.testing.assert_array_equal(path(split="train"), path(split="train", cues="any"))
    assert not np.array_equal(path(cues="none"), of_test)


def test_where_something_unique_always_shows_no_path_is_without(name_with_cues, monkeypatch):
    monkeypatch.setattr(synthesize_module, "sees_cue", lambda scene, camera, poses, **_: np.ones(len(poses), bool))
    with pytest.raises(
        SequenceError, match=f"{name_with_cues}, seed 3: no random path has 10 images in a row .* another seed"
    ):
        synthesize(name_with_cues, seed=3, num_frames=10, cues="none")


def test_images_are_exposed_neither_black_nor_white(name):
    sequence = synthesize(name, seed=3, num_frames=40, width=64, height=48)
    levels = np.array([np.median(image) for image in islice(sequence.images(), 0, None, 5)])
    assert (levels > 50).all()
    assert (levels < 210).all()


def test_long_walks_visit_every_floor_both_ways():
    heights, ups = [], []
    for seed in range(4):
        walk = walk_stairs(300.0, rng=np.random.default_rng(seed))
        heights.append(walk.translation[:, 2])
        ups.append(np.gradient(walk.translation[:, 2], 0.02))
    floor = np.concatenate(heights) // staircase.FLOOR_HEIGHT
    climb = np.concatenate(ups)
    for level in range(staircase.NUM_FLOORS - 1):
        assert (floor == level).mean() > 0.05
        assert ((floor == level) & (climb > 0.1)).any()
        assert ((floor == level) & (climb < -0.1)).any()


def test_walks_in_the_corridor_go_all_along_both_floors_both_ways_at_a_walking_pace():
    walks = [walk_corridor(90.0, rng=np.random.default_rng(seed)) for seed in range(12)]
    place, floor = (np.concatenate([walk.translation[:, axis] for walk in walks]) for axis in (0, 2))
    ahead = np.concatenate([walk.rotation[:, 0, 0] for walk in walks])
    for level in range(corridor.NUM_FLOORS):
        for way in (-1, 1):
            there = (floor // corridor.FLOOR_HEIGHT == level) & (way * ahead > 0.5)
            visits, _ = np.histogram(place[there], bins=5, range=(0, corridor.LENGTH))
            assert visits.min() > 0.005 * len(place)
    assert np.median([np.ptp(walk.translation[:, 0]) for walk in walks]) > 0.5 * corridor.LENGTH
    speed = np.concatenate([np.linalg.norm(np.diff(walk.translation, axis=0), axis=1) for walk in walks]) / 0.02
    assert 1.0 < np.median(speed) < 1.4
    assert speed.max() < 2.0


def test_carts_visit_the_whole_hall_under_all_headings():
    carts = [roll_through_hall(600.0, margin_m=1.0, rng=np.random.default_rng(seed)) for seed in range(3)]
    xy = np.concatenate([cart.translation[:, :2] for cart in carts])
    yaw = np.concatenate([np.arctan2(cart.rotation[:, 1, 0], cart.rotation[:, 0, 0]) for cart in carts])
    visits, _, _ = np.histogram2d(xy[:, 0], xy[:, 1], bins=(4, 3), range=((0, ceiling.LENGTH), (0, ceiling.BREADTH)))
    assert visits.min() > 0.02 * visits.sum()
    headings, _ = np.histogram(yaw, bins=8, range=(-np.pi, np.pi))
    assert headings.min() > 0.04 * headings.sum()
    speed = np.linalg.norm(np.diff(xy[:1000], axis=0), axis=1) / 0.02
    assert speed.max() < 1.0


# --- other rates, and standing ---------------------------------------------------------------------


def small(name: str = "corridor", num_frames: int = 40, **options) -> SyntheticSequence:
    return synthesize(name, seed=3, num_frames=num_frames, width=32, height=24, **options)


@pytest.mark.parametrize(("rate_hz", "times"), [(30.0, 3), (20.0, 2), (50.0, 5)])
def test_a_faster_camera_on_the_same_walk_takes_the_same_images_and_others_between(rate_hz, times):
    slow, fast = small(), small(num_frames=40 * times, rate_hz=rate_hz)
    np.testing.assert_array_equal(fast.image_times_ns[::times], slow.image_times_ns)
    np.testing.assert_array_equal(fast.world_from_camera.as_matrix()[::times], slow.world_from_camera.as_matrix())
    np.testing.assert_array_equal(fast.odom_from_base.as_matrix(), slow.odom_from_base.as_matrix())
    assert fast.odometry_times_ns[-1] > fast.image_times_ns[-1] + 200_000_000
    assert len(fast.image_times_ns) == len(fast.world_from_camera) == 40 * times
    steps = np.diff(fast.image_times_ns)
    assert steps.max() - steps.min() <= 1  # ns


def test_a_slower_camera_on_the_same_walk_takes_some_of_the_same_images():
    fast, slow = small(num_frames=42), small(num_frames=14, rate_hz=10 / 3)
    np.testing.assert_array_equal(slow.image_times_ns, fast.image_times_ns[::3])
    np.testing.assert_array_equal(slow.odom_from_base.as_matrix(), fast.odom_from_base.as_matrix())


def test_exposure_follows_the_light_in_the_same_time_at_every_rate(monkeypatch):
    def exposures(sequence: SyntheticSequence) -> np.ndarray:
        taken = []
        monkeypatch.setattr(synthesize_module, "develop", lambda light, camera, exposure, **_: taken.append(exposure))
        light = iter([-3.0] + [1.0] * 1000)  # what the metering asks for: one dark image, then bright ones
        monkeypatch.setattr(synthesize_module, "_metered_exposure", lambda radiance: next(light))
        list(sequence.images())
        return np.array(taken)

    slow, fast = exposures(small()), exposures(small(num_frames=120, rate_hz=30.0))
    assert abs(slow[5] - fast[15]) < 0.5
    assert slow[5] < 0.6
    assert abs(slow[20:].mean() - 1) < 0.3
    assert abs(fast[60:].mean() - 1) < 0.3


@pytest.mark.parametrize("rate_hz", [0.0, -10.0, 1e4, float("nan")])
def test_a_rate_that_no_camera_has_is_refused(rate_hz):
    with pytest.raises(SequenceError, match=r"images a second, expected 0\.1 to 200"):
        small(rate_hz=rate_hz)


@pytest.mark.parametrize("rate_hz", [10.0, 30.0])
def test_a_camera_that_stands_keeps_its_pose_from_the_image_on_for_as_long_as_asked(rate_hz):
    walk, sequence = small(rate_hz=rate_hz), small(rate_hz=rate_hz, stand=Stand(20, 8.0))
    assert len(sequence.image_times_ns) == 20 + round(8 * rate_hz)
    poses = sequence.world_from_camera
    distance_m, angle_rad = poses[20].distance(poses[20:])
    assert max(distance_m.max(), angle_rad.max()) < 1e-9
    moved_m, _ = poses[18].distance(poses[20])
    assert moved_m > 1e-4  # and not before
    walked = 20 - int(0.5 * rate_hz)
    np.testing.assert_array_equal(poses.as_matrix()[:walked], walk.world_from_camera.as_matrix()[:walked])
    late_m, _ = poses[20].distance(walk.world_from_camera[20])
    assert late_m < 0.5  # where the walk was at that time, but for stopping
    speed = np.linalg.norm(np.diff(sequence.world_from_base.translation, axis=0), axis=1)
    assert speed.max() <= np.linalg.norm(np.diff(walk.world_from_base.translation, axis=0), axis=1).max() + 1e-9


def test_odometry_of_a_camera_that_stands_goes_on_with_noise_and_bias():
    sequence = small(stand=Stand(20, 60.0))
    still = sequence.odometry_times_ns > sequence.image_times_ns[20]
    moved = sequence.odom_from_base.translation[still]
    step = np.diff(moved, axis=0)
    assert step.std() == pytest.approx(0.008 * np.sqrt(0.02), rel=0.1)
    assert 0.02 < np.linalg.norm(moved[-1] - moved[0]) < 3
    assert sequence.odometry_times_ns[-1] > sequence.image_times_ns[-1] + 200_000_000
    assert (np.linalg.eigvalsh(sequence.twist_covariances) > 0).all()


def test_a_camera_that_stands_sees_the_same_under_noise_of_its_own_and_light_is_traced_once(monkeypatch):
    traced = []

    def counted(*arguments, **options):
        traced.append(1)
        return render(*arguments, **options)

    monkeypatch.setattr(synthesize_module, "render", counted)
    images = np.stack(list(small(stand=Stand(5, 30.0)).images())).astype(float)
    assert len(images) == 305
    assert len(traced) <= 7
    standing = images[100:]  # exposure has settled
    change = np.abs(np.diff(standing, axis=0))
    assert change.mean(axis=(1, 2, 3)).min() > 0.5  # of 255
    assert change.mean() < 8
    brightness = standing.mean(axis=(1, 2, 3))
    assert brightness.std() > 0.5  # auto exposure goes on
    early, late = standing[:100].mean(axis=0), standing[100:].mean(axis=0)
    assert np.corrcoef(early.ravel(), late.ravel())[0, 1] > 0.99


def test_a_camera_that_stood_walks_on_along_the_rest_of_its_path():
    walk, sequence = small(num_frames=60), small(num_frames=60, stand=Stand(20, 3.0, walks_on=True))
    assert len(sequence.image_times_ns) == 60 + 30
    distance_m, _ = sequence.world_from_camera[20].distance(sequence.world_from_camera[20:50])
    assert distance_m.max() < 1e-9
    path = walk.world_from_base.translation
    end = (sequence.world_from_camera[-1] @ sequence.base_from_camera.inverse()).translation
    distance_m = np.linalg.norm(path - end, axis=1)
    assert distance_m.min() < 0.02
    last = (walk.image_times_ns[-1] - walk.odometry_times_ns[0]) // 20_000_000
    assert abs(distance_m.argmin() - (last - 20)) <= 2  # stopping and starting lose 0.2 s of walking each
    assert sequence.odometry_times_ns[-1] > sequence.image_times_ns[-1] + 200_000_000


@pytest.mark.parametrize("walks_on", [False, True])
def test_a_short_stand_before_a_slow_camera_is_one_image_and_odometry_covers_all(walks_on):
    sequence = small(num_frames=4, rate_hz=0.5, stand=Stand(0, 0.1, walks_on=walks_on))
    assert len(sequence.image_times_ns) == (5 if walks_on else 1)
    assert sequence.odometry_times_ns[-1] > sequence.image_times_ns[-1] + 200_000_000


@pytest.mark.parametrize("stand", [Stand(40, 1.0), Stand(-1, 1.0), Stand(3, 0.0), Stand(3, float("nan"))])
def test_a_stand_that_cannot_be_is_refused(stand):
    with pytest.raises(SequenceError, match="expected an image below 40"):
        small(stand=stand)


def test_an_unknown_scene_is_refused_and_the_known_ones_are_named():
    with pytest.raises(
        SequenceError,
        match="unknown scene 'cellar', expected one of staircase, ceiling, round-table, dinner-table, corridor",
    ):
        synthesize("cellar", seed=0, num_frames=10)


def test_a_sequence_of_no_frames_is_refused():
    with pytest.raises(SequenceError, match="0 frames of 320 × 240 pixels"):
        synthesize("ceiling", seed=0, num_frames=0)
