"""The landings of the stairwell, which look the same on every floor."""

from __future__ import annotations

import numpy as np

from sequences.rendering.mesh import Part
from sequences.rendering.texture import Material, plain
from sequences.scenes.staircase.dimensions import ACROSS, FLOOR_HEIGHT, INNER_A, INNER_B, LANDING, SLAB
from sequences.scenes.staircase.paint import (
    BLACK,
    BRUSHED,
    DOOR,
    FRAME,
    LAMP,
    RAIL,
    STEEL,
    TERRAZZO,
    WALL_LANDING,
    WHITE,
)


def landing(door: bool = True) -> Part:
    """A floor landing: terrazzo, ceiling with lamp, walls, two doors, what hangs on the walls of every floor."""
    part = Part()
    part.box((0, 0, -SLAB), (LANDING, ACROSS, 0), TERRAZZO, "Z")
    part.box((0, 0, -SLAB), (LANDING, ACROSS, 0), WHITE, "X")
    part.quad((0, ACROSS, FLOOR_HEIGHT - SLAB), (LANDING, 0, 0), (0, -ACROSS, 0), WHITE)
    part.box((0.62, 1.12, FLOOR_HEIGHT - SLAB - 0.09), (0.98, 1.48, FLOOR_HEIGHT - SLAB), LAMP, "xXyYz")
    part.quad((0, 0, 0), (0, ACROSS, 0), (0, 0, FLOOR_HEIGHT), WALL_LANDING)
    part.quad((LANDING, 0, 0), (-LANDING, 0, 0), (0, 0, FLOOR_HEIGHT), WALL_LANDING)
    part.quad((0, ACROSS, 0), (LANDING, 0, 0), (0, 0, FLOOR_HEIGHT), WALL_LANDING)
    if door:
        _door_at(part, np.array([0, 0.28, 0]), np.array([0, 1.0, 0]), np.array([1.0, 0, 0]))
        _door_at(part, np.array([0.28, ACROSS, 0]), np.array([1.0, 0, 0]), np.array([0, -1.0, 0]))
        part.box((0.0, 1.30, 1.05), (0.012, 1.38, 1.13), FRAME, "XyYzZ")
        part.beam((0.75, 0.10, 0.62), (0.75, 0.10, 1.10), 0.065, plain((0.55, 0.03, 0.025), gloss=0.6), 10)
        part.beam((0.75, 0.10, 1.10), (0.75, 0.10, 1.20), 0.03, BLACK, 6)
        part.box((1.0, 0.0, 0.95), (1.35, 0.06, 1.5), plain((0.44, 0.44, 0.42), gloss=0.3), "xXYzZ")
    part.box((LANDING - 0.065, INNER_A - 0.025, 0), (LANDING - 0.015, INNER_A + 0.025, 1.0), STEEL)
    part.box((LANDING - 0.065, INNER_B - 0.025, 0), (LANDING - 0.015, INNER_B + 0.025, 1.0), STEEL)
    part.beam((LANDING - 0.04, INNER_A - 0.02, 0.98), (LANDING - 0.04, INNER_B + 0.02, 0.98), 0.026, RAIL, 8)
    return part


def _door_at(part: Part, foot: np.ndarray, along: np.ndarray, out: np.ndarray) -> None:
    """A door of 0.9 m × 2.05 m with frame and handle on a wall: foot, direction along the wall, outward normal."""
    width, height, trim = 0.9, 2.05, 0.07
    up = np.array([0, 0, 1.0])

    def block(s0: float, z0: float, s1: float, z1: float, depth: float, material: Material) -> None:
        corners = [foot + along * s + up * z + out * d for s, z, d in ((s0, z0, 0.0), (s1, z1, depth))]
        part.box(np.minimum(*corners), np.maximum(*corners), material)

    leaf = foot + out * 0.012
    if np.dot(np.cross(along, up), out) > 0:
        part.quad(leaf, along * width, up * height, DOOR)
    else:
        part.quad(leaf + along * width, -along * width, up * height, DOOR)
    block(-trim, 0.0, 0.0, height + trim, 0.035, FRAME)
    block(width, 0.0, width + trim, height + trim, 0.035, FRAME)
    block(-trim, height, width + trim, height + trim, 0.035, FRAME)
    block(0.06, 0.93, 0.105, 1.13, 0.02, BRUSHED)
    block(0.065, 1.045, 0.20, 1.065, 0.06, BRUSHED)
    block(0.40, 1.48, 0.44, 1.52, 0.02, BRUSHED)
