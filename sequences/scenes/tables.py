"""A room with a table in its middle, and someone who walks round the table: round, or laid for dinner.

The room is alike on all four sides, so is the round table; the dinner table is on two.

Everything is built for one part of the circle around the middle, and turned copies wear the same paint and light.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from filtering.se3 import Poses
from sequences.paths import STEP_S, eased, rotations, wander
from sequences.rendering import texture
from sequences.rendering.mesh import Part, Placement
from sequences.rendering.texture import Canvas, Material, band, blend, inside, plain, weathered
from sequences.scenes.scene import HELMET, Scene

HALF_ROOM, HEIGHT = 3.2, 2.6  # metres, from the middle to every wall, and up
TABLE_HEIGHT, TOP = 0.75, 0.03  # of the upper side, and its thickness


def _turned(part: Part, copies: int) -> Placement:
    """As many copies of a part as fill the circle, turned about the middle."""
    return Placement(part, np.zeros((copies, 3)), headings=2 * np.pi * np.arange(copies) / copies)


def _room() -> list[Placement]:
    return [_turned(_room_quarter(), 4), _turned(_lamp_quarter(), 4)]


def _parquet(canvas: Canvas) -> np.ndarray:
    across = ((canvas.x // 0.3 + canvas.y // 0.3) % 2 == 0)[..., None]
    base = np.where(across, texture.wood(canvas), texture.wood(canvas) * np.float32(1.25))
    stave = np.where(across[..., 0], canvas.x + 0 * canvas.y, canvas.y + 0 * canvas.x) % 0.075
    return blend(base, (0.05, 0.03, 0.015), 0.7 * (1 - band(stave, 0.003, 0.072)))


def _papered(canvas: Canvas) -> np.ndarray:
    base = weathered(canvas, canvas.colour((0.52, 0.50, 0.42)), 0.03)
    stripes = band(canvas.x % 0.4, 0.0, 0.2, 0.01) + 0 * canvas.y
    base = blend(base, (0.38, 0.42, 0.36), stripes)
    base = blend(base, (0.62, 0.60, 0.56), 1 - texture.step(canvas.y, 0.1) + 0 * canvas.x)
    base = blend(base, (0.62, 0.60, 0.56), inside(canvas, 0.75, 0.0, 1.85, 2.1))
    base = blend(base, (0.24, 0.13, 0.06), inside(canvas, 0.82, 0.0, 1.78, 2.03))
    for low in (0.2, 1.15):
        base = blend(base, (0.16, 0.085, 0.04), inside(canvas, 0.95, low, 1.65, low + 0.7))
    base = blend(base, (0.6, 0.5, 0.2), inside(canvas, 0.86, 0.98, 0.93, 1.06))
    base = blend(base, (0.10, 0.06, 0.03), inside(canvas, 3.9, 1.2, 5.1, 1.9))
    art = 0.5 + 0.25 * np.stack([canvas.noise(0.3), canvas.noise(0.2), canvas.noise(0.15)], axis=-1)
    return blend(base, art * np.array([0.5, 0.35, 0.3], np.float32), inside(canvas, 3.97, 1.27, 5.03, 1.83))


OAK = Material(texture.wood, gloss=0.2)


def _room_quarter() -> Part:
    part, h = Part(), HALF_ROOM
    part.quad((h, h, 0), (0, -2 * h, 0), (0, 0, HEIGHT), Material(_papered, texel_m=0.012))
    part.quad((0, 0, 0), (h, 0, 0), (0, h, 0), Material(_parquet, texel_m=0.012))
    part.quad((0, h, HEIGHT), (h, 0, 0), (0, -h, 0), plain((0.65, 0.65, 0.62)))
    return part


def _lamp_quarter() -> Part:
    part = Part()
    size, low = 0.8, HEIGHT - 0.12
    part.quad((0, size, low), (size, 0, 0), (0, -size, 0), texture.lit((1.0, 0.95, 0.85), 6.0))
    part.quad((size, 0, low), (0, size, 0), (0, 0, 0.12), plain((0.6, 0.6, 0.58)))
    part.quad((size, size, low), (-size, 0, 0), (0, 0, 0.12), plain((0.6, 0.6, 0.58)))
    return part


def circle_table(duration_s: float, *, rng: np.random.Generator) -> Poses:
    """A person walking round the table with eyes on it: world_from_base every 20 ms, x forward, z up, at eye height.

    Starts anywhere, either way round; comes nearer and goes further off, now and then turns round.
    """
    steps = int(np.ceil(duration_s / STEP_S)) + 1
    turns = rng.random(steps) < STEP_S / 30
    way = rng.choice([-1.0, 1.0]) * np.where(np.cumsum(turns) % 2, -1.0, 1.0)
    rate = eased(way * (0.3 + 0.06 * wander(steps, 4.0, rng)), 0.4)
    angle = rng.uniform(-np.pi, np.pi) + np.cumsum(rate) * STEP_S
    distance = 1.9 + 0.4 * np.tanh(0.8 * wander(steps, 6.0, rng))
    position = np.stack([distance * np.cos(angle), distance * np.sin(angle), 1.5 + 0.08 * wander(steps, 5.0, rng)], 1)
    down = np.arctan2(position[:, 2] - TABLE_HEIGHT, distance) - np.radians(12)
    yaw = angle + np.pi + 0.12 * wander(steps, 2.0, rng)
    roll = 0.02 * wander(steps, 1.0, rng)
    return Poses(rotations(yaw, down + 0.05 * wander(steps, 2.0, rng), roll), position)


RADIUS, CORNERS = 0.6, 16  # metres; of the round table, a regular polygon


def _round_quarter() -> Part:
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


ROUND_TABLE = Scene(
    name="round-table",
    seed_numbers=(2,),
    placements=lambda split, seed: [*_room(), _turned(_round_quarter(), 4)],
    path=lambda duration_s, split, seed, rng: circle_table(duration_s, rng=rng),
    field_of_view_deg=60.0,
    base_from_camera=HELMET,
    has_cues=False,
)


LENGTH, BREADTH = 1.8, 0.9  # metres, of the dinner table
PLACES_M = 0.45  # between two plates


def _linen(canvas: Canvas) -> np.ndarray:
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


DINNER_TABLE = replace(
    ROUND_TABLE,
    name="dinner-table",
    seed_numbers=(3,),
    placements=lambda split, seed: [*_room(), _turned(_dinner_half(), 2)],
)
