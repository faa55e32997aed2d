"""Pictures on the walls of a building, signs, and what lies behind its windows."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from sequences.rendering.texture import Canvas, Material, band, blend, inside, step
from sequences.scenes.building.paint.colours import Rgb, colour, grey, light_colour


def outdoors(rng: np.random.Generator, emission: float) -> Material:
    """Sky above roofs, trees or hills, as seen through a window; of this brightness."""
    sky, ground = light_colour(rng), colour(rng, 0.5, 0.14)
    horizon, rough = float(rng.uniform(0.15, 0.6)), float(rng.uniform(0.02, 0.1))
    house = rng.uniform((0.0, 0.2), (1.0, 0.8))
    wall = colour(rng, 0.4, 0.35)

    def paint(canvas: Canvas) -> np.ndarray:
        y = canvas.y / canvas.height_m
        base = blend(canvas.colour((0.75, 0.86, 1.0)), sky, 0.25) * (0.7 + 0.4 * y)[..., None]
        base = blend(
            base, wall, inside(canvas, house[0], -1.0, house[0] + house[1], (horizon + 0.15) * canvas.height_m)
        )
        ridge = horizon + rough * canvas.noise(0.3, 9.0)
        leaves = (
            np.array(ground, np.float32)
            * np.clip(1 + 0.2 * canvas.noise(0.06) + 0.15 * canvas.noise(0.025), 0.2, 2)[..., None]
        )
        return blend(base, leaves.astype(np.float32), np.clip((ridge - y) / 0.03, 0, 1))

    return Material(paint, emission=emission, glare=0.28, texel_m=0.012)


def artwork(seed: int) -> Callable[[Canvas], np.ndarray]:
    """A picture like no other: discs, stripes, hills or squares in a few strong colours, in a frame."""
    rng = np.random.default_rng([161, seed])
    kind = rng.choice(["discs", "stripes", "hills", "squares", "blobs"])
    colours = [colour(rng, 1.0, 0.55) for _ in range(5)]
    a, b, c = (float(v) for v in rng.random(3))
    discs = rng.uniform((0.1, 0.1, 0.08), (0.9, 0.9, 0.3), (6, 3))
    rim = grey(rng, 0.02, 0.7)

    def paint(canvas: Canvas) -> np.ndarray:
        x, y = canvas.x / canvas.width_m + 0 * canvas.y, canvas.y / canvas.height_m + 0 * canvas.x
        base = canvas.colour(colours[0])
        if kind == "discs":
            for k, (cx, cy, radius) in enumerate(discs):
                base = blend(base, colours[1 + k % 4], 1 - step(np.hypot(x - cx, y - cy), radius, 0.01))
        elif kind == "stripes":
            wave = (x * (2 * a - 1) + y * (2 * b - 1)) * (5 + 8 * c)
            for k in range(1, 4):
                base = blend(base, colours[k], band(wave % 1.6, 0.4 * k, 0.4 * k + 0.3, 0.02))
        elif kind == "hills":
            for k in range(1, 5):
                hill = 0.95 - 0.2 * k + 0.09 * np.sin((4 + 5 * a) * x + 9 * b * k)
                base = blend(base, colours[k], 1 - step(y - hill, 0.0, 0.01))
            base = blend(base, colours[1], 1 - step(np.hypot(x - a, y - 0.85), 0.09, 0.01))
        elif kind == "squares":
            cell = (np.floor(x * (2 + int(4 * a))) * 7 + np.floor(y * (2 + int(4 * b))) * 3) % 5
            for k in range(1, 5):
                base = blend(base, colours[k], cell == k)
        else:
            for k in range(1, 5):
                base = blend(base, colours[k], np.clip(3 * (canvas.noise(0.15 + 0.1 * a) - 0.7), 0, 1))
        border = 0.03 / canvas.width_m, 0.03 / canvas.height_m
        return blend(base, rim, 1 - band(x, border[0], 1 - border[0]) * band(y, border[1], 1 - border[1]))

    return paint


def level_sign(level: int, rgb: Rgb) -> Callable[[Canvas], np.ndarray]:
    """A coloured field with as many bars as the number of the level above the ground floor, and one."""

    def paint(canvas: Canvas) -> np.ndarray:
        base = canvas.colour(rgb)
        bars = band((canvas.x - 0.08) % 0.12, 0.0, 0.06) * band(canvas.x, 0.08, 0.08 + 0.12 * (level + 1))
        return blend(base, (0.8, 0.8, 0.78), bars * band(canvas.y, 0.12, canvas.height_m - 0.12))

    return paint
