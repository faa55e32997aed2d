"""What is unique in the hall: an outlet, a missing panel, stains, a projector, an exit sign."""

from __future__ import annotations

from sequences.rendering import texture
from sequences.rendering.mesh import Part
from sequences.rendering.texture import Material, plain
from sequences.scenes.ceiling.dimensions import HEIGHT, PANEL, STAIN_AT
from sequences.scenes.ceiling.hall import panel
from sequences.scenes.ceiling.paint import outlet_art, sign_art, stain


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
