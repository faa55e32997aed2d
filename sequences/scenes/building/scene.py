"""Buildings by number, with their unique things, and the camera and odometry of who walks through them."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np

from sequences.odometry import OdometryNoise
from sequences.rendering import texture
from sequences.rendering.light import Sampling
from sequences.rendering.mesh import Part, Placement
from sequences.rendering.texture import Material, plain
from sequences.scenes.building.layout import Layout, layout
from sequences.scenes.building.paint import artwork, colour, level_sign, outdoors, painted_door
from sequences.scenes.building.parts import METAL, Looks, palettes, place_copies
from sequences.scenes.building.plan import DOOR_HEIGHT, DOOR_WIDTH, Plan, Spot, draw_plan
from sequences.scenes.building.spaces import (
    corridor,
    free_walls,
    place_furniture,
    place_rooms,
    place_stairwells,
    wall_spot,
)
from sequences.scenes.building.walk import Visit, draw_visit, person, walk_building
from sequences.scenes.scene import Scene, mounted


@cache
def unique_things(plan: Plan) -> tuple[Placement, ...]:
    """Pictures, coloured doors, an entrance, signs of the level: each of them once."""
    rng, things = plan.rng(11), []
    for level in range(plan.levels):
        for k in range(int(rng.poisson(plan.cues_per_level)) + (level == 0)):
            thing = _doorleaf(plan, level, rng) if rng.random() < 0.2 else None
            things.append(thing or _picture(plan, level, 100 * level + k, rng))
        if plan.signs:
            things += _signs(plan, level)
    return tuple(thing for thing in things if thing is not None) + tuple(_entrance(plan))


def _picture(plan: Plan, level: int, which: int, rng: np.random.Generator) -> Placement | None:
    walls = [
        (wall_spot(block, high, end if high else begin + 0.4).within(block.frame), end - begin - 0.4)
        for block in plan.blocks
        for high, begin, end in free_walls(plan, block, 1.1)
    ]
    for block, slot in plan.slots("room"):
        room, frame = layout(plan, slot, plan.styles[level]), plan.frame_of(block, slot)
        walls += [(spot.within(frame), length) for spot, length in _bare_walls(room)]
    if not walls:
        return None
    spot, length = walls[int(rng.integers(len(walls)))]
    width = min(rng.uniform(0.5, 1.8), length - 0.1)
    height = min(width * rng.uniform(0.6, 1.4), 1.3)
    x, z = rng.uniform(0.05, length - width - 0.05 + 1e-9), 1.55 - height / 2 + rng.uniform(-0.15, 0.15)
    part = Part(cue=True)
    part.box((0, 0, z), (width, 0.025, z + height), plain((0.05, 0.05, 0.05)), "xXzZ")
    art = Material(artwork(1000 * plan.number + which), gloss=0.1, texel_m=0.007)
    part.box((0, 0, z), (width, 0.025, z + height), art, "Y")
    return place_copies(part, [Spot(x, 0.0, 0.0).within(spot)], [level], plan)


def _bare_walls(room: Layout) -> list[tuple[Spot, float]]:
    """Walls at the sides of a room that nothing high stands at: a frame, x along it, and how long it is."""
    bare = []
    for spot, at in ((Spot(0.0, room.depth, -np.pi / 2), 0.0), (Spot(room.width, 0.0, np.pi / 2), room.width)):
        stands = [b for b in room.boxes if b[4] > 0.9 and b[0] <= at <= b[2]]
        edges = sorted([(0.1, 0.1), (room.depth - 0.1, room.depth - 0.1)] + [(b[1], b[3]) for b in stands])
        for (_, low), (high, _) in pairwise(edges):
            if high - low > 0.8:
                begin = room.depth - high if at == 0.0 else low
                bare.append((Spot(begin, 0.0, 0.0).within(spot), float(high - low)))
    return bare


def _doorleaf(plan: Plan, level: int, rng: np.random.Generator) -> Placement | None:
    doors = plan.slots("door")
    if not doors:
        return None
    block, slot = doors[int(rng.integers(len(doors)))]
    part, half = Part(cue=True), DOOR_WIDTH / 2
    part.quad((DOOR_WIDTH, 0.018, 0), (-DOOR_WIDTH, 0, 0), (0, 0, DOOR_HEIGHT), painted_door(colour(rng, 1.0, 0.5)))
    spot = wall_spot(block, slot.high, slot.door + half if slot.high else slot.door - half)
    return place_copies(part, [spot.within(block.frame)], [level], plan)


def _signs(plan: Plan, level: int) -> list[Placement]:
    part = Part(cue=True)
    width = 0.2 + 0.12 * (level + 1)
    sign = Material(level_sign(level, colour(plan.rng(12, level), 1.0, 0.35)), texel_m=0.01)
    part.box((0, 0, 1.3), (width, 0.01, 1.9), sign, "Y")
    spots = [
        Spot(0.0, 0.15 + width, -np.pi / 2).within(plan.frame_of(block, slot)) for block, slot in plan.slots("stairs")
    ]
    return [place_copies(part, spots, [level], plan)]


def _entrance(plan: Plan) -> list[Placement]:
    block, rng = plan.blocks[0], plan.rng(13)
    part, width, middle = Part(cue=True), min(1.6, block.width - 0.3), block.width / 2
    frame = plain(colour(rng, 0.8, 0.15), gloss=0.3)
    x0, x1 = middle - width / 2, middle + width / 2
    part.box((x0 - 0.05, 0, 0), (x1 + 0.05, 0.03, 2.3), frame, "xXYZ")
    pane = replace(outdoors(rng, 1.2), glare=1.0)
    for a, b in ((x0 + 0.05, middle - 0.04), (middle + 0.04, x1 - 0.05)):
        part.quad((b, 0.035, 0.3), (a - b, 0, 0), (0, 0, 1.85), pane)
    part.box((middle - 0.12, 0.03, 0.95), (middle - 0.06, 0.09, 1.25), METAL)
    part.box((x0, 0.2, 0), (x1, 1.1, 0.008), plain(colour(rng, 0.6, 0.1), amount=0.15), "Z")
    return [place_copies(part, [Spot(0.0, block.width, -np.pi / 2).within(block.frame)], [0], plan)]


SAMPLING = Sampling(grid_m=0.18, shadow_rays=9, bounce_rays=48, reach_m=7.0)
"""Coarser than usual, as buildings are large."""

_SEED_NUMBER = 1000  # that of all buildings; the second one is the building's own
_RATES_HZ = (4.0, 5.0, 6.0, 7.5, 8.0, 10.0, 12.0, 15.0, 20.0, 24.0, 25.0, 30.0)


def draw_scene(number: int) -> Scene:
    """A building with a camera and an odometry of its own, all drawn from its number."""
    plan = draw_plan(number)
    rng = plan.rng(15)
    height, field_of_view = rng.uniform(0.3, 1.8), rng.uniform(50.0, 110.0)
    toward = rng.choice([0.0, 0.0, 0.0, 0.0, 0.0, np.pi, np.pi, 0.8, -0.8]) + rng.uniform(-0.35, 0.35)
    mount = (rng.uniform(-0.15, 0.18), rng.uniform(-0.1, 0.1), height)
    down = rng.uniform(-0.12, 0.2) if height > 1.0 else rng.uniform(-0.25, 0.05)  # a low camera looks up
    low, high = np.log([[0.004, 0.002, 0.0004, 10, 0.003, 0.001], [0.05, 0.02, 0.005, 60, 0.02, 0.008]])
    errors = (float(value) for value in np.exp(rng.uniform(low, high)))
    return Scene(
        name=f"building-{number}",
        seed_numbers=(_SEED_NUMBER, number),
        placements=lambda split, seed: placements(plan, draw_visit(plan, split, seed)),
        path=lambda duration_s, split, seed, rng: walk_building(
            plan, draw_visit(plan, split, seed), duration_s, rng=rng
        ),
        field_of_view_deg=float(field_of_view),
        base_from_camera=mounted((float(mount[0]), float(mount[1]), float(mount[2])), float(toward), float(down)),
        has_cues=True,
        rate_hz=float(rng.choice(_RATES_HZ)),
        noise=OdometryNoise(*errors),
        changes=True,
        paint_seed=number,
        sampling=SAMPLING,
    )


def placements(plan: Plan, visit: Visit) -> list[Placement]:
    """Everything in the building: x along the main corridor, y across, z up, the lowest floor at z = 0."""
    rng = plan.rng(5)
    strip = bool(rng.random() < 0.5)
    looks = Looks(
        palettes(plan),
        replace(texture.lit(visit.tint, 8.0 * visit.lamps), glare=0.3),
        outdoors(plan.rng(6), 7.0 * visit.daylight),
        (1.2, 0.2) if strip else (0.6, 0.6),
        rng.uniform(2.4, 4.5),
    )
    placed = []
    for style in sorted(set(plan.styles)):
        levels = [level for level in range(plan.levels) if plan.styles[level] == style]
        for index, block in enumerate(plan.blocks):
            placed.append(place_copies(corridor(plan, index, looks, style), [block.frame], levels, plan))
        placed += place_rooms(plan, looks, style, levels)
    placed += place_furniture(plan)
    placed += place_stairwells(plan, looks)
    placed += unique_things(plan)
    for k, (level, spot, who) in enumerate(visit.people):
        someone = person(np.random.default_rng([plan.number, who, k]))
        placed.append(place_copies(someone, [spot], [level], plan))
    return placed
