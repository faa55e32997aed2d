"""A television, a whiteboard, a plant, a radiator."""

from __future__ import annotations

import numpy as np

from sequences.rendering import texture
from sequences.rendering.mesh import Part
from sequences.rendering.texture import Material, plain
from sequences.scenes.building.furniture.piece import Piece
from sequences.scenes.building.furniture.storage import cupboard
from sequences.scenes.building.paint import furnishings
from sequences.scenes.building.paint.colours import colour


def television(rng: np.random.Generator) -> Piece:
    """A television on a low cupboard."""
    piece = cupboard(rng, (float(rng.uniform(1.2, 1.7)), 0.42, 0.5), (3, 1))
    middle, half = piece.width / 2, 0.5
    piece.part.box((middle - half, 0.15, 0.58), (middle + half, 0.19, 1.15), plain((0.02, 0.02, 0.02)), "xXyzZ")
    piece.part.box(
        (middle - half, 0.15, 0.58), (middle + half, 0.195, 1.15), Material(furnishings.screen, gloss=0.5), "Y"
    )
    piece.part.box((middle - 0.1, 0.12, 0.5), (middle + 0.1, 0.22, 0.58), plain((0.02, 0.02, 0.02)), "xXyY")
    return Piece(piece.part, piece.width, 0.42, 1.15)


def board(rng: np.random.Generator) -> Piece:
    """A whiteboard on the wall."""
    part, w = Part(), float(rng.uniform(1.6, 2.6))
    part.box((0, 0, 0.9), (w, 0.04, 2.0), plain((0.3, 0.3, 0.3)), "xXzZ")
    part.box((0, 0, 0.9), (w, 0.04, 2.0), Material(furnishings.whiteboard, gloss=0.3, texel_m=0.01), "Y")
    part.box((0.3, 0.04, 0.9), (w - 0.3, 0.1, 0.92), plain((0.4, 0.4, 0.4)), "xXYzZ")
    return Piece(part, w, 0.1, 2.0)


def plant(rng: np.random.Generator) -> Piece:
    """A plant in a pot."""
    part, tall = Part(), float(rng.uniform(0.9, 1.7))
    part.beam((0.27, 0.27, 0), (0.27, 0.27, 0.35), 0.16, plain(colour(rng, 0.7, 0.3)), 8)
    part.box((0.16, 0.16, 0.33), (0.38, 0.38, 0.335), plain((0.05, 0.03, 0.02)), "Z")
    part.beam((0.27, 0.27, 0.33), (0.27, 0.27, tall), 0.015, plain((0.1, 0.07, 0.04)), 5)
    green = Material(furnishings.leaves, texel_m=0.012)
    for k in range(14):
        angle, low = 2.4 * k, 0.4 + (tall - 0.6) * k / 14
        out, up = np.array([np.cos(angle), np.sin(angle), 0.0]), np.array([0.0, 0.0, 1.0])
        stem, aside = np.array([0.27, 0.27, low]), 0.05 * np.cross(up, out)
        part.quad(stem, 0.13 * out + 0.17 * up + aside, 0.13 * out + 0.1 * up - aside, green)
    return Piece(part, 0.54, 0.54, tall)


def radiator() -> Piece:
    """Below a window."""
    part = Part()
    part.box((0, 0.03, 0.12), (1.0, 0.12, 0.68), Material(texture.radiator, gloss=0.2), "xXYZ")
    return Piece(part, 1.0, 0.12, 0.68)
