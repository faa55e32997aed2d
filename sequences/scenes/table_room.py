"""A room with a table in its middle, alike on all four sides, and someone who walks round the table.

Everything is built for one part of the circle around the middle, and turned copies wear the same paint and light.
"""

from __future__ import annotations

import numpy as np

from filtering.se3 import Poses
from sequences.paths.motion import STEP_S, eased, rotations, wander
from sequences.rendering import texture
from sequences.rendering.mesh import Part, Placement
from sequences.rendering.texture import Canvas, Material, band, blend, inside, plain, weathered

HALF_ROOM, HEIGHT = 3.2, 2.6  # metres, from the middle to every wall, and up
TABLE_HEIGHT, TOP = 0.75, 0.03  # of the upper side, and its thickness


def turned(part: Part, copies: int) -> Placement:
    """As many copies of a part as fill the circle, turned about the middle."""
    return Placement(part, np.zeros((copies, 3)), headings=2 * np.pi * np.arange(copies) / copies)


def room() -> list[Placement]:
    """Walls, floor, ceiling and lamp; the same after every quarter turn."""
    return [turned(_room_quarter(), 4), turned(_lamp_quarter(), 4)]


def _parquet(canvas: Canvas) -> np.ndarray:
    """Squares of oak staves, by turns along and across."""
    across = ((canvas.x // 0.3 + canvas.y // 0.3) % 2 == 0)[..., None]
    base = np.where(across, texture.wood(canvas), texture.wood(canvas) * np.float32(1.25))
    stave = np.where(across[..., 0], canvas.x + 0 * canvas.y, canvas.y + 0 * canvas.x) % 0.075
    return blend(base, (0.05, 0.03, 0.015), 0.7 * (1 - band(stave, 0.003, 0.072)))


def _papered(canvas: Canvas) -> np.ndarray:
    """Striped wallpaper above a skirting board, a door and a framed picture: every wall has them."""
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
    """The wall that closes the room towards +x, and the floor and ceiling of the quadrant left of it."""
    part, h = Part(), HALF_ROOM
    part.quad((h, h, 0), (0, -2 * h, 0), (0, 0, HEIGHT), Material(_papered, texel_m=0.012))
    part.quad((0, 0, 0), (h, 0, 0), (0, h, 0), Material(_parquet, texel_m=0.012))
    part.quad((0, h, HEIGHT), (h, 0, 0), (0, -h, 0), plain((0.65, 0.65, 0.62)))
    return part


def _lamp_quarter() -> Part:
    """A quarter of a square lamp below the ceiling."""
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
