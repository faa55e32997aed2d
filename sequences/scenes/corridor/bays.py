"""What repeats along the corridor: floor and ceiling, walls, frames, doors and notice boards."""

from __future__ import annotations

import numpy as np

from sequences.rendering import pictures
from sequences.rendering.mesh import Part
from sequences.rendering.texture import Material, plain
from sequences.scenes.corridor.dimensions import (
    BAY,
    DOOR_HEIGHT,
    DOOR_WIDTH,
    DOORS_AT,
    FRAME_DEPTH,
    FRAME_WIDTH,
    HEIGHT,
    LAMP_SPACING,
    WIDTH,
)
from sequences.scenes.corridor.paint import FRAME, LAMP, METAL, TRIM, linoleum, panels, sheets, wall


def shell() -> Part:
    """Floor and ceiling from lamp to lamp, with the lamp in the middle."""
    part, middle = Part(), LAMP_SPACING / 2
    part.quad((0, 0, 0), (LAMP_SPACING, 0, 0), (0, WIDTH, 0), Material(linoleum, gloss=0.35, texel_m=0.01))
    part.quad((0, WIDTH, HEIGHT), (LAMP_SPACING, 0, 0), (0, -WIDTH, 0), Material(panels, texel_m=0.012))
    low, high = (middle - 0.6, WIDTH / 2 - 0.14, HEIGHT - 0.1), (middle + 0.6, WIDTH / 2 + 0.14, HEIGHT)
    part.box(low, high, LAMP, "z")
    part.box(low, high, plain((0.6, 0.6, 0.58)), "xXyY")
    return part


def quad_on_wall(
    part: Part, x0: float, x1: float, low: float, high: float, depth: float, high_y: bool, paint: Material
) -> None:
    """Add a rectangle in front of one of the long walls."""
    if high_y:
        part.quad((x0, WIDTH - depth, low), (x1 - x0, 0, 0), (0, 0, high - low), paint)
    else:
        part.quad((x1, depth, low), (x0 - x1, 0, 0), (0, 0, high - low), paint)


def box_on_wall(
    part: Part, x0: float, x1: float, low: float, high: float, depth: float, high_y: bool, paint: Material
) -> None:
    """Add a box that stands out from one of the long walls."""
    y0, y1 = (WIDTH - depth, WIDTH) if high_y else (0.0, depth)
    part.box((x0, y0, low), (x1, y1, high), paint, "xXzZ" + ("y" if high_y else "Y"))


def walls(bay: int) -> Part:
    """Both walls of one bay."""
    part = Part()
    for high_y in (False, True):
        paint = Material(lambda canvas, high_y=high_y: wall(canvas, bay, high_y), gloss=0.12, texel_m=0.012)
        quad_on_wall(part, bay * BAY, (bay + 1) * BAY, 0.0, HEIGHT, 0.0, high_y, paint)
    return part


def frame(part: Part | None = None) -> Part:
    """A frame around the corridor, half of it on either side of x = 0."""
    part, half = part or Part(), FRAME_WIDTH / 2
    for high_y in (False, True):
        box_on_wall(part, -half, half, 0.0, HEIGHT, FRAME_DEPTH, high_y, FRAME)
    part.box((-half, FRAME_DEPTH, HEIGHT - FRAME_DEPTH), (half, WIDTH - FRAME_DEPTH, HEIGHT), FRAME, "xXz")
    return part


def bay(stain: tuple[float, float, float]) -> Part:
    """A frame, and a door of one colour in each wall: further on in the wall at high y."""
    part = frame()
    door = Material(lambda canvas: pictures.door(canvas) * np.array(stain, np.float32))
    for high_y, x0 in zip((False, True), DOORS_AT, strict=True):
        x1, trim, knob = x0 + DOOR_WIDTH, 0.07, x0 + (DOOR_WIDTH - 0.12 if high_y else 0.06)
        quad_on_wall(part, x0, x1, 0.0, DOOR_HEIGHT, 0.012, high_y, door)
        box_on_wall(part, x0 - trim, x0, 0.0, DOOR_HEIGHT + trim, 0.035, high_y, TRIM)
        box_on_wall(part, x1, x1 + trim, 0.0, DOOR_HEIGHT + trim, 0.035, high_y, TRIM)
        box_on_wall(part, x0, x1, DOOR_HEIGHT, DOOR_HEIGHT + trim, 0.035, high_y, TRIM)
        box_on_wall(part, knob, knob + 0.06, 0.95, 1.15, 0.05, high_y, METAL)
        box_on_wall(part, x1 + 0.12, x1 + 0.27, 1.45, 1.55, 0.012, high_y, METAL)
    return part


def board(bay: int, high_y: bool, colour: tuple[float, float, float]) -> Part:
    """A notice board between a door and a frame."""
    part, x0 = Part(), bay * BAY + (0.3 if high_y else 1.75)
    paint = Material(lambda canvas: sheets(canvas, colour), texel_m=0.008)
    box_on_wall(part, x0, x0 + 1.08, 1.15, 1.95, 0.025, high_y, paint)
    return part
