"""What the stairwell is painted with, and what it is made of."""

from __future__ import annotations

import numpy as np

from sequences.rendering import texture
from sequences.rendering.texture import Canvas, Material, band, blend, plain, weathered
from sequences.scenes.staircase.dimensions import ACROSS, FLOOR_HEIGHT, HALF, LANDING, SLAB, SLOPE


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
