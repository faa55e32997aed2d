"""The hall itself: panels and lamps, which repeat, and walls."""

from __future__ import annotations

from sequences.rendering import texture
from sequences.rendering.mesh import Part
from sequences.rendering.texture import Material, plain
from sequences.scenes.ceiling.dimensions import BREADTH, HEIGHT, LENGTH, PANEL
from sequences.scenes.ceiling.paint import diffuser, floor, masonry, panelled


def panel(material: Material, cue: bool = False) -> Part:
    """One panel of the ceiling."""
    part = Part(cue=cue)
    part.quad((0, PANEL, 0), (PANEL, 0, 0), (0, -PANEL, 0), material)
    return part


def lamp() -> Part:
    """A long lamp on two rods that lights the hall and, more gently, the ceiling above it."""
    part = Part()
    x0, x1, y0, y1, low, high = 0.0, 1.2, 0.18, 0.42, -0.51, -0.45
    body = plain((0.45, 0.45, 0.44), gloss=0.2)
    part.box((x0, y0, low), (x1, y1, high), body, "xXyY")
    part.quad((x0, y1, low), (x1 - x0, 0, 0), (0, y0 - y1, 0), Material(diffuser, emission=14.0, glare=0.14))
    part.quad((x0, y0, high), (x1 - x0, 0, 0), (0, y1 - y0, 0), texture.lit((1.0, 0.95, 0.85), 4.0))
    for x in (0.2, 1.0):
        part.beam((x, 0.3, high), (x, 0.3, 0), 0.008, body, 4)
        part.box((x - 0.04, 0.26, -0.02), (x + 0.04, 0.34, 0), body, "xXyYz")
    return part


def hall() -> Part:
    """The floor."""
    part = Part()
    part.quad((0, 0, 0), (LENGTH, 0, 0), (0, BREADTH, 0), Material(floor, texel_m=0.05))
    return part


def walls() -> Part:
    """Four walls, each of another make, under a white cornice; seen from near only."""
    part = Part(cue=True)
    part.quad((LENGTH, 0, 0), (-LENGTH, 0, 0), (0, 0, HEIGHT), Material(texture.plaster, texel_m=0.012))
    part.quad((0, BREADTH, 0), (LENGTH, 0, 0), (0, 0, HEIGHT), plain((0.16, 0.25, 0.38)))
    part.quad((0, 0, 0), (0, BREADTH, 0), (0, 0, HEIGHT), Material(panelled, gloss=0.3, texel_m=0.012))
    part.quad((LENGTH, BREADTH, 0), (0, -BREADTH, 0), (0, 0, HEIGHT), Material(masonry, texel_m=0.012))
    trim = plain((0.7, 0.7, 0.67))
    low, size = HEIGHT - 0.1, 0.07
    part.box((0, 0, low), (LENGTH, size, HEIGHT), trim, "Yz")
    part.box((0, BREADTH - size, low), (LENGTH, BREADTH, HEIGHT), trim, "yz")
    part.box((0, 0, low), (size, BREADTH, HEIGHT), trim, "Xz")
    part.box((LENGTH - size, 0, low), (LENGTH, BREADTH, HEIGHT), trim, "xz")
    return part
