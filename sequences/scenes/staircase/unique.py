"""What there is on one floor of the stairwell alone: the entrance, the cellar, a poster, the top."""

from __future__ import annotations

from sequences.rendering.mesh import Part
from sequences.rendering.texture import Material, plain
from sequences.scenes.staircase import pictures
from sequences.scenes.staircase.dimensions import (
    ACROSS,
    FAR,
    FLIGHT,
    FLOOR_HEIGHT,
    HALF,
    INNER_B,
    LANDING,
    SLAB,
    TOP_HEIGHT,
    WIDTH,
)
from sequences.scenes.staircase.paint import FRAME, TERRAZZO, WALL_LANDING, WALL_TOP, WHITE


def entrance() -> Part:
    """Ground floor: glazed doors to the street, mat, letter boxes, notice board."""
    part = Part(cue=True)
    part.quad((0.02, 0.55, 0), (0, 1.5, 0), (0, 0, 2.35), Material(pictures.street, emission=6.0, glare=0.4))
    green = plain((0.03, 0.10, 0.07), gloss=0.4)
    for y in (0.47, 1.255, 2.05):
        part.box((0, y, 0), (0.09, y + 0.09, 2.45), green, "XyY")
    for z, high in ((0.0, 0.28), (1.0, 1.08), (2.3, 2.45)):
        part.box((0, 0.5, z), (0.085, 2.1, high), green, "XzZ")
    part.quad((0.12, 0.6, 0.008), (1.0, 0, 0), (0, 1.4, 0), Material(pictures.mat))
    part.box((0.35, 0, 0.75), (1.55, 0.16, 1.75), Material(pictures.letter_boxes, gloss=0.3, texel_m=0.005), "xXYzZ")
    part.box((0.25, ACROSS - 0.03, 1.0), (1.4, ACROSS, 1.8), Material(pictures.notices, texel_m=0.005), "xXyzZ")
    part.quad((LANDING, ACROSS, 0), (0, -WIDTH - 0.02, 0), (0, 0, FLOOR_HEIGHT - SLAB), WALL_LANDING)
    part.box((LANDING - 0.03, 1.62, 0), (LANDING, 2.42, 1.95), plain((0.13, 0.17, 0.22), gloss=0.3), "xyYZ")
    return part


def cellar() -> Part:
    """What closes the space under the first flights."""
    part = Part()
    part.quad((LANDING, INNER_B + 0.02, 0), (FLIGHT, 0, -HALF), (0, 0, FLOOR_HEIGHT - SLAB), WHITE)
    part.quad((LANDING, 0, 0), (FAR - LANDING, 0, 0), (0, ACROSS, 0), TERRAZZO)
    part.quad((FAR, ACROSS, 0), (0, -ACROSS, 0), (0, 0, HALF), WHITE)
    return part


def poster() -> Part:
    """The poster on one floor."""
    part = Part(cue=True)
    part.box((0.0, 1.46, 0.85), (0.02, 2.48, 2.3), Material(pictures.poster_art, gloss=0.15, texel_m=0.004), "XyYzZ")
    return part


def top() -> Part:
    """Instead of the next flight: a wall with a ladder, a roof with a skylight."""
    part = Part(cue=True)
    brick = Material(pictures.brick)
    part.box((LANDING, 0, -0.25), (LANDING + 0.09, WIDTH + 0.08, TOP_HEIGHT), brick)
    for y in (0.32, 0.72):
        part.beam((LANDING - 0.12, y, 0.3), (LANDING - 0.12, y, TOP_HEIGHT), 0.02, plain((0.6, 0.45, 0.03)), 6)
    for k in range(8):
        z = 0.45 + 0.28 * k
        part.beam((LANDING - 0.12, 0.32, z), (LANDING - 0.12, 0.72, z), 0.014, plain((0.6, 0.45, 0.03)), 6)
    x0, x1, y0, y1 = 2.2, 3.6, 0.6, 2.0
    for a, b, c, d in ((LANDING, x0, 0, ACROSS), (x1, FAR, 0, ACROSS), (x0, x1, 0, y0), (x0, x1, y1, ACROSS)):
        part.quad((a, d, TOP_HEIGHT), (b - a, 0, 0), (0, c - d, 0), WHITE)
    high = TOP_HEIGHT + 0.35
    part.quad((x0, y1, high), (x1 - x0, 0, 0), (0, y0 - y1, 0), Material(pictures.cloudy, emission=2.5))
    part.quad((x1, y0, TOP_HEIGHT), (x0 - x1, 0, 0), (0, 0, 0.35), WHITE)
    part.quad((x0, y1, TOP_HEIGHT), (x1 - x0, 0, 0), (0, 0, 0.35), WHITE)
    part.quad((x0, y0, TOP_HEIGHT), (0, y1 - y0, 0), (0, 0, 0.35), WHITE)
    part.quad((x1, y1, TOP_HEIGHT), (0, y0 - y1, 0), (0, 0, 0.35), WHITE)
    part.box((2.87, y0, high - 0.05), (2.93, y1, high), FRAME, "xXz")
    part.box((x0, 1.27, high - 0.05), (x1, 1.33, high), FRAME, "yYz")
    return part


def roof_walls() -> Part:
    """Walls above the last flight."""
    part = Part()
    part.quad((FAR, 0, 0), (LANDING - FAR, 0, 0), (0, 0, TOP_HEIGHT), WHITE)
    part.quad((LANDING, ACROSS, 0), (FAR - LANDING, 0, 0), (0, 0, TOP_HEIGHT), WALL_TOP)
    bottom = HALF - SLAB
    part.quad((FAR, ACROSS, bottom), (0, -ACROSS, 0), (0, 0, TOP_HEIGHT - bottom), WHITE)
    return part
