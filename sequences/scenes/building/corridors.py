"""The corridors of a building."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sequences.rendering.mesh import Part
from sequences.rendering.texture import plain
from sequences.scenes.building.looks import Looks
from sequences.scenes.building.parts import JAMB, Hole, add_lamps, add_leaf, add_slab, add_trim, add_wall
from sequences.scenes.building.plan import DOOR_HEIGHT, DOOR_WIDTH, Block, Plan, Slot, Spot


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


def corridor(plan: Plan, index: int, looks: Looks, style: int) -> Part:
    """The corridor of a block, on the levels of one style, without what is behind its openings."""
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
    """Of a slot in the wall of the corridor: from where to where along it, and how high."""
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
