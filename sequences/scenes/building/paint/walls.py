"""How the walls of a building and the doors in them are painted."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from sequences.rendering import texture
from sequences.rendering.texture import Canvas, Material, band, blend, inside, step, weathered
from sequences.scenes.building.paint.colours import WALL_TEXEL_M, Rgb, colour, grey, light_colour, scaled


def draw_wall(rng: np.random.Generator) -> Material:
    """How the walls of a corridor or of a kind of room are painted."""
    kind = rng.choice(["painted", "painted", "dado", "dado", "striped", "panelled", "brick", "block", "line"])
    light, strong = light_colour(rng), colour(rng, 0.75, 0.3)
    paint = {
        "painted": lambda: _painted(light if rng.random() < 0.7 else colour(rng, 0.5, 0.5)),
        "dado": lambda: _dado(light, strong, float(rng.uniform(0.8, 1.4))),
        "striped": lambda: _striped(light, rng),
        "panelled": lambda: _panelled(light, rng),
        "brick": lambda: _masonry(colour(rng, 0.7, 0.3), (0.25, 0.075)),
        "block": lambda: _masonry(light_colour(rng), (float(rng.uniform(0.4, 0.6)), 0.2)),
        "line": lambda: _lined(light, strong, float(rng.uniform(0.9, 1.3))),
    }[kind]()
    return Material(_skirted(paint, grey(rng, 0.05, 0.6)), gloss=0.1, texel_m=WALL_TEXEL_M)


def draw_stair_wall(rng: np.random.Generator) -> Callable[[Canvas], np.ndarray]:
    """A wall that flights lead along: the same at every height."""
    light, kind = light_colour(rng), rng.choice(["painted", "painted", "striped", "block", "brick"])
    paint = {
        "painted": lambda: _painted(light if rng.random() < 0.6 else colour(rng, 0.5, 0.45)),
        "striped": lambda: _striped(light, rng),
        "block": lambda: _masonry(light, (float(rng.uniform(0.4, 0.6)), 0.2)),
        "brick": lambda: _masonry(colour(rng, 0.7, 0.3), (0.25, 0.075)),
    }[kind]()
    runs = colour(rng, 0.3, 0.15)

    def used(canvas: Canvas) -> np.ndarray:
        z = _above_floor(canvas)
        base = _used(canvas, paint(canvas), 0 * z + 0.5)
        return blend(base, runs, 0.35 * np.clip(canvas.noise(0.06, 0.8) - 1.3, 0, 1))

    return used


def _skirted(paint: Callable[[Canvas], np.ndarray], rgb: Rgb) -> Callable[[Canvas], np.ndarray]:
    def skirted(canvas: Canvas) -> np.ndarray:
        z = _above_floor(canvas)
        base = blend(_used(canvas, paint(canvas), z), (0.1, 0.09, 0.08), 0.25 * np.exp(-np.maximum(z, 0) / 0.25))
        return blend(base, rgb, band(z, -0.05, 0.09))

    return skirted


def _used(canvas: Canvas, base: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Stains at any height, scuffs where people and carts brush along."""
    stains = 0.22 * np.clip(canvas.noise(0.45, 0.3) - 1.0, 0, 1)
    scuffs = 0.2 * np.clip(canvas.noise(0.12, 0.012) - 1.9, 0, 1) * band(z, 0.05, 1.3, 0.4)
    return blend(base, (0.10, 0.09, 0.08), stains + scuffs)


def _above_floor(canvas: Canvas) -> np.ndarray:
    return np.broadcast_to(canvas.point(2), canvas.shape)


def _along_wall(canvas: Canvas) -> np.ndarray:
    """Distance along a wall that goes on across its parts: walls run along x or y."""
    return np.broadcast_to(canvas.point(0) + canvas.point(1), canvas.shape)


def _painted(rgb: Rgb) -> Callable[[Canvas], np.ndarray]:
    return lambda canvas: weathered(canvas, canvas.colour(rgb), 0.06)


def _dado(upper: Rgb, lower: Rgb, height_m: float) -> Callable[[Canvas], np.ndarray]:
    def paint(canvas: Canvas) -> np.ndarray:
        z = _above_floor(canvas)
        base = blend(canvas.colour(lower), upper, step(z, height_m))
        base = blend(base, scaled(lower, 0.4), band(z, height_m, height_m + 0.03))
        return weathered(canvas, base, 0.045)

    return paint


def _lined(rgb: Rgb, line: Rgb, height_m: float) -> Callable[[Canvas], np.ndarray]:
    def paint(canvas: Canvas) -> np.ndarray:
        z = _above_floor(canvas)
        return weathered(canvas, blend(canvas.colour(rgb), line, band(z, height_m, height_m + 0.16)), 0.04)

    return paint


def _striped(rgb: Rgb, rng: np.random.Generator) -> Callable[[Canvas], np.ndarray]:
    period, other = float(rng.uniform(0.2, 0.7)), scaled(rgb, float(rng.uniform(0.5, 0.9)))

    def paint(canvas: Canvas) -> np.ndarray:
        stripes = band(_along_wall(canvas) % period, 0.0, period / 2, 0.01)
        return weathered(canvas, blend(canvas.colour(rgb), other, stripes), 0.03)

    return paint


def _panelled(upper: Rgb, rng: np.random.Generator) -> Callable[[Canvas], np.ndarray]:
    board, height_m, stain = float(rng.uniform(0.1, 0.6)), float(rng.uniform(0.9, 2.2)), float(rng.uniform(0.7, 2.2))

    def paint(canvas: Canvas) -> np.ndarray:
        z = _above_floor(canvas)
        boards = texture.wood(canvas) * np.float32(stain)
        boards = blend(boards, (0.03, 0.02, 0.01), 0.8 * (1 - band(_along_wall(canvas) % board, 0.006, board - 0.006)))
        base = blend(boards, weathered(canvas, canvas.colour(upper), 0.04), step(z, height_m))
        return blend(base, (0.08, 0.05, 0.03), band(z, height_m - 0.03, height_m + 0.02))

    return paint


def _masonry(rgb: Rgb, size: tuple[float, float]) -> Callable[[Canvas], np.ndarray]:
    length, height = size

    def paint(canvas: Canvas) -> np.ndarray:
        row = np.floor(_above_floor(canvas) / height)
        x = _along_wall(canvas) + length / 2 * (row % 2)
        joint = 1 - band(x % length, 0.008, length - 0.008) * band(_above_floor(canvas) % height, 0.006, height - 0.006)
        tone = 1 + 0.16 * np.sin(row * 12.9 + np.floor(x / length) * 78.2)
        base = canvas.colour(rgb) * (tone * (1 + 0.06 * canvas.noise(0.03)))[..., None].astype(np.float32)
        return blend(base, scaled(rgb, 0.75), 0.8 * joint)

    return paint


def draw_door(rng: np.random.Generator) -> Material:
    """How a door's leaf is painted: wood, or one colour."""
    if rng.random() < 0.45:
        stain = rng.uniform(0.5, 2.2, 3) * rng.uniform(0.7, 1.3)
        return Material(lambda canvas: texture.door(canvas) * stain.astype(np.float32), gloss=0.3, texel_m=0.01)
    rgb = colour(rng, 0.7, 0.3) if rng.random() < 0.6 else grey(rng)
    return painted_door(rgb)


def painted_door(rgb: Rgb) -> Material:
    """A smooth leaf in one colour with a kick plate and a slim pane."""

    def paint(canvas: Canvas) -> np.ndarray:
        base = weathered(canvas, canvas.colour(rgb), 0.03)
        base = blend(base, (0.4, 0.4, 0.39), inside(canvas, 0.03, 0.02, canvas.width_m - 0.03, 0.22))
        return blend(base, (0.05, 0.06, 0.07), inside(canvas, 0.62, 1.0, 0.76, 1.8))

    return Material(paint, gloss=0.25, texel_m=0.01)
