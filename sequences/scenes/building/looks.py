"""Materials of a building: how each storey is painted, and what changes from visit to visit."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from sequences.rendering.texture import Material, plain
from sequences.scenes.building.paint.colours import WALL_TEXEL_M, colour, grey
from sequences.scenes.building.paint.floors import draw_ceiling, draw_floor, stone
from sequences.scenes.building.paint.walls import draw_door, draw_stair_wall, draw_wall
from sequences.scenes.building.plan import Plan


@dataclass(frozen=True)
class Palette:
    """How one storey is painted.

    Attributes:
        corridor_wall, stair_wall: Walls outside of rooms.
        room_walls: Walls of each kind of room.
        corridor_floor, stair_floor: Floors outside of rooms, and the steps.
        room_floors: Floor of each kind of room.
        ceiling: All ceilings.
        trim: Frames of doors and windows, radiators.
        doors: Leaves of the doors, one of few by a slot's look.
        rail: Rails and balustrades.
    """

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
    """Colours and materials of one storey, with walls and floors for so many kinds of rooms."""
    floor, flagged = draw_floor(rng), draw_floor(rng)
    same_floors = rng.random() < 0.4
    return Palette(
        corridor_wall=draw_wall(rng),
        stair_wall=Material(draw_stair_wall(rng), gloss=0.1, texel_m=WALL_TEXEL_M),
        room_walls=tuple(draw_wall(rng) for _ in range(num_kinds)),
        corridor_floor=floor,
        stair_floor=Material(stone(grey(rng)), gloss=0.5, texel_m=0.012),
        room_floors=tuple(flagged if same_floors else draw_floor(rng) for _ in range(num_kinds)),
        ceiling=draw_ceiling(rng),
        trim=plain(grey(rng, 0.25, 0.6), gloss=0.2),
        doors=tuple(draw_door(rng) for _ in range(1 + rng.integers(3))),
        rail=plain(colour(rng, 0.6, 0.12) if rng.random() < 0.5 else grey(rng, 0.05, 0.3), gloss=0.5),
    )


@dataclass(frozen=True)
class Looks:
    """What a building is made of on a visit.

    Attributes:
        palettes: How the levels of each style are painted.
        lamp, pane: The light of lamps, and what lies behind windows.
        lamp_size: Sides of a lamp, metres.
        lamp_spacing: From lamp to lamp, metres.
    """

    palettes: tuple[Palette, ...]
    lamp: Material
    pane: Material
    lamp_size: tuple[float, float]
    lamp_spacing: float


@cache
def palettes(plan: Plan) -> tuple[Palette, ...]:
    """How the levels of each style are painted."""
    return tuple(draw_palette(plan.rng(1, style), len(plan.kinds)) for style in range(max(plan.styles) + 1))
