"""Desks and tables, with what stands on them and around them; beds and armchairs."""

from __future__ import annotations

import numpy as np

from sequences.rendering.mesh import Part
from sequences.rendering.texture import Material, plain
from sequences.scenes.building.furniture.piece import Piece, timber
from sequences.scenes.building.paint import furnishings
from sequences.scenes.building.paint.colours import colour
from sequences.scenes.building.paint.pictures import artwork


def desk(rng: np.random.Generator) -> Piece:
    """A desk with drawers, a screen and a keyboard."""
    part, w, d, h = Part(), float(rng.uniform(1.1, 1.6)), 0.6, float(rng.uniform(0.7, 0.78))
    top, dark = timber(rng), plain((0.04, 0.04, 0.045), gloss=0.3)
    part.box((0, 0, h - 0.035), (w, d, h), top)
    part.box((0.02, 0.05, 0), (0.06, d - 0.05, h - 0.035), dark, "xXyY")
    part.box((w - 0.45, 0.05, 0.05), (w - 0.03, d - 0.06, h - 0.035), plain(colour(rng, 0.4, 0.3)), "xXy")
    front = furnishings.fronts(colour(rng, 0.4, 0.35), 1, 3)
    part.box((w - 0.45, 0.05, 0.05), (w - 0.03, d - 0.05, h - 0.035), front, "Y")
    x = w * float(rng.uniform(0.25, 0.45))
    part.box((x - 0.27, 0.12, h + 0.12), (x + 0.27, 0.15, h + 0.45), dark, "xXyzZ")
    part.box((x - 0.27, 0.12, h + 0.12), (x + 0.27, 0.155, h + 0.45), Material(furnishings.screen, gloss=0.4), "Y")
    part.box((x - 0.04, 0.1, h), (x + 0.04, 0.14, h + 0.2), dark, "xXY")
    part.box((x - 0.2, 0.35, h), (x + 0.2, 0.48, h + 0.02), dark, "xXYZ")
    part.box((w - 0.32, 0.2, h), (w - 0.1, 0.5, h + 0.05), plain(colour(rng, 0.9, 0.5)), "xXyYZ")
    return Piece(part, w, d, h + 0.45)


def place(rng: np.random.Generator) -> Piece:
    """A table for one or two, with chairs."""
    part, w = Part(), float(rng.uniform(1.0, 1.5))
    _table(part, (0.0, 0.0), (w, 0.6), 0.74, rng)
    chair = plain(colour(rng, 0.8, 0.25), gloss=0.2)
    for x in (0.5 * w,) if w < 1.25 else (0.27 * w, 0.73 * w):
        _chair(part, x - 0.21, 0.5, True, chair)
    return Piece(part, w, 0.92, 0.9)


def dining(rng: np.random.Generator) -> Piece:
    """A table for four, with chairs."""
    part, w = Part(), float(rng.uniform(1.1, 1.8))
    _table(part, (0.0, 0.3), (w, 1.1), 0.75, rng)
    chair = timber(rng)
    for x in (0.22 * w, 0.78 * w):
        _chair(part, x - 0.21, 0.0, False, chair)
        _chair(part, x - 0.21, 0.98, True, chair)
    return Piece(part, w, 1.4, 0.9)


def low_table(rng: np.random.Generator) -> Piece:
    """A low table on a rug."""
    piece = rug(rng)
    _table(piece.part, (0.2, 0.18), (piece.width - 0.2, piece.depth - 0.18), 0.42, rng)
    return Piece(piece.part, piece.width, piece.depth, 0.6)


def rug(rng: np.random.Generator) -> Piece:
    """A rug with a picture like no other."""
    part, w, d = Part(), float(rng.uniform(1.0, 1.6)), float(rng.uniform(0.8, 1.2))
    part.box((0, 0, 0), (w, d, 0.012), Material(artwork(int(rng.integers(1 << 30))), texel_m=0.01), "Z")
    return Piece(part, w, d, 0.012)


def _table(part: Part, low: tuple[float, float], high: tuple[float, float], h: float, rng: np.random.Generator) -> None:
    """A table on four legs, with a few things on it."""
    (x0, y0), (x1, y1) = low, high
    leg = plain(colour(rng, 0.3, 0.1), gloss=0.3)
    part.box((x0, y0, h - 0.04), (x1, y1, h), timber(rng))
    for x in (x0 + 0.05, x1 - 0.11):
        for y in (y0 + 0.05, y1 - 0.11):
            part.box((x, y, 0), (x + 0.06, y + 0.06, h - 0.04), leg, "xXyY")
    for _ in range(int(rng.integers(1, 4))):
        at = np.array([*rng.uniform((x0 + 0.05, y0 + 0.05), (x1 - 0.35, y1 - 0.33)), h])
        thing = plain(colour(rng, 0.9, 0.4))
        part.box(at, at + rng.uniform((0.15, 0.15, 0.02), (0.3, 0.28, 0.2)), thing, "xXyYZ")


def _chair(part: Part, x: float, y: float, back_at_high_y: bool, material: Material) -> None:
    part.box((x, y, 0.43), (x + 0.42, y + 0.42, 0.47), material)
    for dx in (0.02, 0.36):
        for dy in (0.02, 0.36):
            part.box((x + dx, y + dy, 0), (x + dx + 0.04, y + dy + 0.04, 0.43), material, "xXyY")
    back = y + 0.38 if back_at_high_y else y
    part.box((x, back, 0.47), (x + 0.42, back + 0.04, 0.88), material)


def bed(rng: np.random.Generator) -> Piece:
    """A bed for one or two."""
    part, w, d = Part(), float(rng.uniform(0.9, 1.6)), 2.0
    wood, cover = timber(rng), plain(colour(rng, 0.8, 0.35), amount=0.12)
    part.box((0, 0, 0), (w, 0.05, 0.95), wood)
    part.box((0, 0.05, 0.12), (w, d, 0.34), wood, "xXYz")
    part.box((0.02, 0.05, 0.34), (w - 0.02, d - 0.02, 0.52), cover, "xXYZ")
    for x in np.linspace(0.08, w - 0.62, 1 if w < 1.2 else 2):
        part.box((x, 0.1, 0.52), (x + 0.54, 0.46, 0.62), plain((0.6, 0.6, 0.58), amount=0.08), "xXyYZ")
    return Piece(part, w, d, 0.95)


def sofa(rng: np.random.Generator) -> Piece:
    """A seat for two or three."""
    return _seat(rng, float(rng.uniform(1.5, 2.1)))


def armchair(rng: np.random.Generator) -> Piece:
    """A seat for one."""
    piece = _seat(rng, 0.8)
    return piece


def _seat(rng: np.random.Generator, width: float) -> Piece:
    part, d = Part(), 0.85
    cloth = plain(colour(rng, 0.8, 0.25), amount=0.1)
    part.box((0, 0, 0.08), (width, 0.22, 0.82), cloth, "xXyYZ")
    part.box((0, 0.22, 0.08), (width, d, 0.42), cloth, "xXYZ")
    for x in (0.0, width - 0.17):
        part.box((x, 0.2, 0.08), (x + 0.17, d, 0.6), cloth, "xXYZ")
    return Piece(part, width, d, 0.82)
