from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from itertools import combinations

import numpy as np
import pytest

from filtering.se3 import Poses
from sequences.errors import SequenceError
from sequences.frame import Camera
from sequences.rendering import render as rendering
from sequences.rendering.light import Sampling
from sequences.rendering.mesh import Tracer, assemble
from sequences.rendering.render import LitScene, sees_cue
from sequences.scenes import find_scene, is_scene
from sequences.scenes.building import scene as building
from sequences.scenes.building.layout import layout
from sequences.scenes.building.plan import Plan, draw_plan
from sequences.scenes.building.scene import placements, unique_things
from sequences.scenes.building.walk import TRAINING_WALKS, draw_visit, walk_building
from sequences.scenes.building.ways import ways
from sequences.synthesize import synthesize
from tests.helpers import views

CAMERA = Camera(64, 48, 40.0, 40.0, 31.5, 23.5)
SMALL = "building-2"  # two floors, one room


@pytest.fixture(autouse=True, scope="module")
def rough() -> Iterator[None]:
    """Paint and light that are computed in a moment."""
    texels = rendering.chart_sizes
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(rendering, "chart_sizes", lambda geometry: np.maximum(1, texels(geometry) // 4))
        patch.setattr(building, "SAMPLING", Sampling(grid_m=0.5, shadow_rays=1, bounce_rays=4, reach_m=5.0))
        find_scene.cache_clear()
        yield
    find_scene.cache_clear()


@cache
def matt() -> LitScene:
    """Building 0, whose five floors are painted alike, without the reflections that scatter at random."""
    return views.matt(find_scene("building-0").build("train", 0))


def picture(scene: LitScene, pose: Poses) -> np.ndarray:
    return views.picture(scene, CAMERA, pose)


def raised(poses: Poses, plan: Plan, levels: int) -> Poses:
    return views.shifted(poses, 0, 0, levels * plan.storey)


def walk(number: int, split: str, seed: int, duration_s: float = 60.0) -> Poses:
    return find_scene(f"building-{number}").path(duration_s, split, seed, np.random.default_rng([seed, 3]))


# --- what the number draws -------------------------------------------------------------------------


def test_what_is_drawn_of_twenty_buildings_lies_in_its_ranges_and_is_spread_over_them():
    plans, places = [draw_plan(n) for n in range(20)], [find_scene(f"building-{n}") for n in range(20)]

    def spread(values: list[float], low: float, high: float, fraction: float = 0.6) -> None:
        assert low <= min(values)
        assert max(values) <= high
        assert np.ptp(values) > fraction * (high - low)

    spread([plan.levels for plan in plans], 2, 6)
    spread([plan.blocks[0].length for plan in plans], 8, 60)
    spread([float(place.base_from_camera.translation[2]) for place in places], 0.3, 1.8)
    spread([place.field_of_view_deg for place in places], 50, 110)
    spread([place.rate_hz for place in places], 4, 30)
    spread([place.noise.scale for place in places], 0.004, 0.05, 0.4)
    aside = [float(np.linalg.norm(place.base_from_camera.translation[:2])) for place in places]
    spread(aside, 0.0, 0.21, 0.4)
    forward = np.array([place.base_from_camera.rotation[0, 2] for place in places])
    assert (forward > 0.9).sum() >= 5
    assert (forward < -0.9).any()  # backwards
    assert len({len(plan.blocks) for plan in plans}) == 2  # with and without a wing
    for plan in plans:
        assert plan.slots("room")
        assert plan.slots("stairs")
        assert 2.2 < plan.clear < plan.storey
        assert 0.14 < plan.storey / 2 / plan.stairs.risers < 0.20  # metres, of a step


def test_no_two_buildings_are_alike():
    places = [find_scene(f"building-{n}") for n in range(20)]
    assert len({replace(draw_plan(n), number=0) for n in range(20)}) == 20
    assert len({(p.field_of_view_deg, *p.base_from_camera.translation, p.noise.scale) for p in places}) == 20


def test_a_room_overlaps_no_other_one_and_no_corridor():
    for number in range(12):
        plan, boxes = draw_plan(number), []
        for block, slot in plan.slots("room", "stairs"):
            if slot.kind == "room":
                room = layout(plan, slot, 0)
                size = np.array([room.width, room.depth])
            else:
                size = np.array([plan.stairs.width, plan.stairs.depth])
            boxes.append(plan.frame_of(block, slot).points(np.array([[0.0, 0.0], size])))
        boxes += [b.frame.points(np.array([[0.0, 0.0], [b.length, b.width]])) for b in plan.blocks]
        for first, second in combinations(boxes, 2):
            gap = np.maximum(first.min(axis=0), second.min(axis=0)) - np.minimum(first.max(axis=0), second.max(axis=0))
            assert gap.max() > -1e-6, f"building {number}"


@pytest.mark.parametrize(
    "name", ["building", "building-", "building--1", "building-07", "building-1000000", "building-7x"]
)
def test_names_of_no_building_are_refused(name):
    assert not is_scene(name)
    with pytest.raises(
        SequenceError, match=f"unknown scene '{name}', expected one of staircase, .* such as building-7"
    ):
        synthesize(name, seed=0, num_frames=1)


# --- the same and not the same ---------------------------------------------------------------------


def test_floors_look_the_same_where_nothing_unique_shows():
    plan, scene = draw_plan(0), matt()
    assert set(plan.styles) == {0}
    eyes = (walk(0, "train", 0, 200.0) @ find_scene("building-0").base_from_camera)[::400]
    lower = (eyes.translation[:, 2] > 0) & (eyes.translation[:, 2] < (plan.levels - 2) * plan.storey)
    above = raised(eyes, plan, 1)
    unseen = ~sees_cue(scene, CAMERA, eyes, min_fraction=1e-9) & ~sees_cue(scene, CAMERA, above, min_fraction=1e-9)
    chosen = np.flatnonzero(lower & unseen)
    assert len(chosen) >= 5
    for index in chosen:
        assert views.fraction_that_differs(picture(scene, eyes[index]), picture(scene, above[index])) < 0.02
    aside = views.shifted(eyes, 0.15, 0.1, 0.0)
    steps = [views.fraction_that_differs(picture(scene, eyes[i]), picture(scene, aside[i])) for i in chosen]
    assert np.median(steps) > 0.1  # the measure does see a step aside


def test_a_picture_tells_its_floor():
    plan, scene = draw_plan(0), matt()
    seen = []
    for thing in unique_things(plan):
        offset, heading = thing.offsets[0], float(np.asarray(thing.headings)[0])
        level = round(offset[2] / plan.storey)
        width = max(quad[0][0] + max(quad[1][0], 0) for quad in thing.part.quads)
        cos, sin = np.cos(heading), np.sin(heading)
        middle = offset[:2] + width / 2 * np.array([cos, sin])
        eye = np.array([*(middle + 0.9 * np.array([-sin, cos])), level * plan.storey + 1.4])
        forward, right = np.array([sin, -cos, 0.0]), np.array([-cos, -sin, 0.0])
        pose = Poses(np.stack([right, np.cross(forward, right), forward], axis=1), eye)
        other = raised(pose, plan, 1 if level == 0 else -1)
        if sees_cue(scene, CAMERA, Poses.stack([pose, other])).tolist() == [True, False]:
            seen.append(views.fraction_that_differs(picture(scene, pose), picture(scene, other)))
    assert len(seen) >= 2
    assert min(seen) > 0.03


def test_light_differs_from_walk_to_walk_and_people_stand_about_on_test_walks_alone():
    plan = draw_plan(5)
    trained = [draw_visit(plan, "train", seed) for seed in range(10)]
    tested = [draw_visit(plan, "test", seed) for seed in range(10)]
    assert not any(visit.people for visit in trained)
    assert sum(bool(visit.people) for visit in tested) >= 8
    assert len({visit.people for visit in tested}) == 10
    assert len({visit.lamps for visit in trained + tested}) == 20
    assert min(visit.daylight for visit in tested) < 0.1  # at night
    assert min(visit.daylight for visit in trained) >= 0.5


# --- walks -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("number", [1, 2, 8])
def test_no_walk_comes_near_to_a_wall_furniture_or_people_and_all_stay_inside(number):
    plan, place = draw_plan(number), find_scene(f"building-{number}")
    for split in ("train", "test"):
        tracer = Tracer(assemble(placements(plan, draw_visit(plan, split, 1))))
        base = walk(number, split, 1)
        views.require_free(tracer, (base @ place.base_from_camera).translation)
        origin, ray = views.from_all(base.translation[::10] + np.array([0, 0, 0.6]))  # the waist
        assert not tracer.blocked(origin, 0.25 * ray * (1, 1, 0)).any()


def test_the_body_walks_on_the_floor_and_on_steps():
    plan = draw_plan(7)
    tracer = Tracer(assemble(placements(plan, draw_visit(plan, "train", 0))))
    base = walk(7, "train", 0, 120.0).translation[::10]
    _, _, _, below = tracer.first_hit(base + np.array([0, 0, 0.5]), np.tile([[0.0, 0.0, -1.0]], (len(base), 1)))
    assert abs(np.median(below) - 0.5) < 0.02
    assert np.abs(below - 0.5).max() < 0.2  # a riser
    assert np.ptp(base[:, 2]) > plan.storey  # and did go upstairs


@pytest.mark.parametrize("split", ["train", "test"])
def test_walks_are_continuous_and_as_fast_as_someone_who_walks(split):
    for number in range(6):
        base = walk(number, split, number)
        speed = np.linalg.norm(np.diff(base.translation, axis=0), axis=1) / 0.02
        assert 0.3 < np.median(speed) < 1.2
        assert speed.max() < 1.4
        assert np.linalg.norm(np.diff(base.translation, 2, axis=0), axis=1).max() < 0.02 * 0.2  # 10 m/s²: no jerks
        _, turned = base[:-1].distance(base[1:])
        assert turned.max() < 0.02 * 2.6  # radians in 20 ms


def test_five_training_walks_go_everywhere_and_begin_and_end_apart():
    net = ways(draw_plan(7))
    long_enough_s = net.lengths_m()[-1] / TRAINING_WALKS / 0.4
    walks = [walk(7, "train", seed, long_enough_s).translation for seed in range(TRAINING_WALKS)]
    been = np.concatenate(walks)[::5]
    for station in net.tour:
        for point in station.visit:
            assert np.linalg.norm(been - point, axis=1).min() < 0.3
    for index in (0, -1):
        for first, second in combinations([line[index] for line in walks], 2):
            assert np.linalg.norm(first - second) > 1.0


def test_a_walk_keeps_away_from_people():
    plan = draw_plan(5)
    for seed in range(4):
        visit = draw_visit(plan, "test", seed)
        base = walk_building(plan, visit, 60.0, rng=np.random.default_rng(seed)).translation
        for level, spot, _ in visit.people:
            assert np.linalg.norm(base - (spot.x, spot.y, level * plan.storey), axis=1).min() > 0.5


# --- sequences -------------------------------------------------------------------------------------


def test_a_sequence_has_the_rate_the_extrinsics_and_the_field_of_view_of_its_building():
    place = find_scene(SMALL)
    sequence = synthesize(SMALL, seed=1, num_frames=5, width=32, height=24)
    assert sequence.base_from_camera is place.base_from_camera
    assert 2 * np.degrees(np.arctan(16 / sequence.camera.fx)) == pytest.approx(place.field_of_view_deg)
    assert np.diff(sequence.image_times_ns) == pytest.approx(1e9 / place.rate_hz, abs=1)
