"""The furniture of a building. Each piece has its back to the wall y = 0 and begins at x = 0."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TypeAlias

import numpy as np

from sequences.rendering import texture
from sequences.rendering.mesh import Part
from sequences.rendering.texture import Canvas, Material, band, blend, inside, plain, rim, weathered
from sequences.scenes.building.paint import FINE_TEXEL_M, Rgb, artwork, colour, scaled


@dataclass(frozen=True)
class Piece:
    """A piece of furniture, and the box around it, metres, from x = y = z = 0."""

    part: Part
    width: float
    depth: float
    height: float


def _timber(rng: np.random.Generator) -> Material:
    if rng.random() < 0.3:
        return plain(colour(rng, 0.6, 0.4), gloss=0.2)
    stain = rng.uniform(0.5, 2.2)
    return Material(lambda canvas: texture.wood(canvas) * np.float32(stain), gloss=0.2, texel_m=0.012)


def _books(rng: np.random.Generator) -> Material:
    shelf, seed = rng.uniform(0.3, 0.42), int(rng.integers(1 << 30))
    spine, stain = rng.uniform(0.03, 0.2), rng.uniform(0.5, 2.0)

    def paint(canvas: Canvas) -> np.ndarray:
        drawn = np.random.default_rng(seed)
        base = texture.wood(canvas) * np.float32(stain)
        for row in range(int((canvas.height_m - 0.05) / shelf)):
            x = 0.04
            while x < canvas.width_m - 0.05:
                thick, tall = spine * drawn.uniform(0.6, 1.6), shelf * drawn.uniform(0.55, 0.85)
                low = 0.05 + row * shelf
                if drawn.random() < 0.88:
                    right = min(x + thick * 0.93, canvas.width_m - 0.04)
                    base = blend(base, colour(drawn, 0.8, 0.3), inside(canvas, x, low, right, low + tall))
                else:
                    base = blend(base, (0.03, 0.025, 0.02), inside(canvas, x, low, x + thick, low + shelf - 0.04))
                x += thick
        return base

    return Material(paint, texel_m=FINE_TEXEL_M)


def _fronts(rgb: Rgb, columns: int, rows: int) -> Material:
    def paint(canvas: Canvas) -> np.ndarray:
        w, h = canvas.width_m / columns, canvas.height_m / rows
        x, y = canvas.x % w, canvas.y % h
        base = weathered(canvas, canvas.colour(rgb), 0.03)
        base = blend(base, scaled(rgb, 0.2), 1 - band(x, 0.008, w - 0.008) * band(y, 0.008, h - 0.008))
        return blend(base, (0.1, 0.1, 0.1), band(x, w / 2 - 0.06, w / 2 + 0.06) * band(y, h - 0.07, h - 0.05))

    return Material(paint, gloss=0.2, texel_m=FINE_TEXEL_M)


def _screen(canvas: Canvas) -> np.ndarray:
    base = canvas.colour((0.02, 0.02, 0.022))
    return blend(base, (0.04, 0.06, 0.09), inside(canvas, 0.02, 0.02, canvas.width_m - 0.02, canvas.height_m - 0.02))


def _whiteboard(canvas: Canvas) -> np.ndarray:
    base = canvas.colour((0.75, 0.76, 0.76))
    lines = (np.sin(canvas.y * 2 * np.pi / 0.13) > 0.75) & (canvas.noise(0.15, 0.05) > 0.1)
    written = inside(canvas, 0.15, 0.3, 0.7 * canvas.width_m, canvas.height_m - 0.12) * lines
    base = blend(base, (0.05, 0.07, 0.3), 0.8 * written)
    return blend(base, (0.25, 0.25, 0.25), rim(canvas, 0.03))


def _leaves(canvas: Canvas) -> np.ndarray:
    tone = np.clip(1 + 0.5 * canvas.noise(0.05) + 0.4 * canvas.noise(0.02), 0.15, 2.2)
    return canvas.colour((0.06, 0.15, 0.04)) * tone[..., None]


Range: TypeAlias = float | tuple[float, float]
"""A size, or the limits between which it is drawn."""


def _drawn(rng: np.random.Generator, size: Range) -> float:
    return rng.uniform(*size) if isinstance(size, tuple) else size


def _cupboard(
    rng: np.random.Generator, size: tuple[Range, Range, Range], fronts: tuple[int, int], saturation: float = 0.5
) -> Piece:
    """A box of a size (width, depth, height) with columns and rows of fronts."""
    part, (w, d, h) = Part(), (_drawn(rng, each) for each in size)
    rgb = colour(rng, saturation, 0.35)
    part.box((0, 0, 0), (w, d, h), plain(rgb, gloss=0.2), "xXZ")
    part.box((0, 0, 0), (w, d, h), _fronts(rgb, *fronts), "Y")
    return Piece(part, w, d, h)


def _counter(rng: np.random.Generator) -> Piece:
    part, w = Part(), rng.uniform(1.4, 2.2)
    rgb, top = colour(rng, 0.6, 0.4), plain(colour(rng, 0.2, 0.25), gloss=0.4)
    part.box((0, 0, 0), (w, 0.56, 0.87), plain(rgb), "xX")
    part.box((0, 0, 0), (w, 0.56, 0.87), _fronts(rgb, 3, 1), "Y")
    part.box((0, 0, 0.87), (w, 0.6, 0.91), top, "xXYZz")
    part.box((0.2, 0.15, 0.91), (0.65, 0.5, 0.915), Material(texture.brushed, gloss=0.6), "Z")
    part.beam((0.42, 0.08, 0.91), (0.42, 0.08, 1.15), 0.015, Material(texture.brushed, gloss=0.6), 6)
    part.box((0, 0, 1.45), (w, 0.34, 2.1), plain(rgb), "xXzZ")
    part.box((0, 0, 1.45), (w, 0.34, 2.1), _fronts(rgb, 3, 1), "Y")
    return Piece(part, w, 0.6, 2.1)


def _shelf(rng: np.random.Generator) -> Piece:
    part, w, d, h = Part(), rng.uniform(0.8, 1.2), 0.32, rng.uniform(1.5, 2.1)
    body = _timber(rng)
    part.box((0, 0, 0), (w, d, h), body, "xXZ")
    part.box((0, 0, 0), (w, d - 0.01, h), _books(rng), "Y")
    for x in (0.0, w - 0.025):
        part.box((x, d - 0.02, 0), (x + 0.025, d, h), body, "xXY")
    return Piece(part, w, d, h)


def _rack(rng: np.random.Generator) -> Piece:
    part, w, d, h = Part(), rng.uniform(0.9, 1.4), 0.45, rng.uniform(1.3, 2.0)
    metal = plain(colour(rng, 0.5, 0.25), gloss=0.4)
    for x in (0.0, w - 0.04):
        for y in (0.0, d - 0.04):
            part.box((x, y, 0), (x + 0.04, y + 0.04, h), metal, "xXyY")
    for z in np.linspace(0.15, h - 0.03, 4):
        part.box((0, 0, z), (w, d, z + 0.03), metal, "yYzZxX")
    for z in np.linspace(0.15, h - 0.03, 4)[:3]:
        x = 0.08
        while x < w - 0.3:
            size = rng.uniform(0.18, 0.34)
            high = z + 0.03 + rng.uniform(0.12, 0.28)
            part.box((x, 0.06, z + 0.03), (x + size, d - 0.06, high), plain(colour(rng, 0.7, 0.3)), "xXyYZ")
            x += size + rng.uniform(0.03, 0.2)
    return Piece(part, w, d, h)


def _boxes(rng: np.random.Generator) -> Piece:
    part = Part()
    for x, y, z, size in ((0.0, 0.0, 0.0, 0.5), (0.52, 0.05, 0.0, 0.4), (0.06, 0.04, 0.5, 0.38)):
        tint = rng.uniform(0.7, 1.3)
        card = plain((0.30 * tint, 0.2 * tint, 0.11 * tint), amount=0.08)
        part.box((x, y, z), (x + size, y + size, z + size), card, "xXyYZ")
    return Piece(part, 0.92, 0.5, 0.88)


def _crates(rng: np.random.Generator) -> Piece:
    part = Part()
    for x, z, w in ((0.0, 0.0, 0.6), (0.62, 0.0, 0.5), (0.1, 0.45, 0.5), (0.2, 0.8, 0.4)):
        part.box((x, 0.0, z), (x + w, 0.6, z + 0.42 - z / 4), plain(colour(rng, 0.8, 0.25)), "xXyYZ")
    return Piece(part, 1.12, 0.6, 1.1)


def _waste_bin(rng: np.random.Generator) -> Piece:
    part = Part()
    part.beam((0.2, 0.2, 0), (0.2, 0.2, 0.5), 0.17, plain(colour(rng, 0.8, 0.25), gloss=0.3), 10)
    part.box((0.08, 0.08, 0.46), (0.32, 0.32, 0.47), plain((0.02, 0.02, 0.02)), "Z")
    return Piece(part, 0.4, 0.4, 0.5)


def _television(rng: np.random.Generator) -> Piece:
    piece = _cupboard(rng, ((1.2, 1.7), 0.42, 0.5), (3, 1))
    middle, half = piece.width / 2, 0.5
    piece.part.box((middle - half, 0.15, 0.58), (middle + half, 0.19, 1.15), plain((0.02, 0.02, 0.02)), "xXyzZ")
    piece.part.box((middle - half, 0.15, 0.58), (middle + half, 0.195, 1.15), Material(_screen, gloss=0.5), "Y")
    piece.part.box((middle - 0.1, 0.12, 0.5), (middle + 0.1, 0.22, 0.58), plain((0.02, 0.02, 0.02)), "xXyY")
    return Piece(piece.part, piece.width, 0.42, 1.15)


def _board(rng: np.random.Generator) -> Piece:
    part, w = Part(), rng.uniform(1.6, 2.6)
    part.box((0, 0, 0.9), (w, 0.04, 2.0), plain((0.3, 0.3, 0.3)), "xXzZ")
    part.box((0, 0, 0.9), (w, 0.04, 2.0), Material(_whiteboard, gloss=0.3, texel_m=0.01), "Y")
    part.box((0.3, 0.04, 0.9), (w - 0.3, 0.1, 0.92), plain((0.4, 0.4, 0.4)), "xXYzZ")
    return Piece(part, w, 0.1, 2.0)


def _plant(rng: np.random.Generator) -> Piece:
    part, tall = Part(), rng.uniform(0.9, 1.7)
    part.beam((0.27, 0.27, 0), (0.27, 0.27, 0.35), 0.16, plain(colour(rng, 0.7, 0.3)), 8)
    part.box((0.16, 0.16, 0.33), (0.38, 0.38, 0.335), plain((0.05, 0.03, 0.02)), "Z")
    part.beam((0.27, 0.27, 0.33), (0.27, 0.27, tall), 0.015, plain((0.1, 0.07, 0.04)), 5)
    green = Material(_leaves, texel_m=0.012)
    for k in range(14):
        angle, low = 2.4 * k, 0.4 + (tall - 0.6) * k / 14
        out, up = np.array([np.cos(angle), np.sin(angle), 0.0]), np.array([0.0, 0.0, 1.0])
        stem, aside = np.array([0.27, 0.27, low]), 0.05 * np.cross(up, out)
        part.quad(stem, 0.13 * out + 0.17 * up + aside, 0.13 * out + 0.1 * up - aside, green)
    return Piece(part, 0.54, 0.54, tall)


def radiator() -> Piece:
    """Below a window."""
    part = Part()
    part.box((0, 0.03, 0.12), (1.0, 0.12, 0.68), Material(texture.radiator, gloss=0.2), "xXYZ")
    return Piece(part, 1.0, 0.12, 0.68)


def _desk(rng: np.random.Generator) -> Piece:
    part, w, d, h = Part(), rng.uniform(1.1, 1.6), 0.6, rng.uniform(0.7, 0.78)
    top, dark = _timber(rng), plain((0.04, 0.04, 0.045), gloss=0.3)
    part.box((0, 0, h - 0.035), (w, d, h), top)
    part.box((0.02, 0.05, 0), (0.06, d - 0.05, h - 0.035), dark, "xXyY")
    part.box((w - 0.45, 0.05, 0.05), (w - 0.03, d - 0.06, h - 0.035), plain(colour(rng, 0.4, 0.3)), "xXy")
    front = _fronts(colour(rng, 0.4, 0.35), 1, 3)
    part.box((w - 0.45, 0.05, 0.05), (w - 0.03, d - 0.05, h - 0.035), front, "Y")
    x = w * rng.uniform(0.25, 0.45)
    part.box((x - 0.27, 0.12, h + 0.12), (x + 0.27, 0.15, h + 0.45), dark, "xXyzZ")
    part.box((x - 0.27, 0.12, h + 0.12), (x + 0.27, 0.155, h + 0.45), Material(_screen, gloss=0.4), "Y")
    part.box((x - 0.04, 0.1, h), (x + 0.04, 0.14, h + 0.2), dark, "xXY")
    part.box((x - 0.2, 0.35, h), (x + 0.2, 0.48, h + 0.02), dark, "xXYZ")
    part.box((w - 0.32, 0.2, h), (w - 0.1, 0.5, h + 0.05), plain(colour(rng, 0.9, 0.5)), "xXyYZ")
    return Piece(part, w, d, h + 0.45)


def _place(rng: np.random.Generator) -> Piece:
    part, w = Part(), rng.uniform(1.0, 1.5)
    _table(part, (0.0, 0.0), (w, 0.6), 0.74, rng)
    chair = plain(colour(rng, 0.8, 0.25), gloss=0.2)
    for x in (0.5 * w,) if w < 1.25 else (0.27 * w, 0.73 * w):
        _chair(part, x - 0.21, 0.5, True, chair)
    return Piece(part, w, 0.92, 0.9)


def _dining(rng: np.random.Generator) -> Piece:
    part, w = Part(), rng.uniform(1.1, 1.8)
    _table(part, (0.0, 0.3), (w, 1.1), 0.75, rng)
    chair = _timber(rng)
    for x in (0.22 * w, 0.78 * w):
        _chair(part, x - 0.21, 0.0, False, chair)
        _chair(part, x - 0.21, 0.98, True, chair)
    return Piece(part, w, 1.4, 0.9)


def _low_table(rng: np.random.Generator) -> Piece:
    piece = _rug(rng)
    _table(piece.part, (0.2, 0.18), (piece.width - 0.2, piece.depth - 0.18), 0.42, rng)
    return Piece(piece.part, piece.width, piece.depth, 0.6)


def _rug(rng: np.random.Generator) -> Piece:
    part, w, d = Part(), rng.uniform(1.0, 1.6), rng.uniform(0.8, 1.2)
    part.box((0, 0, 0), (w, d, 0.012), Material(artwork(int(rng.integers(1 << 30))), texel_m=0.01), "Z")
    return Piece(part, w, d, 0.012)


def _table(part: Part, low: tuple[float, float], high: tuple[float, float], h: float, rng: np.random.Generator) -> None:
    (x0, y0), (x1, y1) = low, high
    leg = plain(colour(rng, 0.3, 0.1), gloss=0.3)
    part.box((x0, y0, h - 0.04), (x1, y1, h), _timber(rng))
    for x in (x0 + 0.05, x1 - 0.11):
        for y in (y0 + 0.05, y1 - 0.11):
            part.box((x, y, 0), (x + 0.06, y + 0.06, h - 0.04), leg, "xXyY")
    for _ in range(int(rng.integers(1, 4))):
        at = np.array([*rng.uniform((x0 + 0.05, y0 + 0.05), (x1 - 0.35, y1 - 0.33)), h])
        thing = plain(colour(rng, 0.9, 0.4))
        part.box(at, at + rng.uniform((0.15, 0.15, 0.02), (0.3, 0.28, 0.2)), thing, "xXyYZ")


def _chair(part: Part, x: float, y: float, back_at_high_y: bool, material: Material) -> None:
    part.box((x, y, 0.43), (x + 0.42, y + 0.42, 0.47), material)
    for dx in (0.02, 0.36):
        for dy in (0.02, 0.36):
            part.box((x + dx, y + dy, 0), (x + dx + 0.04, y + dy + 0.04, 0.43), material, "xXyY")
    back = y + 0.38 if back_at_high_y else y
    part.box((x, back, 0.47), (x + 0.42, back + 0.04, 0.88), material)


def _bed(rng: np.random.Generator) -> Piece:
    part, w, d = Part(), rng.uniform(0.9, 1.6), 2.0
    wood, cover = _timber(rng), plain(colour(rng, 0.8, 0.35), amount=0.12)
    part.box((0, 0, 0), (w, 0.05, 0.95), wood)
    part.box((0, 0.05, 0.12), (w, d, 0.34), wood, "xXYz")
    part.box((0.02, 0.05, 0.34), (w - 0.02, d - 0.02, 0.52), cover, "xXYZ")
    for x in np.linspace(0.08, w - 0.62, 1 if w < 1.2 else 2):
        part.box((x, 0.1, 0.52), (x + 0.54, 0.46, 0.62), plain((0.6, 0.6, 0.58), amount=0.08), "xXyYZ")
    return Piece(part, w, d, 0.95)


def _seat(rng: np.random.Generator, size: Range) -> Piece:
    part, width, d = Part(), _drawn(rng, size), 0.85
    cloth = plain(colour(rng, 0.8, 0.25), amount=0.1)
    part.box((0, 0, 0.08), (width, 0.22, 0.82), cloth, "xXyYZ")
    part.box((0, 0.22, 0.08), (width, d, 0.42), cloth, "xXYZ")
    for x in (0.0, width - 0.17):
        part.box((x, 0.2, 0.08), (x + 0.17, d, 0.6), cloth, "xXYZ")
    return Piece(part, width, d, 0.82)


WANTED = {
    "office": ("desk", "desk", "shelf", "cabinet", "plant", "desk", "shelf", "bin", "desk", "cabinet"),
    "bedroom": ("bed", "wardrobe", "cabinet", "rack", "plant", "desk", "bed", "shelf"),
    "kitchen": ("counter", "fridge", "counter", "cabinet", "bin", "counter", "rack", "plant"),
    "class": ("board", "cabinet", "shelf", "bin", "board", "lockers", "cabinet", "shelf"),
    "living": ("sofa", "television", "shelf", "plant", "armchair", "cabinet", "shelf", "plant"),
    "store": ("rack", "rack", "boxes", "rack", "boxes", "lockers", "rack", "rack", "boxes", "bin"),
    "library": ("shelf", "shelf", "shelf", "shelf", "armchair", "shelf", "shelf", "plant", "shelf", "shelf"),
}
"""Furniture along the walls of each kind of room, in this order, as far as there is space."""

MIDDLE = dict(zip(WANTED, ("place", "rug", "dining", "place", "low table", "crates", "dining"), strict=True))
"""Furniture in the middle of each kind of room, once or in rows."""


def draw_furniture(rng: np.random.Generator) -> dict[str, Piece]:
    """The furniture of one building: a piece of each type, in its sizes and colours."""
    makers: dict[str, Callable[[np.random.Generator], Piece]] = {
        "desk": _desk,
        "shelf": _shelf,
        "cabinet": partial(_cupboard, size=((0.7, 1.3), 0.45, (0.7, 1.2)), fronts=(2, 3)),
        "plant": _plant,
        "bin": _waste_bin,
        "bed": _bed,
        "wardrobe": partial(_cupboard, size=((1.0, 1.6), 0.58, (1.9, 2.15)), fronts=(2, 1)),
        "rack": _rack,
        "counter": _counter,
        "fridge": partial(_cupboard, size=(0.62, 0.6, (1.5, 1.9)), fronts=(1, 2), saturation=0.1),
        "board": _board,
        "sofa": partial(_seat, size=(1.5, 2.1)),
        "armchair": partial(_seat, size=0.8),
        "television": _television,
        "boxes": _boxes,
        "lockers": partial(_cupboard, size=((0.9, 1.5), 0.45, 1.8), fronts=(4, 1), saturation=0.8),
        "place": _place,
        "dining": _dining,
        "low table": _low_table,
        "rug": _rug,
        "crates": _crates,
    }
    streams = rng.spawn(len(makers))
    return {name: make(stream) for (name, make), stream in zip(makers.items(), streams, strict=True)}
