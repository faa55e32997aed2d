"""What the floors and ceilings of a building are made of."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from sequences.rendering.texture import Canvas, Material, band, blend, plain, weathered
from sequences.scenes.building.paint.colours import WALL_TEXEL_M, Rgb, colour, grey, scaled


def draw_floor(rng: np.random.Generator) -> Material:
    """What a floor is made of."""
    kind = rng.choice(["tiles", "tiles", "planks", "parquet", "carpet", "stone", "concrete"])
    if kind == "tiles":
        size, first = float(rng.uniform(0.25, 0.7)), colour(rng, 0.45, 0.3)
        second = scaled(first, float(rng.uniform(0.5, 0.95))) if rng.random() < 0.7 else first
        return Material(_tiles(first, second, size), gloss=float(rng.uniform(0.1, 0.5)), texel_m=WALL_TEXEL_M)
    if kind == "planks":
        return Material(_planks(float(rng.uniform(0.09, 0.22)), float(rng.uniform(0.6, 2.0))), 0.0, 1.0, 0.25, 0.012)
    if kind == "parquet":
        return Material(_parquet(float(rng.uniform(0.25, 0.5)), float(rng.uniform(0.7, 1.8))), 0.0, 1.0, 0.25, 0.012)
    if kind == "carpet":
        return Material(_carpet(colour(rng, 0.7, 0.14)), texel_m=WALL_TEXEL_M)
    if kind == "stone":
        return Material(stone(grey(rng)), gloss=0.5, texel_m=0.012)
    return Material(lambda canvas: weathered(canvas, canvas.colour((0.3, 0.295, 0.28)), 0.1), gloss=0.2, texel_m=0.02)


def _tiles(first: Rgb, second: Rgb, size: float) -> Callable[[Canvas], np.ndarray]:
    def paint(canvas: Canvas) -> np.ndarray:
        x, y = canvas.point(0), canvas.point(1)
        odd = (np.floor(x / size) + np.floor(y / size)) % 2
        base = weathered(canvas, blend(canvas.colour(first), second, odd), 0.05)
        joint = 1 - band(x % size, 0.008, size - 0.008) * band(y % size, 0.008, size - 0.008)
        return blend(base, scaled(first, 0.35), 0.7 * joint)

    return paint


def _planks(width: float, stain: float) -> Callable[[Canvas], np.ndarray]:
    def paint(canvas: Canvas) -> np.ndarray:
        x, y = canvas.point(0) + 0 * canvas.y, canvas.point(1) + 0 * canvas.x
        row = np.floor(y / width)
        along = x + 0.7 * np.sin(37.0 * row)
        tone = 1 + 0.2 * np.sin(row * 12.9 + np.floor(along / 1.6) * 78.2)
        grain = 0.15 * canvas.noise(0.4, 0.015)
        base = canvas.colour((0.33, 0.185, 0.085)) * (stain * tone * (1 + grain))[..., None].astype(np.float32)
        joint = 1 - band(y % width, 0.003, width - 0.003) * band(along % 1.6, 0.004, 1.596)
        return blend(base, (0.04, 0.025, 0.015), 0.7 * joint)

    return paint


def _parquet(size: float, stain: float) -> Callable[[Canvas], np.ndarray]:
    def paint(canvas: Canvas) -> np.ndarray:
        x, y = canvas.point(0) + 0 * canvas.y, canvas.point(1) + 0 * canvas.x
        across = (np.floor(x / size) + np.floor(y / size)) % 2 == 0
        stave = np.where(across, x, y) % (size / 5)
        tone = stain * np.where(across, 1.0, 1.25) * (1 + 0.12 * canvas.noise(0.06))
        base = canvas.colour((0.30, 0.17, 0.08)) * tone[..., None].astype(np.float32)
        return blend(base, (0.05, 0.03, 0.015), 0.7 * (1 - band(stave, 0.003, size / 5 - 0.003)))

    return paint


def _carpet(rgb: Rgb) -> Callable[[Canvas], np.ndarray]:
    def paint(canvas: Canvas) -> np.ndarray:
        speckle = 1 + 0.18 * canvas.noise(0.02) + 0.1 * canvas.noise(0.3)
        return canvas.colour(rgb) * np.clip(speckle, 0.3, 2)[..., None]

    return paint


def stone(rgb: Rgb) -> Callable[[Canvas], np.ndarray]:
    """Ground stone with light and dark chips."""

    def paint(canvas: Canvas) -> np.ndarray:
        base = weathered(canvas, canvas.colour(rgb), 0.06)
        chips = canvas.rng.random(canvas.shape, np.float32)
        base = blend(base, scaled(rgb, 1.7), (chips > 0.87) * 0.7)
        return blend(base, scaled(rgb, 0.3), (chips < 0.12) * 0.7)

    return paint


def draw_ceiling(rng: np.random.Generator) -> Material:
    """What a ceiling is made of: paint, or panels in a grid."""
    rgb = grey(rng, 0.55, 0.7)
    if rng.random() < 0.5:
        return plain(rgb)
    size = float(rng.choice([0.6, 0.625, 1.2]))

    def paint(canvas: Canvas) -> np.ndarray:
        x, y = canvas.point(0), canvas.point(1)
        grid = 1 - band(x % size, 0.012, size - 0.012) * band(y % 0.6, 0.012, 0.588)
        return blend(weathered(canvas, canvas.colour(rgb), 0.03), scaled(rgb, 0.5), grid)

    return Material(paint, texel_m=0.02)
