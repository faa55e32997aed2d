"""Places by name: a scene, and who moves through it with which camera and which odometry."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, lru_cache

import numpy as np

from filtering.se3 import Poses
from sequences.errors import SequenceError
from sequences.odometry import OdometryNoise
from sequences.scenes import building, ceiling, corridor, staircase, tables
from sequences.scenes.building import Visit
from sequences.scenes.building_plan import Plan, draw_plan
from sequences.scenes.building_walk import draw_people, walk_building
from sequences.scenes.light import Sampling
from sequences.scenes.mesh import Placement
from sequences.scenes.paths import circle_table, roll_through_hall, walk_corridor, walk_stairs
from sequences.scenes.surface import Scene, build_scene

SCENES: tuple[str, ...] = ("staircase", "ceiling", "round-table", "dinner-table", "corridor")
"""Names of the places that there is one of each; buildings are named by number, `building-7`."""

SPLITS = {"train": 1, "test": 2}
"""The number of each split, in seeds."""

_BUILDING = 1000  # in place of the index of a scene, in seeds
_MOST_BUILDINGS = 10**6
_BUILDING_LIGHT = Sampling(grid_m=0.18, shadow_rays=9, bounce_rays=48, reach_m=7.0)
_RATES_HZ = (4.0, 5.0, 6.0, 7.5, 8.0, 10.0, 12.0, 15.0, 20.0, 24.0, 25.0, 30.0)


@dataclass(frozen=True)
class Place:
    """Where a sequence is taken, and how.

    Attributes:
        name: As `find_place` takes it.
        field_of_view_deg: Of the camera, horizontal.
        base_from_camera: One pose, the extrinsics.
        rate_hz: Images a second where no other rate is asked for.
        noise: Of the odometry where none is asked for.
        entropy: Tells the random numbers of its walks from those of other places.
        scene: The scene of a split and a seed: what is seen may differ from walk to walk.
        path: Poses of the body every 20 ms for a duration in seconds, a split and a seed; of the path all that the seed
            leaves open is drawn from the generator.
    """

    name: str
    field_of_view_deg: float
    base_from_camera: Poses
    rate_hz: float
    noise: OdometryNoise
    entropy: tuple[int, ...]
    scene: Callable[[str, int], Scene]
    path: Callable[[float, str, int, np.random.Generator], Poses]


def is_place(name: str) -> bool:
    """Whether there is a place of this name."""
    return name in SCENES or _building_number(name) is not None


@cache
def find_place(name: str) -> Place:
    """A place by name: one of `SCENES`, or a building such as `building-7`.

    Raises:
        SequenceError: there is none of this name.
    """
    if name in SCENES:
        return _scene(name)
    number = _building_number(name)
    if number is None:
        raise SequenceError(
            f"unknown scene {name!r}, expected one of {', '.join(SCENES)},"
            f" or building-N with a number N below {_MOST_BUILDINGS}, such as building-7"
        )
    return _building(name, number)


@cache
def load_scene(name: str) -> Scene:
    """Build one of the `SCENES`, once per process."""
    placements: dict[str, Callable[[], list[Placement]]] = {
        "staircase": staircase.placements,
        "ceiling": ceiling.placements,
        "round-table": tables.round_table,
        "dinner-table": tables.dinner_table,
        "corridor": corridor.placements,
    }
    return build_scene(placements[name](), seed=0)


def _scene(name: str) -> Place:
    fields_of_view = {"staircase": 77.0, "ceiling": 64.0, "round-table": 60.0, "dinner-table": 60.0, "corridor": 70.0}

    def path(duration_s: float, split: str, seed: int, rng: np.random.Generator) -> Poses:
        if name == "staircase":
            return walk_stairs(duration_s, rng=rng)
        if name == "corridor":
            return walk_corridor(duration_s, rng=rng)
        if name.endswith("-table"):
            return circle_table(duration_s, rng=rng)
        return roll_through_hall(duration_s, margin_m=1.0 if split == "train" else 1.8, rng=rng)

    on_cart = name == "ceiling"  # looking straight up; else on a helmet, looking forward and 10° down
    return Place(
        name=name,
        field_of_view_deg=fields_of_view[name],
        base_from_camera=_upward() if on_cart else _mounted((0.06, 0.03, 0.05), 0.0, np.radians(10)),
        rate_hz=10.0,
        noise=OdometryNoise(),
        entropy=(SCENES.index(name),),
        scene=lambda split, seed: load_scene(name),
        path=path,
    )


# --- buildings -------------------------------------------------------------------------------------


def _building_number(name: str) -> int | None:
    matched = re.fullmatch(r"building-(0|[1-9][0-9]{0,5})", name)
    return int(matched[1]) if matched else None


def _building(name: str, number: int) -> Place:
    """A building with a camera and an odometry of its own, all drawn from its number."""
    plan = draw_plan(number)
    rng = plan.rng(15)
    height, field_of_view = rng.uniform(0.3, 1.8), rng.uniform(50.0, 110.0)
    toward = rng.choice([0.0, 0.0, 0.0, 0.0, 0.0, np.pi, np.pi, 0.8, -0.8]) + rng.uniform(-0.35, 0.35)
    mount = (rng.uniform(-0.15, 0.18), rng.uniform(-0.1, 0.1), height)
    down = rng.uniform(-0.12, 0.2) if height > 1.0 else rng.uniform(-0.25, 0.05)  # a low camera looks up
    low, high = np.log([[0.004, 0.002, 0.0004, 10, 0.003, 0.001], [0.05, 0.02, 0.005, 60, 0.02, 0.008]])
    errors = (float(value) for value in np.exp(rng.uniform(low, high)))
    return Place(
        name=name,
        field_of_view_deg=float(field_of_view),
        base_from_camera=_mounted((float(mount[0]), float(mount[1]), float(mount[2])), float(toward), float(down)),
        rate_hz=float(rng.choice(_RATES_HZ)),
        noise=OdometryNoise(*errors),
        entropy=(_BUILDING, number),
        scene=lambda split, seed: _visited(plan, split, seed),
        path=lambda duration_s, split, seed, rng: walk_building(
            plan, draw_visit(plan, split, seed), duration_s, training=split == "train", seed=seed, rng=rng
        ),
    )


@lru_cache(maxsize=100)
def draw_visit(plan: Plan, split: str, seed: int) -> Visit:
    """Light and people of one walk: by day and alone on training walks, at any hour and among people on others."""
    rng = plan.rng(16, SPLITS[split], seed)
    colour = (1.0, float(rng.uniform(0.85, 1.0)), float(rng.uniform(0.7, 1.0)))
    if split == "train":
        return Visit(float(rng.uniform(0.8, 1.2)), float(rng.uniform(0.5, 1.1)), colour)
    hour = float(rng.choice([0.02, 0.25, 0.8, 1.6]))  # night, dusk, overcast, sun
    return Visit(float(rng.uniform(0.5, 1.3)), hour * float(rng.uniform(0.8, 1.25)), colour, draw_people(plan, rng))


@lru_cache(maxsize=2)  # a large building takes some hundreds of megabytes
def _visited(plan: Plan, split: str, seed: int) -> Scene:
    placed = building.placements(plan, draw_visit(plan, split, seed))
    return build_scene(placed, seed=plan.number, sampling=_BUILDING_LIGHT)


# --- where the camera is mounted -------------------------------------------------------------------


def _mounted(at: tuple[float, float, float], toward: float, down: float) -> Poses:
    """base_from_camera of a camera at a point of the body that looks so many radians left of forward, and down."""
    cos, sin = np.cos(toward), np.sin(toward)
    forward = np.array([np.cos(down) * cos, np.cos(down) * sin, -np.sin(down)])
    right = np.array([sin, -cos, 0])
    return Poses(np.stack([right, np.cross(forward, right), forward], axis=1), np.array(at))


def _upward() -> Poses:
    right, up = np.array([0, -1.0, 0]), np.array([0, 0, 1.0])
    return Poses(np.stack([right, np.cross(up, right), up], axis=1), np.array([0.12, -0.04, 0.9]))
