"""Materials of a building, and the parts of its spaces: walls with openings, floors, ceilings, lamps, doors."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import TypeAlias

import numpy as np

from sequences.rendering import texture
from sequences.rendering.mesh import Part, Placement
from sequences.rendering.texture import Material, plain
from sequences.scenes.building.paint import (
    WALL_TEXEL_M,
    colour,
    draw_ceiling,
    draw_door,
    draw_floor,
    draw_stair_wall,
    draw_wall,
    grey,
    stone,
)
from sequences.scenes.building.plan import DOOR_HEIGHT, DOOR_WIDTH, Plan, Spot


@dataclass(frozen=True)
class Palette:
    """Paint of one storey; of rooms by their kind, of doors by a slot's look."""

    corridor_wall: Material
    stair_wall: Material
    room_walls: tuple[Material, ...]
    corridor_floor: Material
    stair_floor: Material
    room_floors: tuple[Material, ...]
    ceiling: Material
    trim: Material
    doors: tuple[Material, ...]
    rail: Material


def draw_palette(rng: np.random.Generator, num_kinds: int) -> Palette:
    """The paint of one storey."""
    floor, flagged = draw_floor(rng), draw_floor(rng)
    same_floors = rng.random() < 0.4
    return Palette(
        corridor_wall=draw_wall(rng),
        stair_wall=Material(draw_stair_wall(rng), gloss=0.1, texel_m=WALL_TEXEL_M),
        room_walls=tuple(draw_wall(rng) for _ in range(num_kinds)),
        corridor_floor=floor,
        stair_floor=stone(grey(rng)),
        room_floors=tuple(flagged if same_floors else draw_floor(rng) for _ in range(num_kinds)),
        ceiling=draw_ceiling(rng),
        trim=plain(grey(rng, 0.25, 0.6), gloss=0.2),
        doors=tuple(draw_door(rng) for _ in range(1 + rng.integers(3))),
        rail=plain(colour(rng, 0.6, 0.12) if rng.random() < 0.5 else grey(rng, 0.05, 0.3), gloss=0.5),
    )


@dataclass(frozen=True)
class Looks:
    """Materials of a building on a visit: paint by style, lamps, the view from windows; lengths in metres."""

    palettes: tuple[Palette, ...]
    lamp: Material
    pane: Material
    lamp_size: tuple[float, float]
    lamp_spacing: float


@cache
def palettes(plan: Plan) -> tuple[Palette, ...]:
    """The paint of each style."""
    return tuple(draw_palette(plan.rng(1, style), len(plan.kinds)) for style in range(max(plan.styles) + 1))


_Pair: TypeAlias = tuple[float | int, float | int]
_Corner: TypeAlias = tuple[float | int, float | int, float | int]
JAMB = 0.1  # metres of wall that stay beside openings as wide as what is behind
_TRIM_WIDTH, _TRIM_DEPTH = 0.07, 0.025
_LONGEST_STRIP = 5.0  # of a wall or floor that is lit in one piece
_PANE_DEPTH = 0.2
METAL = Material(texture.brushed, gloss=0.6)


@dataclass(frozen=True)
class Hole:
    """An opening in a wall: limits along it and in height, metres, and the pane behind."""

    begin: float
    end: float
    low: float
    high: float
    pane: Material | None = None
    deep: float = _PANE_DEPTH  # 0 leaves it as it is


def place_copies(part: Part, spots: list[Spot], levels: list[int], plan: Plan) -> Placement:
    """A part at every spot of every level, lit as in the middle of them."""
    offsets = np.array([[spot.x, spot.y, level * plan.storey] for level in levels for spot in spots])
    headings = np.array([spot.heading for _ in levels for spot in spots])
    return Placement(part, offsets, headings, lit_at=len(offsets) // 2)


def add_wall(
    part: Part, start: _Pair, end: _Pair, heights: _Pair, material: Material, holes: list[Hole], trim: Material
) -> None:
    """A wall with holes, seen from the right of the way from start to end, with what closes the holes."""
    along = np.subtract(end, start)
    length = float(np.hypot(*along))
    d = np.array([*(along / length), 0.0])
    out, up = np.array([-d[1], d[0], 0.0]), np.array([0.0, 0.0, 1.0])
    foot, low, high = np.array([*start, 0.0]), float(heights[0]), float(heights[1])

    def strip(a: float, b: float, z0: float, z1: float) -> None:
        if b - a < 1e-6 or z1 - z0 < 1e-6:
            return
        for k in range(count := int(np.ceil((b - a) / _LONGEST_STRIP))):
            step = (b - a) / count
            part.quad(foot + d * (a + k * step) + up * z0, d * step, up * (z1 - z0), material)

    reached = 0.0
    for hole in sorted(holes, key=lambda hole: hole.begin):
        strip(reached, hole.begin, low, high)
        strip(hole.begin, hole.end, low, hole.low)
        strip(hole.begin, hole.end, hole.high, high)
        reached = hole.end
        if not hole.deep:
            continue
        a, b = foot + d * hole.begin, foot + d * hole.end
        deep, tall = out * hole.deep, up * (hole.high - hole.low)
        part.quad(a + up * hole.low, deep, tall, trim)
        part.quad(b + up * hole.low + deep, -deep, tall, trim)
        part.quad(a + up * hole.high, deep, b - a, trim)
        part.quad(a + up * hole.low, b - a, deep, trim)
        if hole.pane is not None:
            part.quad(a + up * hole.low + deep, b - a, tall, hole.pane)
            for s in np.linspace(0, hole.end - hole.begin, 1 + max(1, round((hole.end - hole.begin) / 0.9))):
                corner = np.clip(s - 0.03, 0, hole.end - hole.begin - 0.06)
                first = a + d * corner + up * hole.low + 0.98 * deep
                second = a + d * (corner + 0.06) + up * hole.high + 0.8 * deep
                part.box(np.minimum(first, second), np.maximum(first, second), trim)
    strip(reached, length, low, high)


def add_box_on_wall(part: Part, spot: Spot, low: _Corner, high: _Corner, material: Material) -> None:
    """A box in the frame of a wall: x along it, y out of it; the frame is turned by quarters."""
    corners = spot.points(np.array([low[:2], high[:2]]))
    first, second = np.array([*corners[0], low[2]]), np.array([*corners[1], high[2]])
    part.box(np.minimum(first, second), np.maximum(first, second), material)


def add_trim(part: Part, spot: Spot, width: float, height: float, trim: Material) -> None:
    """A frame around an opening that begins at the spot of a wall."""
    w, t = _TRIM_WIDTH, _TRIM_DEPTH
    add_box_on_wall(part, spot, (-w, 0, 0), (0, t, height + w), trim)
    add_box_on_wall(part, spot, (width, 0, 0), (width + w, t, height + w), trim)
    add_box_on_wall(part, spot, (0, 0, height), (width, t, height + w), trim)


def add_leaf(part: Part, spot: Spot, material: Material) -> None:
    """A closed door: its leaf, which begins at the spot of a wall, and a handle."""
    corner, further = spot.points(np.array([[0.0, 0.012], [DOOR_WIDTH, 0.012]]))
    part.quad((*further, 0), (*(corner - further), 0), (0, 0, DOOR_HEIGHT), material)
    add_box_on_wall(part, spot, (0.07, 0.012, 1.02), (0.2, 0.06, 1.045), METAL)


def add_slab(part: Part, x1: float, y1: float, z: float, material: Material, upward: bool) -> None:
    """A floor or a ceiling of a space from (0, 0) to (x1, y1)."""
    for k in range(count := int(np.ceil(x1 / _LONGEST_STRIP))):
        a, step = x1 * k / count, x1 / count
        if upward:
            part.quad((a, 0, z), (step, 0, 0), (0, y1, 0), material)
        else:
            part.quad((a, y1, z), (step, 0, 0), (0, -y1, 0), material)


def add_lamps(part: Part, x1: float, y1: float, z: float, spacing: float, looks: Looks) -> None:
    """Lamps below the ceiling of a space from (0, 0) to (x1, y1)."""
    a, b = looks.lamp_size if x1 >= y1 else looks.lamp_size[::-1]
    for x in (np.arange(max(1, round(x1 / spacing))) + 0.5) * x1 / max(1, round(x1 / spacing)):
        for y in (np.arange(max(1, round(y1 / spacing))) + 0.5) * y1 / max(1, round(y1 / spacing)):
            low, high = (x - a / 2, y - b / 2, z - 0.07), (x + a / 2, y + b / 2, z)
            part.box(low, high, looks.lamp, "z")
            part.box(low, high, plain((0.55, 0.55, 0.53)), "xXyY")
