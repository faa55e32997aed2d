"""The hall: panels and lamps, which repeat, walls, and unique things (outlet, hole, stains, projector, exit sign)."""

from __future__ import annotations

from sequences.rendering import texture
from sequences.rendering.mesh import Part
from sequences.rendering.texture import Material, plain
from sequences.scenes.ceiling.dimensions import BREADTH, HEIGHT, LENGTH, PANEL, STAIN_AT
from sequences.scenes.ceiling.paint import diffuser, floor, masonry, outlet_art, panelled, sign_art, stain


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


def outlet() -> Part:
    """An air outlet in place of a panel."""
    part = panel(Material(outlet_art, texel_m=0.005), cue=True)
    part.box((0.03, 0.03, -0.03), (0.57, 0.57, 0.0), plain((0.6, 0.6, 0.58)), "xXyY")
    part.quad((0.03, 0.57, -0.03), (0.54, 0, 0), (0, -0.54, 0), Material(outlet_art, texel_m=0.005))
    return part


def hole() -> Part:
    """A missing panel: the dark void above, with a pipe, a cable tray and a hanging cable."""
    part = Part(cue=True)
    dark, depth = plain((0.10, 0.095, 0.09)), 0.6
    part.quad((0, PANEL, depth), (PANEL, 0, 0), (0, -PANEL, 0), plain((0.16, 0.15, 0.14), amount=0.2))
    part.quad((0, 0, 0), (0, PANEL, 0), (0, 0, depth), dark)
    part.quad((PANEL, PANEL, 0), (0, -PANEL, 0), (0, 0, depth), dark)
    part.quad((PANEL, 0, 0), (-PANEL, 0, 0), (0, 0, depth), dark)
    part.quad((0, PANEL, 0), (PANEL, 0, 0), (0, 0, depth), dark)
    part.beam((0, 0.18, 0.3), (PANEL, 0.18, 0.3), 0.06, Material(texture.brushed), 10)
    part.beam((0.42, 0, 0.2), (0.42, PANEL, 0.2), 0.025, plain((0.5, 0.08, 0.05)), 8)
    part.beam((0.2, 0.4, 0.4), (0.28, 0.42, -0.35), 0.012, plain((0.7, 0.55, 0.05)), 6)
    return part


def stains() -> Part:
    """Water stains on a few neighbouring panels."""
    part = Part(cue=True)
    for ix, iy in STAIN_AT:
        corner = (ix * PANEL, (iy + 1) * PANEL, HEIGHT - 0.002)
        part.quad(corner, (PANEL, 0, 0), (0, -PANEL, 0), Material(stain, texel_m=0.005))
    return part


def projector() -> Part:
    """A projector on a pole."""
    part = Part(cue=True)
    black, white = plain((0.05, 0.05, 0.055), gloss=0.4), plain((0.62, 0.62, 0.6), gloss=0.2)
    part.beam((0, 0, 0), (0, 0, -0.35), 0.03, white, 8)
    part.box((-0.28, -0.22, -0.50), (0.28, 0.22, -0.35), white)
    for k in range(5):
        part.box((-0.24, -0.18 + 0.045 * k, -0.503), (-0.02, -0.155 + 0.045 * k, -0.50), black)
    part.box((0.06, -0.10, -0.505), (0.20, 0.10, -0.50), plain((0.05, 0.12, 0.35), gloss=0.3))
    part.beam((0.28, 0.06, -0.43), (0.36, 0.06, -0.43), 0.06, black, 10)
    part.box((-0.12, -0.12, -0.02), (0.12, 0.12, 0), white)
    return part


def exit_sign() -> Part:
    """A hanging exit sign, lit from inside, with slanted faces that read from below."""
    part = Part(cue=True)
    art = Material(sign_art, emission=2.2, texel_m=0.005)
    frame = plain((0.6, 0.6, 0.58))
    part.quad((0.28, 0, -0.42), (-0.56, 0, 0), (0, 0.16, 0.26), art)
    part.quad((-0.28, 0, -0.42), (0.56, 0, 0), (0, -0.16, 0.26), art)
    part.box((-0.3, -0.17, -0.16), (0.3, 0.17, -0.13), frame)
    for x in (-0.22, 0.22):
        part.beam((x, 0, 0), (x, 0, -0.13), 0.012, frame, 6)
    return part
