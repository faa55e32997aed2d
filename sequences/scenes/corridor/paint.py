"""What the corridor is painted with, and what it is made of."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sequences.rendering import texture
from sequences.rendering.texture import Canvas, Material, band, blend, inside, plain, weathered
from sequences.scenes.corridor.dimensions import DISTINCT, WIDTH


def tint(x: np.ndarray, high_y: bool) -> np.ndarray:
    """How the colour of a wall changes along it: a factor (..., 3) for places x in metres."""
    phase = np.random.default_rng([5, high_y]).uniform(0, 2 * np.pi, (3, 2))
    waves = [0.7 * np.sin(2 * np.pi * x / 53.0 + a) + 0.5 * np.sin(2 * np.pi * x / 19.0 + b) for a, b in phase]
    return np.exp(0.55 * DISTINCT * np.stack(waves, axis=-1)).astype(np.float32)


def wall(canvas: Canvas, bay: int, high_y: bool) -> np.ndarray:
    """White plaster above oil paint, a bumper rail between: alike in all bays but for colour and dirt."""
    shared = replace(canvas, rng=np.random.default_rng([6, high_y]))
    own = replace(canvas, rng=np.random.default_rng([7, bay, high_y]))
    factor = tint(np.broadcast_to(canvas.point(0), canvas.shape), high_y)
    z = canvas.point(2) + 0 * canvas.x
    base = texture.plaster(shared) * factor ** np.float32(0.3)
    oil = weathered(shared, shared.colour((0.30, 0.32, 0.30)), 0.05) * factor
    base = blend(oil, base, texture.step(z, 1.0))
    dirt = 0.35 * np.clip(own.noise(0.5, 0.3) - 0.9, 0, 1) + 0.7 * np.clip(own.noise(0.2, 0.02) - 1.9, 0, 1)
    base = blend(base, (0.10, 0.09, 0.08), DISTINCT * dirt * band(z, 0.1, 1.6, 0.5))
    base = blend(base, (0.16, 0.12, 0.09), band(z, 0.93, 1.05))
    return blend(base, (0.07, 0.07, 0.07), band(z, -0.01, 0.1))


def linoleum(canvas: Canvas) -> np.ndarray:
    """Squares of two greys with joints, and a dark border along the walls."""
    tile = (np.floor(canvas.x / 0.5) + np.floor(canvas.y / 0.4)) % 2
    base = weathered(canvas, canvas.colour((0.25, 0.27, 0.27)), 0.08) * (1 + 0.25 * tile)[..., None]
    joint = 1 - band(canvas.x % 0.5, 0.006, 0.494) * band(canvas.y % 0.4, 0.006, 0.394)
    base = blend(base, (0.08, 0.08, 0.08), 0.6 * joint)
    return blend(base, (0.09, 0.10, 0.11), 1 - band(canvas.y, 0.2, WIDTH - 0.2) + 0 * canvas.x)


def panels(canvas: Canvas) -> np.ndarray:
    """Ceiling panels of 0.625 m × 0.6 m in a white grid."""
    base = weathered(canvas, canvas.colour((0.62, 0.61, 0.58)), 0.03)
    grid = 1 - band(canvas.x % 0.625, 0.012, 0.613) * band(canvas.y % 0.6, 0.012, 0.588)
    return blend(base, (0.35, 0.35, 0.34), grid)


def sheets(canvas: Canvas, colour: tuple[float, float, float]) -> np.ndarray:
    """A felt board of one colour with white sheets."""
    base = weathered(canvas, canvas.colour(colour), 0.06)
    for x0, y0, x1, y1 in ((0.08, 0.38, 0.29, 0.68), (0.36, 0.42, 0.57, 0.70), (0.70, 0.30, 1.0, 0.52)):
        lines = inside(canvas, x0 + 0.02, y0 + 0.03, x1 - 0.02, y1 - 0.05) * (np.sin(canvas.y * 2 * np.pi / 0.04) > 0.2)
        base = blend(base, (0.75, 0.75, 0.72), inside(canvas, x0, y0, x1, y1))
        base = blend(base, (0.12, 0.12, 0.14), 0.7 * lines)
    rim = 1 - inside(canvas, 0.03, 0.03, canvas.width_m - 0.03, canvas.height_m - 0.03)
    return blend(base, (0.5, 0.5, 0.48), rim)


def mural(canvas: Canvas, which: int) -> np.ndarray:
    """A painted wall: waves, suns, stripes or squares, each in colours of its own."""
    x, y = canvas.x + 0 * canvas.y, canvas.y + 0 * canvas.x
    if which == 0:  # blue waves under a white sky
        base = canvas.colour((0.75, 0.78, 0.80))
        for k, rgb in enumerate(((0.10, 0.35, 0.62), (0.04, 0.18, 0.45), (0.02, 0.07, 0.25))):
            base = blend(base, rgb, 1 - texture.step(y - 0.1 * np.sin(2.5 * x + 2 * k), 1.2 - 0.4 * k))
        return base
    if which == 1:  # orange suns on yellow
        radius = np.hypot(x % 0.8 - 0.4, y % 0.8 - 0.4)
        return blend(canvas.colour((0.75, 0.60, 0.08)), (0.70, 0.15, 0.03), 1 - texture.step(radius, 0.28))
    if which == 2:  # slanting stripes, red and white
        return blend(canvas.colour((0.70, 0.68, 0.66)), (0.50, 0.03, 0.05), band((x + y) % 0.7, 0.0, 0.35))
    squares = (np.floor(x / 0.4) + np.floor(y / 0.4)) % 2  # black and green
    return blend(canvas.colour((0.03, 0.04, 0.03)), (0.12, 0.50, 0.10), squares)


def sign_art(canvas: Canvas) -> np.ndarray:
    """A green exit sign with a white arrow."""
    arrow = inside(canvas, 0.1, 0.08, 0.3, 0.12) + inside(canvas, 0.1, 0.04, 0.15, 0.16)
    return blend(canvas.colour((0.01, 0.42, 0.12)), (0.9, 1.0, 0.92), arrow)


FRAME = plain((0.33, 0.34, 0.36), gloss=0.2)
TRIM = plain((0.50, 0.49, 0.45), gloss=0.2)
METAL = Material(texture.brushed, gloss=0.6)
LAMP = replace(texture.lit((1.0, 0.96, 0.88), 8.0), glare=0.3)
SKY = Material(texture.sky, emission=6.0, glare=0.4)
