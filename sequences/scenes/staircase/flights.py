"""Parts that the floors of the stairwell share: two flights of stairs with their half landing, and the landings."""

from __future__ import annotations

import numpy as np

from sequences.rendering import texture
from sequences.rendering.mesh import Part
from sequences.rendering.texture import Material, plain
from sequences.scenes.staircase.dimensions import (
    ACROSS,
    FAR,
    FLIGHT,
    FLOOR_HEIGHT,
    GOING,
    HALF,
    INNER_A,
    INNER_B,
    LANDING,
    NUM_TREADS,
    RISE,
    SLAB,
    SLOPE,
    WELL,
    WIDTH,
)
from sequences.scenes.staircase.paint import (
    BLACK,
    BRUSHED,
    DOOR,
    FRAME,
    LAMP,
    RADIATOR,
    RAIL,
    RISER,
    SKY,
    STEEL,
    TERRAZZO,
    TREAD,
    WALL,
    WALL_END,
    WALL_LANDING,
    WHITE,
)


def flights() -> Part:
    """Two flights, the half landing between them with its window, and the walls around."""
    part = Part()
    for k in range(NUM_TREADS + 1):
        xa, xb = LANDING + k * GOING, LANDING + FLIGHT - k * GOING
        part.quad((xa, WIDTH, k * RISE), (0, -WIDTH, 0), (0, 0, RISE), RISER)
        part.quad((xb, WIDTH + WELL, HALF + k * RISE), (0, WIDTH, 0), (0, 0, RISE), RISER)
        if k < NUM_TREADS:
            part.quad((xa, WIDTH, (k + 1) * RISE), (0, -WIDTH, 0), (GOING, 0, 0), TREAD)
            part.quad((xb, WIDTH + WELL, HALF + (k + 1) * RISE), (0, WIDTH, 0), (-GOING, 0, 0), TREAD)
    rise = FLIGHT * SLOPE
    part.quad((LANDING, 0, -0.16), (0, WIDTH, 0), (FLIGHT, 0, rise), WHITE)
    part.quad((LANDING + FLIGHT, WIDTH + WELL, HALF - 0.16), (-FLIGHT, 0, rise), (0, WIDTH, 0), WHITE)
    start = LANDING + FLIGHT
    part.box((start, 0, HALF - SLAB), (FAR, ACROSS, HALF), TERRAZZO, "Z")
    part.box((start, 0, HALF - SLAB), (FAR, ACROSS, HALF), WHITE, "xz")
    _balustrade(part)
    _window(part)
    part.quad((FAR, 0, 0), (LANDING - FAR, 0, 0), (0, 0, FLOOR_HEIGHT), WALL)
    part.quad((LANDING, ACROSS, 0), (FAR - LANDING, 0, 0), (0, 0, FLOOR_HEIGHT), WALL)
    part.box(
        (start + 0.5, 1.15, HALF - SLAB - 0.07),
        (start + 0.8, 1.45, HALF - SLAB),
        texture.lit((1.0, 0.9, 0.74), 5.0),
        "xXyYz",
    )
    return part


def _balustrade(part: Part) -> None:
    rise = FLIGHT * SLOPE
    for y, x0, z0, direction in ((INNER_A, LANDING, 0.0, 1), (INNER_B, LANDING + FLIGHT, HALF, -1)):
        along = np.array([direction * FLIGHT, 0, rise])
        low, high = (x0, y, z0 - 0.18), np.array([0, 0, 0.42])
        near, far = np.array([0, 0.012, 0]), np.array([FLIGHT * direction, 0, rise])
        for side in (-1, 1):
            begin = np.array(low) + side * near
            if side * direction < 0:
                part.quad(begin, along, high, STEEL)
            else:
                part.quad(begin + far, -along, high, STEEL)
        top = np.array(low) + high - near * direction
        part.quad(top, along, 2 * near * direction, STEEL)
        for i in range(16):
            x = 0.07 + i * FLIGHT / 16
            foot = np.array([x0 + direction * x, y, z0 + 0.24 + x * SLOPE])
            part.box(np.subtract(foot, (0.008, 0.008, 0.02)), np.add(foot, (0.008, 0.008, 0.70)), STEEL, "xXyY")
        rail = np.array([x0, y, z0 + 0.95])
        part.beam(rail, rail + along, 0.026, RAIL, 8)
    x, z = LANDING + FLIGHT + 0.06, HALF
    for y in (INNER_A, INNER_B):
        part.box((x - 0.025, y - 0.025, z), (x + 0.025, y + 0.025, z + 1.0), STEEL)
    part.beam((LANDING + FLIGHT, INNER_A, rise + 0.95), (x, INNER_A, z + 0.98), 0.026, RAIL, 8)
    part.beam((x, INNER_A - 0.02, z + 0.98), (x, INNER_B + 0.02, z + 0.98), 0.026, RAIL, 8)
    part.beam((x, INNER_B, z + 0.98), (LANDING + FLIGHT, INNER_B, z + 0.95), 0.026, RAIL, 8)


def _window(part: Part) -> None:
    y0, y1, z0, z1 = 0.65, 1.95, HALF + 0.9, HALF + 2.25
    bottom, top = HALF - SLAB, HALF - SLAB + FLOOR_HEIGHT
    for low, high, a, b in ((bottom, z0, 0, ACROSS), (z1, top, 0, ACROSS), (z0, z1, 0, y0), (z0, z1, y1, ACROSS)):
        part.quad((FAR, b, low), (0, a - b, 0), (0, 0, high - low), WALL_END)
    deep = FAR + 0.24
    part.quad((FAR, y1, z0), (0, y0 - y1, 0), (deep - FAR, 0, 0), FRAME)
    part.quad((FAR, y0, z1), (0, y1 - y0, 0), (deep - FAR, 0, 0), WHITE)
    part.quad((deep, y0, z0), (FAR - deep, 0, 0), (0, 0, z1 - z0), WHITE)
    part.quad((FAR, y1, z0), (deep - FAR, 0, 0), (0, 0, z1 - z0), WHITE)
    part.quad((deep, y1, z0), (0, y0 - y1, 0), (0, 0, z1 - z0), SKY)
    bar = deep - 0.06
    middle = (y0 + y1) / 2
    for low, high in (
        ((y0, z0), (y0 + 0.06, z1)),
        ((y1 - 0.06, z0), (y1, z1)),
        ((middle - 0.045, z0), (middle + 0.045, z1)),
    ):
        part.box((bar, low[0], low[1]), (deep - 0.01, high[0], high[1]), FRAME, "xyY")
    for low, high in ((z0, z0 + 0.06), (z1 - 0.06, z1), (z0 + 0.9, z0 + 0.95)):
        part.box((bar, y0, low), (deep - 0.01, y1, high), FRAME, "xzZ")
    part.box((FAR - 0.12, y0 - 0.08, z0 - 0.035), (FAR, y1 + 0.08, z0), FRAME, "xyYzZ")
    part.box((FAR - 0.10, 0.7, HALF + 0.14), (FAR - 0.02, 1.9, HALF + 0.72), RADIATOR, "xyYZ")


def undersides() -> Part:
    """What closes the balustrades' strings and the soffits of a floor where one looks up at them."""
    part = Part()
    rise = FLIGHT * SLOPE
    part.quad((LANDING + FLIGHT, 0, rise - 0.16), (0, WIDTH, 0), (0, 0, HALF - SLAB - rise + 0.16), WHITE)
    part.quad((LANDING, ACROSS, HALF + rise - 0.16), (0, -WIDTH, 0), (0, 0, HALF - SLAB - rise + 0.16), WHITE)
    for y, x0, z0, direction in ((INNER_A, LANDING, 0.0, 1), (INNER_B, LANDING + FLIGHT, HALF, -1)):
        along, high = np.array([direction * FLIGHT, 0, rise]), np.array([0, 0, 0.42])
        across = np.array([0, 0.024 * direction, 0])
        low = np.array([x0, y, z0 - 0.18]) - across / 2
        part.quad(low, across, along, STEEL)
        part.quad(low + across, -across, high, STEEL)
        part.quad(low + along, across, high, STEEL)
    return part


def landing(door: bool = True) -> Part:
    """A floor landing: terrazzo, ceiling with lamp, walls, two doors, what hangs on the walls of every floor."""
    part = Part()
    part.box((0, 0, -SLAB), (LANDING, ACROSS, 0), TERRAZZO, "Z")
    part.box((0, 0, -SLAB), (LANDING, ACROSS, 0), WHITE, "X")
    part.quad((0, ACROSS, FLOOR_HEIGHT - SLAB), (LANDING, 0, 0), (0, -ACROSS, 0), WHITE)
    part.box((0.62, 1.12, FLOOR_HEIGHT - SLAB - 0.09), (0.98, 1.48, FLOOR_HEIGHT - SLAB), LAMP, "xXyYz")
    part.quad((0, 0, 0), (0, ACROSS, 0), (0, 0, FLOOR_HEIGHT), WALL_LANDING)
    part.quad((LANDING, 0, 0), (-LANDING, 0, 0), (0, 0, FLOOR_HEIGHT), WALL_LANDING)
    part.quad((0, ACROSS, 0), (LANDING, 0, 0), (0, 0, FLOOR_HEIGHT), WALL_LANDING)
    if door:
        _door_at(part, np.array([0, 0.28, 0]), np.array([0, 1.0, 0]), np.array([1.0, 0, 0]))
        _door_at(part, np.array([0.28, ACROSS, 0]), np.array([1.0, 0, 0]), np.array([0, -1.0, 0]))
        part.box((0.0, 1.30, 1.05), (0.012, 1.38, 1.13), FRAME, "XyYzZ")
        part.beam((0.75, 0.10, 0.62), (0.75, 0.10, 1.10), 0.065, plain((0.55, 0.03, 0.025), gloss=0.6), 10)
        part.beam((0.75, 0.10, 1.10), (0.75, 0.10, 1.20), 0.03, BLACK, 6)
        part.box((1.0, 0.0, 0.95), (1.35, 0.06, 1.5), plain((0.44, 0.44, 0.42), gloss=0.3), "xXYzZ")
    part.box((LANDING - 0.065, INNER_A - 0.025, 0), (LANDING - 0.015, INNER_A + 0.025, 1.0), STEEL)
    part.box((LANDING - 0.065, INNER_B - 0.025, 0), (LANDING - 0.015, INNER_B + 0.025, 1.0), STEEL)
    part.beam((LANDING - 0.04, INNER_A - 0.02, 0.98), (LANDING - 0.04, INNER_B + 0.02, 0.98), 0.026, RAIL, 8)
    return part


def _door_at(part: Part, foot: np.ndarray, along: np.ndarray, out: np.ndarray) -> None:
    """A door of 0.9 m × 2.05 m with frame and handle on a wall: foot, direction along the wall, outward normal."""
    width, height, trim = 0.9, 2.05, 0.07
    up = np.array([0, 0, 1.0])

    def block(s0: float, z0: float, s1: float, z1: float, depth: float, material: Material) -> None:
        corners = [foot + along * s + up * z + out * d for s, z, d in ((s0, z0, 0.0), (s1, z1, depth))]
        part.box(np.minimum(*corners), np.maximum(*corners), material)

    leaf = foot + out * 0.012
    if np.dot(np.cross(along, up), out) > 0:
        part.quad(leaf, along * width, up * height, DOOR)
    else:
        part.quad(leaf + along * width, -along * width, up * height, DOOR)
    block(-trim, 0.0, 0.0, height + trim, 0.035, FRAME)
    block(width, 0.0, width + trim, height + trim, 0.035, FRAME)
    block(-trim, height, width + trim, height + trim, 0.035, FRAME)
    block(0.06, 0.93, 0.105, 1.13, 0.02, BRUSHED)
    block(0.065, 1.045, 0.20, 1.065, 0.06, BRUSHED)
    block(0.40, 1.48, 0.44, 1.52, 0.02, BRUSHED)
