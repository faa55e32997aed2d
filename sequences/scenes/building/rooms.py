"""The rooms of a building, and the furniture in them."""

from __future__ import annotations

from collections import defaultdict

import numpy as np

from sequences.rendering.mesh import Part, Placement
from sequences.scenes.building.layout import Layout, layout, pieces_of
from sequences.scenes.building.looks import Looks
from sequences.scenes.building.parts import Hole, add_lamps, add_slab, add_trim, add_wall, place_copies
from sequences.scenes.building.plan import DOOR_HEIGHT, DOOR_WIDTH, Plan, Spot


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
        part,
        (width, 0),
        (0, 0),
        (0, clear),
        wall,
        [Hole(width - end, width - begin, 0.0, DOOR_HEIGHT, deep=0.0)],
        trim,
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
