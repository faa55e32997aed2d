"""A round table in the middle of a room: it looks the same from four sides."""

from __future__ import annotations

import numpy as np

from sequences.rendering.mesh import Part, Placement
from sequences.rendering.texture import plain
from sequences.scenes.scene import HELMET, Scene
from sequences.scenes.table_room import OAK, TABLE_HEIGHT, TOP, circle_table, room, turned

RADIUS, CORNERS = 0.6, 16  # metres; of a regular polygon


def placements() -> list[Placement]:
    """A round table on four legs: x and y from its middle, z up; the same after every quarter turn."""
    return [*room(), turned(_round_quarter(), 4)]


def _round_quarter() -> Part:
    """A quarter of the round top, with its rim, and one leg."""
    part, low = Part(), TABLE_HEIGHT - TOP
    angle = 2 * np.pi * np.arange(CORNERS) / CORNERS
    edges = np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
    edges *= RADIUS * np.sin(np.pi / CORNERS)  # half a side of the regular polygon
    # A rose of rhombi: the first ring has its tips in the middle, each next one fills the gaps that the last one left.
    for first in range(CORNERS // 4):
        base = np.array([0.0, 0.0, TABLE_HEIGHT])
        for ring in range(1, CORNERS // 2):
            start = first - (ring - 1) // 2
            inner = (start + np.arange(1, ring)) % CORNERS
            part.quad(base + edges[inner].sum(axis=0), edges[start], edges[(start + ring) % CORNERS], OAK)
        corner = base + edges[(first + np.arange(CORNERS // 2)) % CORNERS].sum(axis=0)
        part.quad(corner - (0, 0, TOP), -2 * edges[first], (0, 0, TOP), OAK)
    reach = 0.7 * RADIUS / np.sqrt(2)
    part.beam((reach + 0.05, reach + 0.05, 0), (reach, reach, low), 0.03, plain((0.05, 0.05, 0.055), gloss=0.3), 8)
    return part


SCENE = Scene(
    name="round-table",
    seed_numbers=(2,),
    placements=lambda split, seed: placements(),
    path=lambda duration_s, split, seed, rng: circle_table(duration_s, rng=rng),
    field_of_view_deg=60.0,
    base_from_camera=HELMET,
    has_cues=False,
)
