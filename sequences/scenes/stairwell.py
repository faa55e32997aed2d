"""The stairwell of the scene `staircase`: sizes, materials, and the parts that its floors share."""

from __future__ import annotations

import numpy as np

from sequences.rendering import texture
from sequences.rendering.mesh import Part
from sequences.rendering.texture import Canvas, Material, band, blend, plain, weathered

NUM_FLOORS = 6
POSTER_FLOOR = 3
RISE, GOING, NUM_TREADS = 0.17, 0.28, 8  # metres; a flight has one riser more than treads
WIDTH = 1.2  # of a flight
WELL = 0.2  # gap between the flights
LANDING, HALF_LANDING = 1.6, 1.3  # depths
FLIGHT = NUM_TREADS * GOING  # metres along x
HALF = (NUM_TREADS + 1) * RISE  # height of a flight
FLOOR_HEIGHT = 2 * HALF
ACROSS = 2 * WIDTH + WELL  # the stairwell in y
FAR = LANDING + FLIGHT + HALF_LANDING  # the stairwell in x
SLAB = 0.18
TOP_HEIGHT = FLOOR_HEIGHT - SLAB  # from the top landing to the roof
SLOPE = RISE / GOING
INNER_A, INNER_B = WIDTH + 0.01, WIDTH + WELL - 0.01  # y of the balustrades


def _dado(canvas: Canvas) -> np.ndarray:
    """White plaster above, oil paint up to 1.15 m above the steps, a dark line between."""
    x, y, z = canvas.point(0), canvas.point(1), canvas.point(2)
    climbed = np.clip((x - LANDING) * SLOPE, 0, HALF)
    walked = np.where(y < ACROSS / 2, climbed, np.where(x < LANDING + 1e-6, 0, FLOOR_HEIGHT - climbed))
    above = z - walked
    above = np.where((above < 0) & (y > ACROSS / 2), above + FLOOR_HEIGHT, above)
    above = np.where((above > FLOOR_HEIGHT - SLAB), above - FLOOR_HEIGHT, above)
    return _painted(canvas, above)


def _dado_top(canvas: Canvas) -> np.ndarray:
    """The same above the last flight, where none follows."""
    climbed = np.clip((canvas.point(0) - LANDING) * SLOPE, 0, HALF)
    return _painted(canvas, canvas.point(2) + climbed)


def _dado_end(canvas: Canvas) -> np.ndarray:
    return _painted(canvas, canvas.point(2) - HALF)


def _dado_landing(canvas: Canvas) -> np.ndarray:
    return _painted(canvas, canvas.point(2))


def _painted(canvas: Canvas, above: np.ndarray) -> np.ndarray:
    base = texture.plaster(canvas)
    oil = weathered(canvas, canvas.colour((0.30, 0.40, 0.36)), 0.05)
    scuffs = np.clip(canvas.noise(0.16, 0.012) - 1.7, 0, 1) * 0.6 * band(above, 0.05, 0.55, 0.15)
    oil = blend(oil, (0.07, 0.07, 0.065), scuffs)
    low = band(above, -0.05, 1.15)
    base = base * (1 - low[..., None]) + oil * low[..., None]
    base = blend(base, (0.07, 0.11, 0.10), band(above, 1.15, 1.175))
    return blend(base, (0.10, 0.09, 0.08), band(above, -0.02, 0.085) * 0.85)


WALL = Material(_dado, gloss=0.12)
WALL_TOP = Material(_dado_top, gloss=0.12)
WALL_END = Material(_dado_end, gloss=0.12)
WALL_LANDING = Material(_dado_landing, gloss=0.12)
WHITE = Material(texture.plaster)
TERRAZZO = Material(texture.terrazzo, gloss=0.8, texel_m=0.006)
TREAD = Material(texture.tread, gloss=0.35, texel_m=0.005)
RISER = Material(lambda c: blend(texture.terrazzo(c), (0.12, 0.11, 0.10), 0.35 + 0.1 * c.noise(0.1)), texel_m=0.006)
STEEL = Material(texture.steel, gloss=0.5)
RAIL = Material(lambda c: texture.wood(c) * 0.75, gloss=0.7)
DOOR = Material(texture.door, gloss=0.3, texel_m=0.006)
FRAME = plain((0.50, 0.49, 0.45), gloss=0.2)
BRUSHED = Material(texture.brushed, gloss=0.6)
BLACK = plain((0.03, 0.03, 0.032), gloss=0.3)
LAMP = texture.lit((1.0, 0.90, 0.74), 9.0)
RADIATOR = Material(texture.radiator, gloss=0.2)
SKY = Material(texture.sky, emission=9.0, glare=0.35)


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
    """Undersides of the balustrades' strings and of the flights."""
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
