"""The two ends of the corridor, and the painted walls that tell the floor."""

from __future__ import annotations

from sequences.rendering import pictures, texture
from sequences.rendering.mesh import Part
from sequences.rendering.texture import Material, plain
from sequences.scenes.corridor.bays import quad_on_wall
from sequences.scenes.corridor.dimensions import BAY, HEIGHT, LENGTH, MURAL, WIDTH
from sequences.scenes.corridor.paint import METAL, SKY, TRIM, mural, sign_art


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
    part.box((0, 0.6, 0.15), (0.1, 1.8, 0.75), Material(pictures.radiator, gloss=0.2), "XyYZ")
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
