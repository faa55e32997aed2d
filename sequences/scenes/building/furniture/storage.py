"""Furniture that holds things: shelves, cupboards, boxes."""

from __future__ import annotations

import numpy as np

from sequences.rendering import texture
from sequences.rendering.mesh import Part
from sequences.rendering.texture import Material, plain
from sequences.scenes.building.furniture.piece import Piece, timber
from sequences.scenes.building.paint import furnishings
from sequences.scenes.building.paint.colours import colour


def cupboard(
    rng: np.random.Generator, size: tuple[float, float, float], fronts: tuple[int, int], saturation: float = 0.5
) -> Piece:
    """A box of a size (width, depth, height) with columns and rows of fronts."""
    part, (w, d, h) = Part(), size
    rgb = colour(rng, saturation, 0.35)
    part.box((0, 0, 0), (w, d, h), plain(rgb, gloss=0.2), "xXZ")
    part.box((0, 0, 0), (w, d, h), furnishings.fronts(rgb, *fronts), "Y")
    return Piece(part, w, d, h)


def cabinet(rng: np.random.Generator) -> Piece:
    """A low cupboard with drawers."""
    return cupboard(rng, (float(rng.uniform(0.7, 1.3)), 0.45, float(rng.uniform(0.7, 1.2))), (2, 3))


def wardrobe(rng: np.random.Generator) -> Piece:
    """A high cupboard with two doors."""
    return cupboard(rng, (float(rng.uniform(1.0, 1.6)), 0.58, float(rng.uniform(1.9, 2.15))), (2, 1))


def fridge(rng: np.random.Generator) -> Piece:
    """A pale cupboard with two doors, one above the other."""
    return cupboard(rng, (0.62, 0.6, float(rng.uniform(1.5, 1.9))), (1, 2), 0.1)


def lockers(rng: np.random.Generator) -> Piece:
    """A row of four coloured lockers."""
    return cupboard(rng, (float(rng.uniform(0.9, 1.5)), 0.45, 1.8), (4, 1), 0.8)


def counter(rng: np.random.Generator) -> Piece:
    """A kitchen counter with a sink, and cupboards above it."""
    part, w = Part(), float(rng.uniform(1.4, 2.2))
    rgb, top = colour(rng, 0.6, 0.4), plain(colour(rng, 0.2, 0.25), gloss=0.4)
    part.box((0, 0, 0), (w, 0.56, 0.87), plain(rgb), "xX")
    part.box((0, 0, 0), (w, 0.56, 0.87), furnishings.fronts(rgb, 3, 1), "Y")
    part.box((0, 0, 0.87), (w, 0.6, 0.91), top, "xXYZz")
    part.box((0.2, 0.15, 0.91), (0.65, 0.5, 0.915), Material(texture.brushed, gloss=0.6), "Z")
    part.beam((0.42, 0.08, 0.91), (0.42, 0.08, 1.15), 0.015, Material(texture.brushed, gloss=0.6), 6)
    part.box((0, 0, 1.45), (w, 0.34, 2.1), plain(rgb), "xXzZ")
    part.box((0, 0, 1.45), (w, 0.34, 2.1), furnishings.fronts(rgb, 3, 1), "Y")
    return Piece(part, w, 0.6, 2.1)


def shelf(rng: np.random.Generator) -> Piece:
    """A shelf full of books."""
    part, w, d, h = Part(), float(rng.uniform(0.8, 1.2)), 0.32, float(rng.uniform(1.5, 2.1))
    body = timber(rng)
    part.box((0, 0, 0), (w, d, h), body, "xXZ")
    part.box((0, 0, 0), (w, d - 0.01, h), furnishings.books(rng), "Y")
    for x in (0.0, w - 0.025):
        part.box((x, d - 0.02, 0), (x + 0.025, d, h), body, "xXY")
    return Piece(part, w, d, h)


def rack(rng: np.random.Generator) -> Piece:
    """A metal rack with boxes on it."""
    part, w, d, h = Part(), float(rng.uniform(0.9, 1.4)), 0.45, float(rng.uniform(1.3, 2.0))
    metal = plain(colour(rng, 0.5, 0.25), gloss=0.4)
    for x in (0.0, w - 0.04):
        for y in (0.0, d - 0.04):
            part.box((x, y, 0), (x + 0.04, y + 0.04, h), metal, "xXyY")
    for z in np.linspace(0.15, h - 0.03, 4):
        part.box((0, 0, z), (w, d, z + 0.03), metal, "yYzZxX")
    for z in np.linspace(0.15, h - 0.03, 4)[:3]:
        x = 0.08
        while x < w - 0.3:
            size = float(rng.uniform(0.18, 0.34))
            high = z + 0.03 + float(rng.uniform(0.12, 0.28))
            part.box((x, 0.06, z + 0.03), (x + size, d - 0.06, high), plain(colour(rng, 0.7, 0.3)), "xXyYZ")
            x += size + float(rng.uniform(0.03, 0.2))
    return Piece(part, w, d, h)


def boxes(rng: np.random.Generator) -> Piece:
    """A pile of three cardboard boxes."""
    part = Part()
    for x, y, z, size in ((0.0, 0.0, 0.0, 0.5), (0.52, 0.05, 0.0, 0.4), (0.06, 0.04, 0.5, 0.38)):
        tint = float(rng.uniform(0.7, 1.3))
        card = plain((0.30 * tint, 0.2 * tint, 0.11 * tint), amount=0.08)
        part.box((x, y, z), (x + size, y + size, z + size), card, "xXyYZ")
    return Piece(part, 0.92, 0.5, 0.88)


def crates(rng: np.random.Generator) -> Piece:
    """Coloured crates, one on the other."""
    part = Part()
    for x, z, w in ((0.0, 0.0, 0.6), (0.62, 0.0, 0.5), (0.1, 0.45, 0.5), (0.2, 0.8, 0.4)):
        part.box((x, 0.0, z), (x + w, 0.6, z + 0.42 - z / 4), plain(colour(rng, 0.8, 0.25)), "xXyYZ")
    return Piece(part, 1.12, 0.6, 1.1)


def waste_bin(rng: np.random.Generator) -> Piece:
    """A round bin."""
    part = Part()
    part.beam((0.2, 0.2, 0), (0.2, 0.2, 0.5), 0.17, plain(colour(rng, 0.8, 0.25), gloss=0.3), 10)
    part.box((0.08, 0.08, 0.46), (0.32, 0.32, 0.47), plain((0.02, 0.02, 0.02)), "Z")
    return Piece(part, 0.4, 0.4, 0.5)
