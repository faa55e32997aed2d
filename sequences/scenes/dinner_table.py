"""A dinner table in the middle of a room: it looks the same from two sides."""

from __future__ import annotations

import numpy as np

from sequences.rendering import texture
from sequences.rendering.mesh import Part, Placement
from sequences.rendering.texture import Canvas, Material, band, blend, plain, weathered
from sequences.scenes.scene import HELMET, Scene
from sequences.scenes.table_room import OAK, TABLE_HEIGHT, TOP, circle_table, room, turned

LENGTH, BREADTH = 1.8, 0.9  # metres
PLACES_M = 0.45  # between two plates


def placements() -> list[Placement]:
    """A long table laid for eight: x along it, y across, z up; the same after half a turn, and not after a quarter."""
    return [*room(), turned(_dinner_half(), 2)]


def _linen(canvas: Canvas) -> np.ndarray:
    """A white tablecloth with a blue border along its outer edges, and plates."""
    base = weathered(canvas, canvas.colour((0.42, 0.42, 0.41)), 0.03)
    x, y = canvas.point(0), canvas.point(1)
    edge = np.minimum(LENGTH / 2 - x, BREADTH / 2 - np.abs(y))
    base = blend(base, (0.06, 0.12, 0.35), band(edge, 0.04, 0.08))
    for place_x, place_y in _plates():
        radius = np.hypot(x - place_x, y - place_y)
        base = blend(base, (0.30, 0.34, 0.36), 1 - texture.step(radius, 0.13))
        base = blend(base, (0.62, 0.62, 0.60), band(radius, 0.085, 0.1))
    return base


def _plates() -> list[tuple[float, float]]:
    """Those that reach into one half, as seen from the middle of the table."""
    aside = BREADTH / 2 - 0.22
    return [(along, side) for along in (0.0, PLACES_M) for side in (aside, -aside)] + [(LENGTH / 2 - 0.22, 0.0)]


def _dinner_half() -> Part:
    """The half of the long table towards +x: its cloth with the edges that hang down, and two legs."""
    part = Part()
    length, half = LENGTH / 2, BREADTH / 2
    hanging = plain((0.42, 0.42, 0.41))
    part.quad((0, -half, TABLE_HEIGHT), (length, 0, 0), (0, 2 * half, 0), Material(_linen, texel_m=0.006))
    part.quad((length, -half, TABLE_HEIGHT - 0.15), (0, 2 * half, 0), (0, 0, 0.15), hanging)
    part.quad((0, -half, TABLE_HEIGHT - 0.15), (length, 0, 0), (0, 0, 0.15), hanging)
    part.quad((length, half, TABLE_HEIGHT - 0.15), (-length, 0, 0), (0, 0, 0.15), hanging)
    for y in (-half + 0.1, half - 0.1):
        part.box((length - 0.13, y - 0.03, 0), (length - 0.07, y + 0.03, TABLE_HEIGHT - TOP), OAK, "xXyY")
    return part


SCENE = Scene(
    name="dinner-table",
    seed_numbers=(3,),
    placements=lambda split, seed: placements(),
    path=lambda duration_s, split, seed, rng: circle_table(duration_s, rng=rng),
    field_of_view_deg=60.0,
    base_from_camera=HELMET,
    has_cues=False,
)
