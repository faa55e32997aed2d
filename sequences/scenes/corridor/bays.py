"""The corridor's parts: floor, walls, frames, doors and notice boards, which repeat; and its two ends."""

from __future__ import annotations

import numpy as np

from sequences.rendering import texture
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
    LENGTH,
    MURAL,
    WIDTH,
)
from sequences.scenes.corridor.paint import (
    FRAME,
    LAMP,
    METAL,
    SKY,
    TRIM,
    linoleum,
    mural,
    panels,
    sheets,
    sign_art,
    wall,
)


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
    door = Material(lambda canvas: texture.door(canvas) * np.array(stain, np.float32))
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


def window_end() -> Part:
    """The end at x = 0: a wide window, low in the wall, and a radiator."""
    part, y0, y1, z0, z1, deep = Part(), 0.4, 2.0, 0.9, 2.1, -0.2
    white = Material(texture.plaster)
    for low, high, a, b in ((0, z0, 0, WIDTH), (z1, HEIGHT, 0, WIDTH), (z0, z1, 0, y0), (z0, z1, y1, WIDTH)):
        part.quad((0, a, low), (0, b - a, 0), (0, 0, high - low), white)
    part.quad((deep, y0, z0), (0, y1 - y0, 0), (0, 0, z1 - z0), SKY)
    part.quad((deep, y0, z0), (-deep, 0, 0), (0, y1 - y0, 0), TRIM)
    part.quad((deep, y1, z1), (-deep, 0, 0), (0, y0 - y1, 0), white)
    part.quad((0, y0, z0), (deep, 0, 0), (0, 0, z1 - z0), white)
    part.quad((deep, y1, z0), (-deep, 0, 0), (0, 0, z1 - z0), white)
    for y in (y0, (y0 + y1) / 2, y1):
        part.box((deep, y - 0.035, z0), (deep + 0.06, y + 0.035, z1), TRIM, "XyY")
    part.box((0, 0.6, 0.15), (0.1, 1.8, 0.75), Material(texture.radiator, gloss=0.2), "XyYZ")
    return part


def door_end() -> Part:
    """The end at x = 75 m: a dark red wall, a double door of steel, a lit sign above it."""
    part, x = Part(), LENGTH
    part.quad((x, WIDTH, 0), (0, -WIDTH, 0), (0, 0, HEIGHT), plain((0.30, 0.09, 0.07)))
    part.box((x - 0.03, 0.4, 0), (x, 2.0, 2.1), Material(texture.steel, gloss=0.4), "xyYZ")
    part.box((x - 0.035, 1.19, 0), (x, 1.21, 2.1), plain((0.02, 0.02, 0.02)), "x")
    for y in (0.6, 1.3):
        part.box((x - 0.1, y, 1.0), (x - 0.03, y + 0.5, 1.06), METAL, "xyYzZ")
    part.box((x - 0.06, 1.0, 2.2), (x, 1.4, 2.4), Material(sign_art, emission=1.5, glare=0.4, texel_m=0.01), "x")
    return part


def murals(level: int) -> Part:
    """The painted walls of one floor: both walls of the first bay, and both of the last."""
    part, rim = Part(cue=True), (BAY - MURAL) / 2
    for end, x0 in enumerate((rim, LENGTH - BAY + rim)):
        for high_y in (False, True):
            paint = Material(lambda canvas, end=end: mural(canvas, 2 * level + end), texel_m=0.01)
            quad_on_wall(part, x0, x0 + MURAL, 0.5, 2.2, 0.01, high_y, paint)
    return part
