"""Beds and armchairs."""

from __future__ import annotations

import numpy as np

from sequences.rendering.mesh import Part
from sequences.rendering.texture import plain
from sequences.scenes.building.furniture.piece import Piece, timber
from sequences.scenes.building.paint.colours import colour


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
