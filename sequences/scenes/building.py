"""Buildings by number: what a plan looks like when it is built, and who and what light is there on a visit.

What is alike, on several levels or in several rooms, is one part that is placed many times; what is unique hangs
beside it.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise
from typing import TypeAlias

import numpy as np

from sequences.scenes import building_paint as paint
from sequences.scenes import furniture, texture
from sequences.scenes.building_paint import Palette
from sequences.scenes.building_plan import DOOR_HEIGHT, DOOR_WIDTH, Block, Plan, Slot, Spot
from sequences.scenes.building_rooms import Layout, layout, pieces_of
from sequences.scenes.mesh import Part, Placement
from sequences.scenes.texture import Material, plain

_Pair: TypeAlias = tuple[float | int, float | int]
_Corner: TypeAlias = tuple[float | int, float | int, float | int]

_JAMB = 0.1  # metres of wall that stay beside openings as wide as what is behind
_TRIM_WIDTH, _TRIM_DEPTH = 0.07, 0.025
_LONGEST_STRIP = 5.0  # of a wall or floor that is lit in one piece
_PANE_DEPTH = 0.2
_METAL = Material(texture.brushed, gloss=0.6)
_RAIL_HEIGHT = 0.95


@dataclass(frozen=True)
class Visit:
    """What differs from one walk through a building to another.

    Attributes:
        lamps, daylight: How bright they are, 1 as usual.
        tint: Colour of the lamps.
        people: Level and place of everyone who stands about, in the world, and a number that says who.
    """

    lamps: float = 1.0
    daylight: float = 1.0
    tint: tuple[float, float, float] = (1.0, 0.95, 0.88)
    people: tuple[tuple[int, Spot, int], ...] = ()


@dataclass(frozen=True)
class _Hole:
    """In a wall: from where to where along it, how high, metres; what is behind."""

    begin: float
    end: float
    low: float
    high: float
    pane: Material | None = None
    deep: float = _PANE_DEPTH  # 0 leaves it as it is


@dataclass(frozen=True)
class _Looks:
    """What a building is made of on a visit."""

    palettes: tuple[Palette, ...]
    lamp: Material
    pane: Material
    lamp_size: tuple[float, float]
    lamp_spacing: float

    @property
    def pane_frame(self) -> Material:
        return self.palettes[0].trim


@cache
def palettes(plan: Plan) -> tuple[Palette, ...]:
    """How the levels of each style are painted."""
    return tuple(paint.draw_palette(plan.rng(1, style), len(plan.kinds)) for style in range(max(plan.styles) + 1))


def placements(plan: Plan, visit: Visit) -> list[Placement]:
    """Everything in the building: x along the main corridor, y across, z up, the lowest floor at z = 0."""
    rng = plan.rng(5)
    strip = bool(rng.random() < 0.5)
    looks = _Looks(
        palettes(plan),
        replace(texture.lit(visit.tint, 8.0 * visit.lamps), glare=0.3),
        paint.outdoors(plan.rng(6), 7.0 * visit.daylight),
        (1.2, 0.2) if strip else (0.6, 0.6),
        float(rng.uniform(2.4, 4.5)),
    )
    placed = []
    for style in sorted(set(plan.styles)):
        levels = [level for level in range(plan.levels) if plan.styles[level] == style]
        for index, block in enumerate(plan.blocks):
            placed.append(_placed(_corridor(plan, index, looks, style), [block.frame], levels, plan))
        placed += _rooms(plan, looks, style, levels)
    placed += _pieces(plan)
    placed += _stairwells(plan, looks)
    placed += unique_things(plan)
    for k, (level, spot, who) in enumerate(visit.people):
        someone = furniture.person(np.random.default_rng([plan.number, who, k]))
        placed.append(_placed(someone, [spot], [level], plan))
    return placed


def _placed(part: Part, spots: list[Spot], levels: list[int], plan: Plan) -> Placement:
    """A part at every spot of every level, lit as in the middle of them."""
    offsets = np.array([[spot.x, spot.y, level * plan.storey] for level in levels for spot in spots])
    headings = np.array([spot.heading for _ in levels for spot in spots])
    return Placement(part, offsets, headings, lit_at=len(offsets) // 2)


# --- walls -----------------------------------------------------------------------------------------


def _wall(
    part: Part,
    start: _Pair,
    end: _Pair,
    heights: _Pair,
    material: Material,
    holes: list[_Hole],
    trim: Material,
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


def _on_wall(part: Part, spot: Spot, low: _Corner, high: _Corner, material: Material) -> None:
    """A box told in the frame of a wall: x along it, y out of it; for frames that are turned by quarters."""
    corners = spot.points(np.array([low[:2], high[:2]]))
    first, second = np.array([*corners[0], low[2]]), np.array([*corners[1], high[2]])
    part.box(np.minimum(first, second), np.maximum(first, second), material)


def _trimmed(part: Part, spot: Spot, width: float, height: float, trim: Material) -> None:
    """A frame around an opening that begins at the spot of a wall."""
    w, t = _TRIM_WIDTH, _TRIM_DEPTH
    _on_wall(part, spot, (-w, 0, 0), (0, t, height + w), trim)
    _on_wall(part, spot, (width, 0, 0), (width + w, t, height + w), trim)
    _on_wall(part, spot, (0, 0, height), (width, t, height + w), trim)


def leaf(part: Part, spot: Spot, material: Material) -> None:
    """A closed door: its leaf, which begins at the spot of a wall, and a handle."""
    corner, further = spot.points(np.array([[0.0, 0.012], [DOOR_WIDTH, 0.012]]))
    part.quad((*further, 0), (*(corner - further), 0), (0, 0, DOOR_HEIGHT), material)
    _on_wall(part, spot, (0.07, 0.012, 1.02), (0.2, 0.06, 1.045), _METAL)


def _slab(part: Part, x1: float, y1: float, z: float, material: Material, upward: bool) -> None:
    """A floor or a ceiling of a space from (0, 0) to (x1, y1)."""
    for k in range(count := int(np.ceil(x1 / _LONGEST_STRIP))):
        a, step = x1 * k / count, x1 / count
        if upward:
            part.quad((a, 0, z), (step, 0, 0), (0, y1, 0), material)
        else:
            part.quad((a, y1, z), (step, 0, 0), (0, -y1, 0), material)


def _lamps(part: Part, x1: float, y1: float, z: float, spacing: float, looks: _Looks) -> None:
    """Lamps below the ceiling of a space from (0, 0) to (x1, y1)."""
    a, b = looks.lamp_size if x1 >= y1 else looks.lamp_size[::-1]
    for x in (np.arange(max(1, round(x1 / spacing))) + 0.5) * x1 / max(1, round(x1 / spacing)):
        for y in (np.arange(max(1, round(y1 / spacing))) + 0.5) * y1 / max(1, round(y1 / spacing)):
            low, high = (x - a / 2, y - b / 2, z - 0.07), (x + a / 2, y + b / 2, z)
            part.box(low, high, looks.lamp, "z")
            part.box(low, high, plain((0.55, 0.55, 0.53)), "xXyY")


# --- corridors and rooms ---------------------------------------------------------------------------


def _opening(plan: Plan, slot: Slot) -> tuple[float, float, float]:
    """Of a slot in the wall of the corridor: from where to where along it, and how high."""
    if slot.kind in ("stairs", "wing"):
        return slot.begin + _JAMB, slot.end - _JAMB, min(2.5, plan.clear - 0.12)
    return slot.door - DOOR_WIDTH / 2, slot.door + DOOR_WIDTH / 2, DOOR_HEIGHT


def wall_spot(block: Block, high: bool, x: float) -> Spot:
    """The frame of a corridor's wall, in the block: x along the wall, y out of it; it begins at x of the block."""
    return Spot(x, block.width, np.pi) if high else Spot(x, 0.0, 0.0)


def free_walls(plan: Plan, block: Block, shortest: float) -> list[tuple[bool, float, float]]:
    """Where the walls of a corridor have neither doors nor windows: side, begin and end along the corridor."""
    free = []
    for high in (False, True):
        reached = 0.25
        for slot in sorted((s for s in block.slots if s.high == high), key=lambda s: s.begin):
            begin, end, _ = _opening(plan, slot)
            if slot.kind == "window":
                begin, end = slot.begin, slot.end
            if begin - 0.15 - reached >= shortest:
                free.append((high, reached, begin - 0.15))
            reached = end + 0.15
        if block.length - 0.25 - reached >= shortest:
            free.append((high, reached, block.length - 0.25))
    return free


def _corridor(plan: Plan, index: int, looks: _Looks, style: int) -> Part:
    part, block, palette = Part(), plan.blocks[index], looks.palettes[style]
    length, width, clear = block.length, block.width, plan.clear
    _slab(part, length, width, 0.0, palette.corridor_floor, True)
    _slab(part, length, width, clear, palette.ceiling, False)
    holes: dict[bool, list[_Hole]] = {False: [], True: []}
    for slot in block.slots:
        begin, end, top = _opening(plan, slot)
        low_side = wall_spot(block, slot.high, end if slot.high else begin)
        if slot.kind == "window":
            size = min(slot.end - slot.begin - 0.6, 2.4)
            if size > 0.5:
                at = (slot.door - size / 2, slot.door + size / 2)
                holes[slot.high].append(_Hole(*at, 0.9, min(2.2, clear - 0.2), looks.pane))
        elif slot.kind == "door":
            leaf(part, low_side, palette.doors[slot.look % len(palette.doors)])
            _trimmed(part, low_side, DOOR_WIDTH, DOOR_HEIGHT, palette.trim)
        else:
            holes[slot.high].append(_Hole(begin, end, 0.0, top, deep=plan.wall))
            if slot.kind == "room":
                _trimmed(part, low_side, DOOR_WIDTH, DOOR_HEIGHT, palette.trim)
    wall, trim, rng = palette.corridor_wall, palette.trim, plan.rng(7, index)
    mirrored = [replace(hole, begin=length - hole.end, end=length - hole.begin) for hole in holes[False]]
    _wall(part, (length, 0), (0, 0), (0, clear), wall, mirrored, trim)
    _wall(part, (0, width), (length, width), (0, clear), wall, holes[True], trim)
    window = [_Hole(0.3, width - 0.3, 0.9, min(2.2, clear - 0.2), looks.pane)]
    first, last = (window if rng.random() < 0.6 else [] for _ in range(2))
    if block.open_start:
        first = [_Hole(_JAMB, width - _JAMB, 0.0, min(2.5, clear - 0.12), deep=0.0)]
    _wall(part, (0, 0), (0, width), (0, clear), wall, first, trim)
    _wall(part, (length, width), (length, 0), (0, clear), wall, last, trim)
    _lamps(part, length, width, clear, looks.lamp_spacing, looks)
    if rng.random() < 0.6:
        _extinguishers(part, plan, block, rng)
    return part


def _extinguishers(part: Part, plan: Plan, block: Block, rng: np.random.Generator) -> None:
    red = plain((0.55, 0.03, 0.025), gloss=0.6)
    for high, begin, _ in free_walls(plan, block, 1.5):
        if rng.random() < 0.3:
            x, y = wall_spot(block, high, begin + 0.2).points(np.array([[0.0, 0.08]]))[0]
            part.beam((x, y, 0.6), (x, y, 1.05), 0.065, red, 8)
            part.beam((x, y, 1.05), (x, y, 1.15), 0.03, plain((0.03, 0.03, 0.03)), 6)


def _rooms(plan: Plan, looks: _Looks, style: int, levels: list[int]) -> list[Placement]:
    """The rooms of one style: those with the same layout are one part."""
    spots: dict[int, list[Spot]] = defaultdict(list)
    rooms: dict[int, tuple[Layout, int]] = {}
    for block, slot in plan.slots("room"):
        room = layout(plan, slot, style)
        rooms[id(room)] = room, slot.look
        spots[id(room)].append(plan.frame_of(block, slot))
    return [_placed(_room(plan, *rooms[key], looks, style), spots[key], levels, plan) for key in rooms]


def _room(plan: Plan, room: Layout, look: int, looks: _Looks, style: int) -> Part:
    part, palette, clear = Part(), looks.palettes[style], plan.clear
    width, depth = room.width, room.depth
    wall, trim = palette.room_walls[look], palette.trim
    _slab(part, width, depth, 0.0, palette.room_floors[look], True)
    _slab(part, width, depth, clear, palette.ceiling, False)
    begin, end = room.door - DOOR_WIDTH / 2, room.door + DOOR_WIDTH / 2
    _wall(
        part,
        (width, 0),
        (0, 0),
        (0, clear),
        wall,
        [_Hole(width - end, width - begin, 0.0, DOOR_HEIGHT, deep=0.0)],
        trim,
    )
    _wall(part, (0, 0), (0, depth), (0, clear), wall, [], trim)
    panes = [_Hole(a, b, low, high, looks.pane) for a, b, low, high in room.windows]
    _wall(part, (0, depth), (width, depth), (0, clear), wall, panes, trim)
    _wall(part, (width, depth), (width, 0), (0, clear), wall, [], trim)
    _trimmed(part, Spot(begin, 0.0, 0.0), DOOR_WIDTH, DOOR_HEIGHT, trim)
    if room.leaf is not None:
        painted = palette.doors[look % len(palette.doors)]
        part.box((room.leaf[0], 0.04, 0), (room.leaf[1], 0.08, DOOR_HEIGHT), painted)
    _lamps(part, width, depth, clear, max(2.6, looks.lamp_spacing), looks)
    return part


def _pieces(plan: Plan) -> list[Placement]:
    """Furniture: one part for each type, wherever it stands."""
    offsets: dict[str, list[tuple[float, float, float]]] = defaultdict(list)
    headings: dict[str, list[float]] = defaultdict(list)
    parts = {name: piece.part for name, piece in pieces_of(plan).items()}
    for level, style in enumerate(plan.styles):
        for block, slot in plan.slots("room"):
            room, frame = layout(plan, slot, style), plan.frame_of(block, slot)
            for name, local in room.pieces:
                spot = local.within(frame)
                offsets[name].append((spot.x, spot.y, level * plan.storey))
                headings[name].append(spot.heading)
    return [Placement(parts[name], np.array(at), np.array(headings[name])) for name, at in offsets.items()]


# --- stairs ----------------------------------------------------------------------------------------


def _stairwells(plan: Plan, looks: _Looks) -> list[Placement]:
    """All stairwells: storeys alike, and what closes them at the bottom and at the top."""
    spots = [plan.frame_of(block, slot) for block, slot in plan.slots("stairs")]
    levels, top, palette = list(range(plan.levels)), plan.levels - 1, looks.palettes[0]
    return [
        _placed(_storey_walls(plan, palette), spots, levels, plan),
        _placed(_landing(plan, looks, palette), spots, levels[1:], plan),
        _placed(_flights(plan, looks, palette), spots, levels[:-1], plan),
        _placed(_bottom(plan, palette), spots, [0], plan),
        _placed(_landing_lamp(plan, looks), spots, levels[:-1], plan),
        _placed(_top(plan, looks, palette), spots, [top], plan),
        _placed(_low_panel(plan, palette), spots, [0], plan),
        _placed(_guard(plan, palette), spots, [top], plan),
    ]


def _storey_walls(plan: Plan, palette: Palette) -> Part:
    part, stairs = Part(), plan.stairs
    w, d, high, wall = stairs.width, stairs.depth, plan.storey, palette.stair_wall
    opening = _Hole(_JAMB, w - _JAMB, 0.0, min(2.5, plan.clear - 0.12), deep=0.0)
    _wall(part, (w, 0), (0, 0), (0, high), wall, [opening], palette.trim)
    _wall(part, (0, 0), (0, d), (0, high), wall, [], palette.trim)
    _wall(part, (w, d), (w, 0), (0, high), wall, [], palette.trim)
    return part


def _landing(plan: Plan, looks: _Looks, palette: Palette) -> Part:
    part, stairs = Part(), plan.stairs
    low, high = (0.0, 0.0, -plan.slab), (stairs.width, stairs.landing, 0.0)
    part.box(low, high, palette.stair_floor, "Z")
    part.box(low, high, palette.ceiling, "zY")
    return part


def _landing_lamp(plan: Plan, looks: _Looks) -> Part:
    part, x, y, z = Part(), plan.stairs.width / 2, plan.stairs.landing / 2, plan.clear
    part.box((x - 0.3, y - 0.3, z - 0.07), (x + 0.3, y + 0.3, z), looks.lamp, "z")
    part.box((x - 0.3, y - 0.3, z - 0.07), (x + 0.3, y + 0.3, z), plain((0.55, 0.55, 0.53)), "xXyY")
    return part


def _flights(plan: Plan, looks: _Looks, palette: Palette) -> Part:
    """Two flights and the half landing, with the wall and the window behind it."""
    part, stairs = Part(), plan.stairs
    half, n, g = plan.storey / 2, stairs.risers, stairs.going
    rise, near, far = half / n, stairs.landing, stairs.landing + stairs.run
    for k in range(n - 1):
        z = (k + 1) * rise
        (a, b), (c, d) = stairs.up_x, stairs.down_x
        y, back = near + k * g, far - k * g
        part.box((a, y, z - rise - 0.12), (b, y + g, z), palette.stair_floor, "Zy")
        part.box((a, y, z - rise - 0.12), (b, y + g, z), palette.ceiling, "xXYz")
        part.box((c, back - g, half + z - rise - 0.12), (d, back, half + z), palette.stair_floor, "ZY")
        part.box((c, back - g, half + z - rise - 0.12), (d, back, half + z), palette.ceiling, "xXyz")
    part.box((0, far, half - plan.slab), (stairs.width, stairs.depth, half), palette.stair_floor, "Z")
    part.box((0, far, half - plan.slab), (stairs.width, stairs.depth, half), palette.ceiling, "yz")
    a, b = stairs.up_x  # the last risers, below the half landing and below the floor
    part.quad((a, far, half - rise), (b - a, 0, 0), (0, 0, rise), palette.stair_floor)
    a, b = stairs.down_x
    part.quad((b, near, plan.storey - rise), (a - b, 0, 0), (0, 0, rise), palette.stair_floor)
    window = _Hole(0.45, stairs.width - 0.45, half + 0.9, half + min(2.2, plan.storey - plan.slab - 0.3), looks.pane)
    heights = (half, half + plan.storey)
    holes = [window] if plan.rng(8).random() < 0.75 else []
    _wall(part, (0, stairs.depth), (stairs.width, stairs.depth), heights, palette.stair_wall, holes, palette.trim)
    if not holes:
        middle = stairs.width / 2
        box = (middle - 0.25, stairs.depth - 0.09, half + 1.7), (middle + 0.25, stairs.depth, half + 1.95)
        part.box(*box, looks.lamp, "yz")
        part.box(*box, plain((0.5, 0.5, 0.5)), "xXZ")
    _balustrades(part, plan, palette)
    return part


def _balustrades(part: Part, plan: Plan, palette: Palette) -> None:
    """Rails on the inner side of both flights, with bars or a panel below, and across the half landing."""
    stairs, half = plan.stairs, plan.storey / 2
    near, run = stairs.landing, stairs.run
    far, rise, slope = near + run, half / stairs.risers, half / stairs.risers / stairs.going
    inner_up, inner_down = stairs.up_x[1], stairs.down_x[0]
    if stairs.mirrored:
        inner_up, inner_down = stairs.up_x[0], stairs.down_x[1]
    panel = plan.rng(9).random() < 0.35
    up = np.array([0.0, 0.0, _RAIL_HEIGHT])
    for x, y0, z0, way in ((inner_up, near, rise, 1.0), (inner_down, far, half + rise, -1.0)):
        start, along = np.array([x, y0, z0]), np.array([0.0, way * run, run * slope])
        part.beam(start + up, start + up + along, 0.028, palette.rail, 8)
        if panel:
            low = start - (0, 0, rise)
            part.quad(low, along, up, palette.rail)
            part.quad(low + along - (0.012 * way, 0, 0), -along, up, palette.rail)
            continue
        for s in np.arange(0.5, stairs.risers - 1) / (stairs.risers - 1):
            foot = start + s * along - (0, 0, rise)
            half_bar = np.array([0.01, 0.01, 0.0])
            part.box(foot - half_bar, foot + half_bar + up + (0, 0, rise), palette.rail, "xXyY")
    outer_up, outer_down = (stairs.width - 0.06, 0.06) if stairs.mirrored else (0.06, stairs.width - 0.06)
    for x, y0, z0, way in ((outer_up, near, rise, 1.0), (outer_down, far, half + rise, -1.0)):
        start, along = np.array([x, y0, z0 + 0.9]), np.array([0.0, way * run, run * slope])
        part.beam(start, start + along, 0.022, palette.rail, 6)
    for y, z in ((far + 0.03, half), (near - 0.03, plan.storey), (near - 0.03, 0.0)):
        for x in (inner_up, inner_down):
            part.box((x - 0.03, y - 0.03, z), (x + 0.03, y + 0.03, z + 1.05), palette.rail, "xXyYZ")
        a, b = min(inner_up, inner_down), max(inner_up, inner_down)
        part.beam((a, y, z + 1.0), (b, y, z + 1.0), 0.028, palette.rail, 8)


def _bottom(plan: Plan, palette: Palette) -> Part:
    part, stairs = Part(), plan.stairs
    _slab(part, stairs.width, stairs.depth, 0.0, palette.stair_floor, True)
    wall = (0, stairs.depth), (stairs.width, stairs.depth)
    _wall(part, *wall, (0, plan.storey / 2), palette.stair_wall, [], palette.trim)
    return part


def _top(plan: Plan, looks: _Looks, palette: Palette) -> Part:
    part, stairs = Part(), plan.stairs
    _slab(part, stairs.width, stairs.depth, plan.clear, palette.ceiling, False)
    wall = (0, stairs.depth), (stairs.width, stairs.depth)
    _wall(part, *wall, (plan.storey / 2, plan.clear), palette.stair_wall, [], palette.trim)
    _lamps(part, stairs.width, stairs.depth, plan.clear, 3.0, looks)
    return part


def _low_panel(plan: Plan, palette: Palette) -> Part:
    """What closes the space below the lowest flight that comes down: there is no way further."""
    part, stairs = Part(cue=True), plan.stairs
    (a, b), inner = stairs.down_x, stairs.up_x[0] if stairs.mirrored else stairs.up_x[1]
    x0, x1 = (a, inner) if stairs.mirrored else (inner, b)
    high = plan.storey - plan.storey / 2 / stairs.risers - 0.12
    material = paint.painted_door(paint.colour(plan.rng(10), 0.6, 0.25))
    part.box((x0, stairs.landing - 0.06, 0), (x1, stairs.landing, high), material, "yY")
    return part


def _guard(plan: Plan, palette: Palette) -> Part:
    """What keeps people from falling where no flight leads further up."""
    part, stairs = Part(cue=True), plan.stairs
    a, b = stairs.up_x
    y = stairs.landing - 0.03
    for z in (0.15, 0.55, 1.0):
        part.beam((a, y, z), (b, y, z), 0.028, palette.rail, 8)
    for x in np.linspace(a + 0.03, b - 0.03, 9):
        part.box((x - 0.01, y - 0.01, 0), (x + 0.01, y + 0.01, 1.0), palette.rail, "xXyY")
    return part


# --- what is unique --------------------------------------------------------------------------------


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
    """A picture somewhere in a corridor or a room."""
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
    width = min(float(rng.uniform(0.5, 1.8)), length - 0.1)
    height = min(width * float(rng.uniform(0.6, 1.4)), 1.3)
    x, z = float(rng.uniform(0.05, length - width - 0.05 + 1e-9)), 1.55 - height / 2 + float(rng.uniform(-0.15, 0.15))
    part = Part(cue=True)
    part.box((0, 0, z), (width, 0.025, z + height), plain((0.05, 0.05, 0.05)), "xXzZ")
    art = Material(paint.artwork(1000 * plan.number + which), gloss=0.1, texel_m=0.007)
    part.box((0, 0, z), (width, 0.025, z + height), art, "Y")
    return _placed(part, [Spot(x, 0.0, 0.0).within(spot)], [level], plan)


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
    """A closed door in a colour of its own."""
    doors = plan.slots("door")
    if not doors:
        return None
    block, slot = doors[int(rng.integers(len(doors)))]
    part, half = Part(cue=True), DOOR_WIDTH / 2
    part.quad(
        (DOOR_WIDTH, 0.018, 0),
        (-DOOR_WIDTH, 0, 0),
        (0, 0, DOOR_HEIGHT),
        paint.painted_door(paint.colour(rng, 1.0, 0.5)),
    )
    spot = wall_spot(block, slot.high, slot.door + half if slot.high else slot.door - half)
    return _placed(part, [spot.within(block.frame)], [level], plan)


def _signs(plan: Plan, level: int) -> list[Placement]:
    """The number of the level as bars, on the landing of every stairwell."""
    part = Part(cue=True)
    width = 0.2 + 0.12 * (level + 1)
    sign = Material(paint.level_sign(level, paint.colour(plan.rng(12, level), 1.0, 0.35)), texel_m=0.01)
    part.box((0, 0, 1.3), (width, 0.01, 1.9), sign, "Y")
    spots = [
        Spot(0.0, 0.15 + width, -np.pi / 2).within(plan.frame_of(block, slot)) for block, slot in plan.slots("stairs")
    ]
    return [_placed(part, spots, [level], plan)]


def _entrance(plan: Plan) -> list[Placement]:
    """On the lowest level: a mat, and a glazed door at the end of the main corridor."""
    block, rng = plan.blocks[0], plan.rng(13)
    part, width, middle = Part(cue=True), min(1.6, block.width - 0.3), block.width / 2
    frame = plain(paint.colour(rng, 0.8, 0.15), gloss=0.3)
    x0, x1 = middle - width / 2, middle + width / 2
    part.box((x0 - 0.05, 0, 0), (x1 + 0.05, 0.03, 2.3), frame, "xXYZ")
    pane = replace(paint.outdoors(rng, 1.2), glare=1.0)
    for a, b in ((x0 + 0.05, middle - 0.04), (middle + 0.04, x1 - 0.05)):
        part.quad((b, 0.035, 0.3), (a - b, 0, 0), (0, 0, 1.85), pane)
    part.box((middle - 0.12, 0.03, 0.95), (middle - 0.06, 0.09, 1.25), _METAL)
    part.box((x0, 0.2, 0), (x1, 1.1, 0.008), plain(paint.colour(rng, 0.6, 0.1), amount=0.15), "Z")
    return [_placed(part, [Spot(0.0, block.width, -np.pi / 2).within(block.frame)], [0], plan)]
