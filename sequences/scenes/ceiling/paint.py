"""What the hall is painted with: panels, lamps, walls, and what is unique."""

from __future__ import annotations

import numpy as np

from sequences.rendering import texture
from sequences.rendering.texture import Canvas, Material, band, blend, inside, weathered
from sequences.scenes.ceiling.dimensions import PANEL


def _grid(canvas: Canvas, base: np.ndarray) -> np.ndarray:
    """The painted steel grid that holds the panels: a bright flange with a shadow line beside it."""
    x, y = canvas.x % PANEL, canvas.y % PANEL
    edge = np.minimum(np.minimum(x, PANEL - x), np.minimum(y, PANEL - y))
    base = base * (1 - 0.6 * np.exp(-np.clip(edge - 0.016, 0, None) / 0.009) * (edge > 0.016))[..., None]
    return blend(base, (0.86, 0.86, 0.84), edge < 0.016)


def _tile(canvas: Canvas) -> np.ndarray:
    """Mineral fibre: rows of pin holes, worm-like fissures."""
    base = canvas.colour((0.70, 0.69, 0.655)) * (1 + 0.02 * canvas.noise(0.2) + 0.02 * canvas.noise(0.01))[..., None]
    fissures = np.clip(canvas.noise(0.035, 0.012) - 1.5, 0, 0.5) + np.clip(canvas.noise(0.012) - 2.2, 0, 0.5)
    base = blend(base, (0.26, 0.25, 0.23), fissures)
    holes = np.hypot(canvas.x % 0.05 - 0.025, canvas.y % 0.05 - 0.025) < 0.006
    base = blend(base, (0.12, 0.115, 0.11), 0.85 * holes)
    return _grid(canvas, base)


def _speaker(canvas: Canvas) -> np.ndarray:
    """A panel with a round loudspeaker grille."""
    base = _tile(canvas)
    radius = np.hypot(canvas.x - 0.3, canvas.y - 0.3)
    ring = np.clip(np.sin(radius * 2 * np.pi / 0.02), 0, 1)
    base = blend(base, (0.42, 0.42, 0.41), 1 - texture.step(radius, 0.165))
    base = blend(base, (0.05, 0.05, 0.05), ring * (radius < 0.145))
    return blend(base, (0.75, 0.75, 0.72), band(radius, 0.15, 0.165))


def diffuser(canvas: Canvas) -> np.ndarray:
    """The glowing underside of a lamp, behind cross blades."""
    glow = np.exp(-(((canvas.y - canvas.height_m / 2) / 0.09) ** 2))
    base = canvas.colour((1.0, 0.97, 0.90)) * (0.4 + 0.6 * glow + 0 * canvas.x)[..., None]
    blades = 1 - band(canvas.x % 0.1, 0.008, 0.092)
    base = blend(base, (0.20, 0.20, 0.195), blades + 0 * canvas.y)
    return blend(base, (0.5, 0.5, 0.49), 1 - band(canvas.y, 0.02, canvas.height_m - 0.02) + 0 * canvas.x)


def floor(canvas: Canvas) -> np.ndarray:
    """A worn grey floor."""
    return weathered(canvas, canvas.colour((0.46, 0.43, 0.38)), 0.1)


def outlet_art(canvas: Canvas) -> np.ndarray:
    """A square air outlet of nested frames, dark gaps between."""
    reach = np.maximum(np.abs(canvas.x - 0.3), np.abs(canvas.y - 0.3))
    gaps = (reach % 0.055) < 0.026
    base = canvas.colour((0.62, 0.62, 0.60)) * (1 + 0.03 * canvas.noise(0.1))[..., None]
    base = blend(base, (0.015, 0.015, 0.015), gaps * (reach < 0.27))
    soot = np.exp(-np.abs(reach - 0.28) / 0.03) * 0.4
    return blend(base, (0.10, 0.09, 0.08), soot)


def stain(canvas: Canvas) -> np.ndarray:
    """An old water stain with brown rims."""
    base = _tile(canvas)
    radius = np.hypot(canvas.x - 0.3, canvas.y - 0.3) + 0.03 * canvas.noise(0.12) + 0.008 * canvas.noise(0.03)
    base = blend(base, (0.42, 0.27, 0.11), 0.75 * (1 - texture.step(radius, 0.22, 0.05)))
    base = blend(base, (0.22, 0.10, 0.03), 0.9 * np.exp(-(((radius - 0.215) / 0.014) ** 2)))
    return blend(base, (0.25, 0.13, 0.05), 0.7 * np.exp(-(((radius - 0.12) / 0.012) ** 2)))


def sign_art(canvas: Canvas) -> np.ndarray:
    """A green exit sign: door, arrow."""
    base = canvas.colour((0.01, 0.42, 0.12))
    base = blend(base, (0.9, 1.0, 0.92), inside(canvas, 0.36, 0.05, 0.50, 0.25))
    shaft = inside(canvas, 0.14, 0.13, 0.30, 0.17)
    head = band(canvas.x, 0.06, 0.15) * (np.abs(canvas.y - 0.15) < (canvas.x - 0.06) * 0.9)
    return blend(base, (0.9, 1.0, 0.92), np.maximum(shaft, head))


def panelled(canvas: Canvas) -> np.ndarray:
    """Upright boards of wood."""
    base = texture.wood(canvas) * 1.2
    return blend(base, (0.03, 0.02, 0.01), 1 - band(canvas.x % 0.45, 0.01, 0.44) + 0 * canvas.y)


def masonry(canvas: Canvas) -> np.ndarray:
    """Blocks of sandstone in running bond."""
    row = np.floor(canvas.y / 0.2)
    x = (canvas.x + 0.2 * (row % 2)) % 0.4
    base = weathered(canvas, canvas.colour((0.45, 0.30, 0.20)), 0.12)
    return blend(base, (0.55, 0.53, 0.5), 1 - band(x, 0.008, 0.392) * band(canvas.y % 0.2, 0.008, 0.192))


TILE = Material(_tile, texel_m=0.005)
SPEAKER = Material(_speaker, texel_m=0.005)
