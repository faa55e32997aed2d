"""Paint: the reflectance of surfaces, and of a door, a radiator and a sky that several scenes have."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float32, Float64


@dataclass(frozen=True)
class Canvas:
    """One surface to paint, as a grid of texels.

    x and y are distances in metres from the surface's origin along its two edges, at the texel centres. The origin and
    the unit edges are in the frame of the part. The generator draws stains and grain.
    """

    x: Float32[np.ndarray, "1 w"]
    y: Float32[np.ndarray, "h 1"]
    width_m: float
    height_m: float
    origin: Float64[np.ndarray, "3"]
    along_u: Float64[np.ndarray, "3"]
    along_v: Float64[np.ndarray, "3"]
    rng: np.random.Generator

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of texels."""
        return self.y.shape[0], self.x.shape[1]

    def point(self, axis: int) -> np.ndarray:
        """One coordinate (h, w) of every texel, metres, in the frame of the part."""
        return self.origin[axis] + self.x * self.along_u[axis] + self.y * self.along_v[axis]

    def noise(self, feature_x_m: float, feature_y_m: float | None = None) -> np.ndarray:
        """Smooth noise (h, w) of about unit deviation, whose features have the given size."""
        feature_y_m = feature_x_m if feature_y_m is None else feature_y_m
        rows, columns = self.shape
        coarse_w = min(max(int(self.width_m / feature_x_m) + 3, 4), columns + 3)
        coarse_h = min(max(int(self.height_m / feature_y_m) + 3, 4), rows + 3)
        coarse = self.rng.standard_normal((coarse_h, coarse_w)).astype(np.float32)
        return cv2.resize(coarse, (columns, rows), interpolation=cv2.INTER_CUBIC) * 1.4

    def colour(self, rgb: tuple[float, float, float]) -> np.ndarray:
        """The canvas (h, w, 3) in one colour, linear reflectance."""
        return np.full((*self.shape, 3), rgb, np.float32)


@dataclass(frozen=True)
class Material:
    """Paint and optical properties of a surface.

    Paint is linear reflectance (h, w, 3); times `emission`, the light of lamps, skies and signs. A camera that looks at
    these sees the fraction `glare` of it: louvres and panes shield it, and small cameras cannot take all. Gloss is the
    fraction of the Fresnel reflection that is mirror-like.
    """

    paint: Callable[[Canvas], np.ndarray]
    emission: float = 0.0
    glare: float = 1.0
    gloss: float = 0.0
    texel_m: float = 0.008


def blend(base: np.ndarray, rgb: tuple[float, float, float] | np.ndarray, amount: np.ndarray | float) -> np.ndarray:
    """Paint over a canvas: amount (h, w) of 0 keeps it, 1 covers it."""
    amount = np.clip(np.asarray(amount, np.float32), 0.0, 1.0)[..., None]
    return base + (np.asarray(rgb, np.float32) - base) * amount


def step(value: np.ndarray | float, edge: float, softness: float = 0.004) -> np.ndarray:
    """0 below the edge and 1 above it, over a width of `softness`."""
    return np.clip((np.asarray(value, np.float32) - edge) / softness + 0.5, 0.0, 1.0)


def band(value: np.ndarray, low: float, high: float, softness: float = 0.004) -> np.ndarray:
    """1 between low and high, 0 outside."""
    return step(value, low, softness) * (1 - step(value, high, softness))


def inside(canvas: Canvas, x0: float, y0: float, x1: float, y1: float) -> np.ndarray:
    """1 inside a rectangle of the canvas, metres, 0 outside."""
    return band(canvas.x, x0, x1) * band(canvas.y, y0, y1)


def rim(canvas: Canvas, width_m: float) -> np.ndarray:
    """1 along the edges of the canvas, 0 further inside."""
    return 1 - inside(canvas, width_m, width_m, canvas.width_m - width_m, canvas.height_m - width_m)


def weathered(canvas: Canvas, base: np.ndarray, amount: float = 0.05) -> np.ndarray:
    """Uneven paint: broad blotches, fine grain."""
    shade = canvas.noise(0.5) * 0.6 + canvas.noise(0.12) * 0.45 + canvas.noise(0.02) * 0.4
    return base * np.clip(1 + amount * shade, 0.3, 1.6)[..., None]


def plain(rgb: tuple[float, float, float], *, gloss: float = 0.0, amount: float = 0.04) -> Material:
    """A painted surface of one colour."""
    return Material(lambda canvas: weathered(canvas, canvas.colour(rgb), amount), gloss=gloss)


def plaster(canvas: Canvas) -> np.ndarray:
    """Old white wall paint with blotches, runs and scuffs."""
    base = weathered(canvas, canvas.colour((0.66, 0.63, 0.57)), 0.045)
    runs = np.clip(canvas.noise(0.05, 0.7) - 1.5, 0, 1) * 0.3
    return blend(base, (0.40, 0.36, 0.29), runs)


def terrazzo(canvas: Canvas) -> np.ndarray:
    """Ground stone chips in grey cement."""
    base = weathered(canvas, canvas.colour((0.36, 0.345, 0.32)), 0.07)
    chips = canvas.rng.random(canvas.shape, np.float32)
    base = blend(base, (0.74, 0.71, 0.66), (chips > 0.86) * 0.75)
    base = blend(base, (0.10, 0.085, 0.08), (chips < 0.12) * 0.7)
    base = blend(base, (0.42, 0.22, 0.15), ((chips > 0.5) & (chips < 0.55)) * 0.7)
    wear = np.clip(canvas.noise(0.35) + 0.3, 0, 2) * 0.14
    return blend(base, (0.20, 0.19, 0.17), wear)


def tread(canvas: Canvas) -> np.ndarray:
    """A terrazzo tread with a ribbed rubber strip along its nosing (y = 0)."""
    base = terrazzo(canvas)
    worn = np.exp(-(((canvas.x - 0.6) / 0.33) ** 2)) * band(canvas.y, 0.05, 0.2, 0.06)
    base = blend(base, (0.44, 0.42, 0.38), 0.3 * worn)
    strip = band(canvas.y, 0.012, 0.062)
    ribs = 0.035 + 0.03 * (np.sin(canvas.y * 2 * np.pi / 0.0125) > 0)
    base = blend(base, np.repeat(np.broadcast_to(ribs, canvas.shape)[..., None], 3, axis=2), strip)
    dirt = np.exp(-(canvas.height_m - canvas.y) / 0.02) + np.exp(-canvas.x / 0.02)
    return blend(base, (0.13, 0.115, 0.10), 0.45 * dirt)


def wood(canvas: Canvas) -> np.ndarray:
    """Oak veneer, grain along y."""
    grain = canvas.noise(0.012, 0.6) * 0.5 + canvas.noise(0.05, 1.5) + canvas.noise(0.009, 0.25) * 0.4
    return canvas.colour((0.33, 0.185, 0.085)) * np.clip(1 + 0.17 * grain, 0.4, 1.7)[..., None]


def steel(canvas: Canvas) -> np.ndarray:
    """Dark grey painted steel."""
    return weathered(canvas, canvas.colour((0.085, 0.09, 0.10)), 0.10)


def brushed(canvas: Canvas) -> np.ndarray:
    """Bright brushed metal."""
    return canvas.colour((0.48, 0.47, 0.45)) * (1 + 0.12 * canvas.noise(0.3, 0.008))[..., None]


def lit(rgb: tuple[float, float, float], emission: float) -> Material:
    """A lamp's diffuser."""

    def paint(canvas: Canvas) -> np.ndarray:
        edge = np.minimum(
            np.minimum(canvas.x, canvas.width_m - canvas.x), np.minimum(canvas.y, canvas.height_m - canvas.y)
        )
        return canvas.colour(rgb) * (0.75 + 0.25 * np.clip(edge / 0.06, 0, 1))[..., None]

    return Material(paint, emission=emission)


def sky(canvas: Canvas) -> np.ndarray:
    """Bright haze above the blurred roofs and trees of a courtyard."""
    height = canvas.y / canvas.height_m
    base = canvas.colour((0.72, 0.85, 1.0)) * (0.75 + 0.35 * height)[..., None]
    ridge = 0.36 + 0.06 * canvas.noise(0.25, 3.0) + 0.012 * canvas.noise(0.03, 3.0)
    trees = np.clip((ridge - height) / 0.03, 0, 1)
    leaves = np.array([0.16, 0.21, 0.12]) * np.clip(1 + 0.35 * canvas.noise(0.04), 0.2, 2)[..., None]
    base = blend(base, leaves.astype(np.float32), trees)
    house = inside(canvas, 0.62, -1.0, 1.4, 0.34)
    return blend(base, (0.38, 0.31, 0.26), house)


def door(canvas: Canvas) -> np.ndarray:
    """A veneered leaf with two sunk panels."""
    base = wood(canvas)
    for low, high in ((0.14, 0.86), (1.02, 1.88)):
        outer = inside(canvas, 0.13, low, canvas.width_m - 0.13, high)
        inner = inside(canvas, 0.155, low + 0.025, canvas.width_m - 0.155, high - 0.025)
        base = blend(base, (0.07, 0.035, 0.015), 0.65 * (outer - inner))
    return blend(base, (0.10, 0.06, 0.03), 0.5 * np.exp(-np.broadcast_to(canvas.y, canvas.shape) / 0.08))


def radiator(canvas: Canvas) -> np.ndarray:
    """Cream ribs and the dark between them."""
    ribs = 0.5 + 0.5 * np.cos(canvas.x * 2 * np.pi / 0.05) + 0 * canvas.y
    return blend(canvas.colour((0.62, 0.60, 0.55)), (0.14, 0.135, 0.12), np.clip(ribs - 0.25, 0, 1) ** 2)
