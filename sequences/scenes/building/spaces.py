"""The corridors, rooms and stairwells of a building."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace

import numpy as np

from sequences.rendering.mesh import Part, Placement
from sequences.rendering.texture import plain
from sequences.scenes.building.layout import Layout, layout, pieces_of
from sequences.scenes.building.paint import colour, painted_door
from sequences.scenes.building.parts import (
    JAMB,
    Hole,
    Looks,
    Palette,
    add_lamps,
    add_leaf,
    add_slab,
    add_trim,
    add_wall,
    place_copies,
)
from sequences.scenes.building.plan import DOOR_HEIGHT, DOOR_WIDTH, Block, Plan, Slot, Spot


def wall_spot(block: Block, high: bool, x: float) -> Spot:
    """The frame of a corridor's wall, in the block: x along the wall, y out of it; it begins at x of the block."""
    return Spot(x, block.width, np.pi) if high else Spot(x, 0.0, 0.0)


def free_walls(plan: Plan, block: Block, shortest: float) -> list[tuple[bool, float, float]]:
    """Stretches of a corridor's walls without doors and windows: side, begin and end along the corridor."""
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


def corridor(plan: Plan, index: int, looks: Looks, style: int) -> Part:
    """The corridor of a block, on the levels of one style, without the spaces behind its openings."""
    part, block, palette = Part(), plan.blocks[index], looks.palettes[style]
    length, width, clear = block.length, block.width, plan.clear
    add_slab(part, length, width, 0.0, palette.corridor_floor, True)
    add_slab(part, length, width, clear, palette.ceiling, False)
    holes: dict[bool, list[Hole]] = {False: [], True: []}
    for slot in block.slots:
        begin, end, top = _opening(plan, slot)
        low_side = wall_spot(block, slot.high, end if slot.high else begin)
        if slot.kind == "window":
            size = min(slot.end - slot.begin - 0.6, 2.4)
            if size > 0.5:
                at = (slot.door - size / 2, slot.door + size / 2)
                holes[slot.high].append(Hole(*at, 0.9, min(2.2, clear - 0.2), looks.pane))
        elif slot.kind == "door":
            add_leaf(part, low_side, palette.doors[slot.look % len(palette.doors)])
            add_trim(part, low_side, DOOR_WIDTH, DOOR_HEIGHT, palette.trim)
        else:
            holes[slot.high].append(Hole(begin, end, 0.0, top, deep=plan.wall))
            if slot.kind == "room":
                add_trim(part, low_side, DOOR_WIDTH, DOOR_HEIGHT, palette.trim)
    wall, trim, rng = palette.corridor_wall, palette.trim, plan.rng(7, index)
    mirrored = [replace(hole, begin=length - hole.end, end=length - hole.begin) for hole in holes[False]]
    add_wall(part, (length, 0), (0, 0), (0, clear), wall, mirrored, trim)
    add_wall(part, (0, width), (length, width), (0, clear), wall, holes[True], trim)
    window = [Hole(0.3, width - 0.3, 0.9, min(2.2, clear - 0.2), looks.pane)]
    first, last = (window if rng.random() < 0.6 else [] for _ in range(2))
    if block.open_start:
        first = [Hole(JAMB, width - JAMB, 0.0, min(2.5, clear - 0.12), deep=0.0)]
    add_wall(part, (0, 0), (0, width), (0, clear), wall, first, trim)
    add_wall(part, (length, width), (length, 0), (0, clear), wall, last, trim)
    add_lamps(part, length, width, clear, looks.lamp_spacing, looks)
    if rng.random() < 0.6:
        _extinguishers(part, plan, block, rng)
    return part


def _opening(plan: Plan, slot: Slot) -> tuple[float, float, float]:
    """Begin, end and height of a slot's opening."""
    if slot.kind in ("stairs", "wing"):
        return slot.begin + JAMB, slot.end - JAMB, min(2.5, plan.clear - 0.12)
    return slot.door - DOOR_WIDTH / 2, slot.door + DOOR_WIDTH / 2, DOOR_HEIGHT


def _extinguishers(part: Part, plan: Plan, block: Block, rng: np.random.Generator) -> None:
    red = plain((0.55, 0.03, 0.025), gloss=0.6)
    for high, begin, _ in free_walls(plan, block, 1.5):
        if rng.random() < 0.3:
            x, y = wall_spot(block, high, begin + 0.2).points(np.array([[0.0, 0.08]]))[0]
            part.beam((x, y, 0.6), (x, y, 1.05), 0.065, red, 8)
            part.beam((x, y, 1.05), (x, y, 1.15), 0.03, plain((0.03, 0.03, 0.03)), 6)


def place_rooms(plan: Plan, looks: Looks, style: int, levels: list[int]) -> list[Placement]:
    """The rooms of one style: those with the same layout are one part."""
    spots: dict[int, list[Spot]] = defaultdict(list)
    rooms: dict[int, tuple[Layout, int]] = {}
    for block, slot in plan.slots("room"):
        room = layout(plan, slot, style)
        rooms[id(room)] = room, slot.look
        spots[id(room)].append(plan.frame_of(block, slot))
    return [place_copies(_room(plan, *rooms[key], looks, style), spots[key], levels, plan) for key in rooms]


def _room(plan: Plan, room: Layout, look: int, looks: Looks, style: int) -> Part:
    part, palette, clear = Part(), looks.palettes[style], plan.clear
    width, depth = room.width, room.depth
    wall, trim = palette.room_walls[look], palette.trim
    add_slab(part, width, depth, 0.0, palette.room_floors[look], True)
    add_slab(part, width, depth, clear, palette.ceiling, False)
    begin, end = room.door - DOOR_WIDTH / 2, room.door + DOOR_WIDTH / 2
    add_wall(
        part, (width, 0), (0, 0), (0, clear), wall, [Hole(width - end, width - begin, 0.0, DOOR_HEIGHT, deep=0.0)], trim
    )
    add_wall(part, (0, 0), (0, depth), (0, clear), wall, [], trim)
    panes = [Hole(a, b, low, high, looks.pane) for a, b, low, high in room.windows]
    add_wall(part, (0, depth), (width, depth), (0, clear), wall, panes, trim)
    add_wall(part, (width, depth), (width, 0), (0, clear), wall, [], trim)
    add_trim(part, Spot(begin, 0.0, 0.0), DOOR_WIDTH, DOOR_HEIGHT, trim)
    if room.leaf is not None:
        painted = palette.doors[look % len(palette.doors)]
        part.box((room.leaf[0], 0.04, 0), (room.leaf[1], 0.08, DOOR_HEIGHT), painted)
    add_lamps(part, width, depth, clear, max(2.6, looks.lamp_spacing), looks)
    return part


def place_furniture(plan: Plan) -> list[Placement]:
    """Furniture: one part for each type, wherever it stands."""
    places: dict[str, list[tuple[float, float, float, float]]] = defaultdict(list)
    for level, style in enumerate(plan.styles):
        for block, slot in plan.slots("room"):
            frame = plan.frame_of(block, slot)
            for name, local in layout(plan, slot, style).pieces:
                spot = local.within(frame)
                places[name].append((spot.x, spot.y, level * plan.storey, spot.heading))
    pieces, found = pieces_of(plan), {name: np.array(each) for name, each in places.items()}
    return [Placement(pieces[name].part, each[:, :3], each[:, 3]) for name, each in found.items()]


_RAIL_HEIGHT = 0.95


def place_stairwells(plan: Plan, looks: Looks) -> list[Placement]:
    """All stairwells: storeys alike, and what closes them at the bottom and at the top."""
    spots = [plan.frame_of(block, slot) for block, slot in plan.slots("stairs")]
    levels, top, palette = list(range(plan.levels)), plan.levels - 1, looks.palettes[0]
    return [
        place_copies(_storey_walls(plan, palette), spots, levels, plan),
        place_copies(_landing(plan, palette), spots, levels[1:], plan),
        place_copies(_flights(plan, looks, palette), spots, levels[:-1], plan),
        place_copies(_bottom(plan, palette), spots, [0], plan),
        place_copies(_landing_lamp(plan, looks), spots, levels[:-1], plan),
        place_copies(_top(plan, looks, palette), spots, [top], plan),
        place_copies(_low_panel(plan), spots, [0], plan),
        place_copies(_guard(plan, palette), spots, [top], plan),
    ]


def _storey_walls(plan: Plan, palette: Palette) -> Part:
    part, stairs = Part(), plan.stairs
    w, d, high, wall = stairs.width, stairs.depth, plan.storey, palette.stair_wall
    opening = Hole(JAMB, w - JAMB, 0.0, min(2.5, plan.clear - 0.12), deep=0.0)
    add_wall(part, (w, 0), (0, 0), (0, high), wall, [opening], palette.trim)
    add_wall(part, (0, 0), (0, d), (0, high), wall, [], palette.trim)
    add_wall(part, (w, d), (w, 0), (0, high), wall, [], palette.trim)
    return part


def _landing(plan: Plan, palette: Palette) -> Part:
    part, stairs = Part(), plan.stairs
    low, high = (0.0, 0.0, -plan.slab), (stairs.width, stairs.landing, 0.0)
    part.box(low, high, palette.stair_floor, "Z")
    part.box(low, high, palette.ceiling, "zY")
    return part


def _landing_lamp(plan: Plan, looks: Looks) -> Part:
    part, x, y, z = Part(), plan.stairs.width / 2, plan.stairs.landing / 2, plan.clear
    box = (x - 0.3, y - 0.3, z - 0.07), (x + 0.3, y + 0.3, z)
    part.box(*box, looks.lamp, "z")
    part.box(*box, plain((0.55, 0.55, 0.53)), "xXyY")
    return part


def _flights(plan: Plan, looks: Looks, palette: Palette) -> Part:
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
    window = Hole(0.45, stairs.width - 0.45, half + 0.9, half + min(2.2, plan.storey - plan.slab - 0.3), looks.pane)
    heights = (half, half + plan.storey)
    holes = [window] if plan.rng(8).random() < 0.75 else []
    add_wall(part, (0, stairs.depth), (stairs.width, stairs.depth), heights, palette.stair_wall, holes, palette.trim)
    if not holes:
        middle = stairs.width / 2
        box = (middle - 0.25, stairs.depth - 0.09, half + 1.7), (middle + 0.25, stairs.depth, half + 1.95)
        part.box(*box, looks.lamp, "yz")
        part.box(*box, plain((0.5, 0.5, 0.5)), "xXZ")
    _balustrades(part, plan, palette)
    return part


def _balustrades(part: Part, plan: Plan, palette: Palette) -> None:
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
    add_slab(part, stairs.width, stairs.depth, 0.0, palette.stair_floor, True)
    wall = (0, stairs.depth), (stairs.width, stairs.depth)
    add_wall(part, *wall, (0, plan.storey / 2), palette.stair_wall, [], palette.trim)
    return part


def _top(plan: Plan, looks: Looks, palette: Palette) -> Part:
    part, stairs = Part(), plan.stairs
    add_slab(part, stairs.width, stairs.depth, plan.clear, palette.ceiling, False)
    wall = (0, stairs.depth), (stairs.width, stairs.depth)
    add_wall(part, *wall, (plan.storey / 2, plan.clear), palette.stair_wall, [], palette.trim)
    add_lamps(part, stairs.width, stairs.depth, plan.clear, 3.0, looks)
    return part


def _low_panel(plan: Plan) -> Part:
    """A panel below the lowest flight that comes down."""
    part, stairs = Part(cue=True), plan.stairs
    (a, b), inner = stairs.down_x, stairs.up_x[0] if stairs.mirrored else stairs.up_x[1]
    x0, x1 = (a, inner) if stairs.mirrored else (inner, b)
    high = plan.storey - plan.storey / 2 / stairs.risers - 0.12
    material = painted_door(colour(plan.rng(10), 0.6, 0.25))
    part.box((x0, stairs.landing - 0.06, 0), (x1, stairs.landing, high), material, "yY")
    return part


def _guard(plan: Plan, palette: Palette) -> Part:
    part, stairs = Part(cue=True), plan.stairs
    a, b = stairs.up_x
    y = stairs.landing - 0.03
    for z in (0.15, 0.55, 1.0):
        part.beam((a, y, z), (b, y, z), 0.028, palette.rail, 8)
    for x in np.linspace(a + 0.03, b - 0.03, 9):
        part.box((x - 0.01, y - 0.01, 0), (x + 0.01, y + 0.01, 1.0), palette.rail, "xXyY")
    return part
