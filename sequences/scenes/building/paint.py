"""How a building is painted: walls, doors, floors, ceilings, pictures, and the view from its windows."""

from __future__ import annotations

import colorsys
from collections.abc import Callable
from functools import partial
from typing import TypeAlias

import numpy as np

from sequences.rendering import texture
from sequences.rendering.texture import Canvas, Material, band, blend, inside, plain, step, weathered

Rgb: TypeAlias = tuple[float, float, float]
Paint: TypeAlias = Callable[[Canvas], np.ndarray]
WALL_TEXEL_M, FINE_TEXEL_M = 0.015, 0.008


def colour(rng: np.random.Generator, saturation: float, brightness: float) -> Rgb:
    """Linear reflectance of any hue."""
    return colorsys.hsv_to_rgb(rng.random(), rng.uniform(0.4, 1.0) * saturation, brightness * rng.uniform(0.7, 1.4))


def scaled(rgb: Rgb, by: float) -> Rgb:
    """A colour made brighter or darker."""
    return rgb[0] * by, rgb[1] * by, rgb[2] * by


def light_colour(rng: np.random.Generator) -> Rgb:
    """A pale colour of any hue."""
    return colorsys.hsv_to_rgb(rng.random(), rng.uniform(0.02, 0.28), rng.uniform(0.45, 0.72))


def grey(rng: np.random.Generator, low: float = 0.2, high: float = 0.5) -> Rgb:
    """A grey with a tinge of any hue, of a brightness in this range."""
    return colorsys.hsv_to_rgb(rng.random(), 0.08, rng.uniform(low, high))


def draw_wall(rng: np.random.Generator) -> Material:
    """The paint of the walls of a corridor or of a kind of room."""
    kind = rng.choice(["painted", "painted", "dado", "dado", "striped", "panelled", "brick", "block", "line"])
    light, strong = light_colour(rng), colour(rng, 0.75, 0.3)
    if kind == "dado":
        paint = partial(_dado, upper=light, lower=strong, height_m=rng.uniform(0.8, 1.4))
    elif kind == "panelled":
        board, height_m, stain = rng.uniform(0.1, 0.6), rng.uniform(0.9, 2.2), rng.uniform(0.7, 2.2)
        paint = partial(_panelled, upper=light, board=board, height_m=height_m, stain=stain)
    elif kind == "line":
        paint = partial(_lined, rgb=light, line=strong, height_m=rng.uniform(0.9, 1.3))
    elif kind == "painted":
        paint = partial(_painted, rgb=light if rng.random() < 0.7 else colour(rng, 0.5, 0.5))
    else:
        paint = _draw_simple(kind, light_colour(rng) if kind == "block" else light, rng)
    return Material(partial(_skirted, paint=paint, rgb=grey(rng, 0.05, 0.6)), gloss=0.1, texel_m=WALL_TEXEL_M)


def draw_stair_wall(rng: np.random.Generator) -> Paint:
    """The paint of a wall that flights lead along: the same at every height."""
    light, kind = light_colour(rng), rng.choice(["painted", "painted", "striped", "block", "brick"])
    if kind == "painted":
        paint = partial(_painted, rgb=light if rng.random() < 0.6 else colour(rng, 0.5, 0.45))
    else:
        paint = _draw_simple(kind, light, rng)
    return partial(_along_flights, paint=paint, runs=colour(rng, 0.3, 0.15))


def _draw_simple(kind: str, light: Rgb, rng: np.random.Generator) -> Paint:
    if kind == "striped":
        return partial(_striped, rgb=light, period=rng.uniform(0.2, 0.7), other=scaled(light, rng.uniform(0.5, 0.9)))
    if kind == "block":
        return partial(_masonry, rgb=light, length=rng.uniform(0.4, 0.6), height=0.2)
    return partial(_masonry, rgb=colour(rng, 0.7, 0.3), length=0.25, height=0.075)


def _along_flights(canvas: Canvas, paint: Paint, runs: Rgb) -> np.ndarray:
    base = _used(canvas, paint(canvas), 0 * _above_floor(canvas) + 0.5)
    return blend(base, runs, 0.35 * np.clip(canvas.noise(0.06, 0.8) - 1.3, 0, 1))


def _skirted(canvas: Canvas, paint: Paint, rgb: Rgb) -> np.ndarray:
    z = _above_floor(canvas)
    base = blend(_used(canvas, paint(canvas), z), (0.1, 0.09, 0.08), 0.25 * np.exp(-np.maximum(z, 0) / 0.25))
    return blend(base, rgb, band(z, -0.05, 0.09))


def _used(canvas: Canvas, base: np.ndarray, z: np.ndarray) -> np.ndarray:
    stains = 0.22 * np.clip(canvas.noise(0.45, 0.3) - 1.0, 0, 1)
    scuffs = 0.2 * np.clip(canvas.noise(0.12, 0.012) - 1.9, 0, 1) * band(z, 0.05, 1.3, 0.4)
    return blend(base, (0.10, 0.09, 0.08), stains + scuffs)


def _above_floor(canvas: Canvas) -> np.ndarray:
    return np.broadcast_to(canvas.point(2), canvas.shape)


def _along_wall(canvas: Canvas) -> np.ndarray:
    """Distance along a wall that goes on across its parts: walls run along x or y."""
    return np.broadcast_to(canvas.point(0) + canvas.point(1), canvas.shape)


def _painted(canvas: Canvas, rgb: Rgb) -> np.ndarray:
    return weathered(canvas, canvas.colour(rgb), 0.06)


def _dado(canvas: Canvas, upper: Rgb, lower: Rgb, height_m: float) -> np.ndarray:
    z = _above_floor(canvas)
    base = blend(canvas.colour(lower), upper, step(z, height_m))
    base = blend(base, scaled(lower, 0.4), band(z, height_m, height_m + 0.03))
    return weathered(canvas, base, 0.045)


def _lined(canvas: Canvas, rgb: Rgb, line: Rgb, height_m: float) -> np.ndarray:
    z = _above_floor(canvas)
    return weathered(canvas, blend(canvas.colour(rgb), line, band(z, height_m, height_m + 0.16)), 0.04)


def _striped(canvas: Canvas, rgb: Rgb, period: float, other: Rgb) -> np.ndarray:
    stripes = band(_along_wall(canvas) % period, 0.0, period / 2, 0.01)
    return weathered(canvas, blend(canvas.colour(rgb), other, stripes), 0.03)


def _panelled(canvas: Canvas, upper: Rgb, board: float, height_m: float, stain: float) -> np.ndarray:
    z = _above_floor(canvas)
    boards = texture.wood(canvas) * np.float32(stain)
    boards = blend(boards, (0.03, 0.02, 0.01), 0.8 * (1 - band(_along_wall(canvas) % board, 0.006, board - 0.006)))
    base = blend(boards, weathered(canvas, canvas.colour(upper), 0.04), step(z, height_m))
    return blend(base, (0.08, 0.05, 0.03), band(z, height_m - 0.03, height_m + 0.02))


def _masonry(canvas: Canvas, rgb: Rgb, length: float, height: float) -> np.ndarray:
    row = np.floor(_above_floor(canvas) / height)
    x = _along_wall(canvas) + length / 2 * (row % 2)
    joint = 1 - band(x % length, 0.008, length - 0.008) * band(_above_floor(canvas) % height, 0.006, height - 0.006)
    tone = 1 + 0.16 * np.sin(row * 12.9 + np.floor(x / length) * 78.2)
    base = canvas.colour(rgb) * (tone * (1 + 0.06 * canvas.noise(0.03)))[..., None].astype(np.float32)
    return blend(base, scaled(rgb, 0.75), 0.8 * joint)


def draw_door(rng: np.random.Generator) -> Material:
    """The paint of a door's leaf: wood, or one colour."""
    if rng.random() < 0.45:
        stain = rng.uniform(0.5, 2.2, 3) * rng.uniform(0.7, 1.3)
        return Material(lambda canvas: texture.door(canvas) * stain.astype(np.float32), gloss=0.3, texel_m=0.01)
    return painted_door(colour(rng, 0.7, 0.3) if rng.random() < 0.6 else grey(rng))


def painted_door(rgb: Rgb) -> Material:
    """A smooth leaf in one colour with a kick plate and a slim pane."""
    return Material(partial(_leaf, rgb=rgb), gloss=0.25, texel_m=0.01)


def _leaf(canvas: Canvas, rgb: Rgb) -> np.ndarray:
    base = weathered(canvas, canvas.colour(rgb), 0.03)
    base = blend(base, (0.4, 0.4, 0.39), inside(canvas, 0.03, 0.02, canvas.width_m - 0.03, 0.22))
    return blend(base, (0.05, 0.06, 0.07), inside(canvas, 0.62, 1.0, 0.76, 1.8))


def draw_floor(rng: np.random.Generator) -> Material:
    """The material of a floor."""
    kind = rng.choice(["tiles", "tiles", "planks", "parquet", "carpet", "stone", "concrete"])
    if kind == "tiles":
        size, first = rng.uniform(0.25, 0.7), colour(rng, 0.45, 0.3)
        second = scaled(first, rng.uniform(0.5, 0.95)) if rng.random() < 0.7 else first
        paint = partial(_tiles, first=first, second=second, size=size)
        return Material(paint, gloss=rng.uniform(0.1, 0.5), texel_m=WALL_TEXEL_M)
    if kind == "planks":
        paint = partial(_planks, width=rng.uniform(0.09, 0.22), stain=rng.uniform(0.6, 2.0))
        return Material(paint, gloss=0.25, texel_m=0.012)
    if kind == "parquet":
        paint = partial(_parquet, size=rng.uniform(0.25, 0.5), stain=rng.uniform(0.7, 1.8))
        return Material(paint, gloss=0.25, texel_m=0.012)
    if kind == "carpet":
        return Material(partial(_carpet, rgb=colour(rng, 0.7, 0.14)), texel_m=WALL_TEXEL_M)
    if kind == "stone":
        return stone(grey(rng))
    return Material(lambda canvas: weathered(canvas, canvas.colour((0.3, 0.295, 0.28)), 0.1), gloss=0.2, texel_m=0.02)


def _tiles(canvas: Canvas, first: Rgb, second: Rgb, size: float) -> np.ndarray:
    x, y = canvas.point(0), canvas.point(1)
    odd = (np.floor(x / size) + np.floor(y / size)) % 2
    base = weathered(canvas, blend(canvas.colour(first), second, odd), 0.05)
    joint = 1 - band(x % size, 0.008, size - 0.008) * band(y % size, 0.008, size - 0.008)
    return blend(base, scaled(first, 0.35), 0.7 * joint)


def _planks(canvas: Canvas, width: float, stain: float) -> np.ndarray:
    x, y = canvas.point(0) + 0 * canvas.y, canvas.point(1) + 0 * canvas.x
    row = np.floor(y / width)
    along = x + 0.7 * np.sin(37.0 * row)
    tone = 1 + 0.2 * np.sin(row * 12.9 + np.floor(along / 1.6) * 78.2)
    grain = 0.15 * canvas.noise(0.4, 0.015)
    base = canvas.colour((0.33, 0.185, 0.085)) * (stain * tone * (1 + grain))[..., None].astype(np.float32)
    joint = 1 - band(y % width, 0.003, width - 0.003) * band(along % 1.6, 0.004, 1.596)
    return blend(base, (0.04, 0.025, 0.015), 0.7 * joint)


def _parquet(canvas: Canvas, size: float, stain: float) -> np.ndarray:
    x, y = canvas.point(0) + 0 * canvas.y, canvas.point(1) + 0 * canvas.x
    across = (np.floor(x / size) + np.floor(y / size)) % 2 == 0
    stave = np.where(across, x, y) % (size / 5)
    tone = stain * np.where(across, 1.0, 1.25) * (1 + 0.12 * canvas.noise(0.06))
    base = canvas.colour((0.30, 0.17, 0.08)) * tone[..., None].astype(np.float32)
    return blend(base, (0.05, 0.03, 0.015), 0.7 * (1 - band(stave, 0.003, size / 5 - 0.003)))


def _carpet(canvas: Canvas, rgb: Rgb) -> np.ndarray:
    speckle = 1 + 0.18 * canvas.noise(0.02) + 0.1 * canvas.noise(0.3)
    return canvas.colour(rgb) * np.clip(speckle, 0.3, 2)[..., None]


def stone(rgb: Rgb) -> Material:
    """Ground stone with light and dark chips."""
    return Material(partial(_chips, rgb=rgb), gloss=0.5, texel_m=0.012)


def _chips(canvas: Canvas, rgb: Rgb) -> np.ndarray:
    base = weathered(canvas, canvas.colour(rgb), 0.06)
    chips = canvas.rng.random(canvas.shape, np.float32)
    base = blend(base, scaled(rgb, 1.7), (chips > 0.87) * 0.7)
    return blend(base, scaled(rgb, 0.3), (chips < 0.12) * 0.7)


def draw_ceiling(rng: np.random.Generator) -> Material:
    """The material of a ceiling: paint, or panels in a grid."""
    rgb = grey(rng, 0.55, 0.7)
    if rng.random() < 0.5:
        return plain(rgb)
    return Material(partial(_panels, rgb=rgb, size=float(rng.choice([0.6, 0.625, 1.2]))), texel_m=0.02)


def _panels(canvas: Canvas, rgb: Rgb, size: float) -> np.ndarray:
    x, y = canvas.point(0), canvas.point(1)
    grid = 1 - band(x % size, 0.012, size - 0.012) * band(y % 0.6, 0.012, 0.588)
    return blend(weathered(canvas, canvas.colour(rgb), 0.03), scaled(rgb, 0.5), grid)


def outdoors(rng: np.random.Generator, emission: float) -> Material:
    """Sky above roofs, trees or hills, as seen through a window; of this brightness."""
    sky, ground = light_colour(rng), colour(rng, 0.5, 0.14)
    horizon, rough = rng.uniform(0.15, 0.6), rng.uniform(0.02, 0.1)
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
