"""What shows on the furniture of a building: books, fronts of drawers, screens, leaves."""

from __future__ import annotations

import numpy as np

from sequences.rendering import texture
from sequences.rendering.texture import Canvas, Material, band, blend, inside, weathered
from sequences.scenes.building.paint.colours import FINE_TEXEL_M, Rgb, colour, scaled


def books(rng: np.random.Generator) -> Material:
    """Shelves full of books, or of boxes."""
    shelf, seed = float(rng.uniform(0.3, 0.42)), int(rng.integers(1 << 30))
    spine, stain = float(rng.uniform(0.03, 0.2)), float(rng.uniform(0.5, 2.0))

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


def fronts(rgb: Rgb, columns: int, rows: int) -> Material:
    """Drawers or doors of a cupboard with handles."""

    def paint(canvas: Canvas) -> np.ndarray:
        w, h = canvas.width_m / columns, canvas.height_m / rows
        x, y = canvas.x % w, canvas.y % h
        base = weathered(canvas, canvas.colour(rgb), 0.03)
        base = blend(base, scaled(rgb, 0.2), 1 - band(x, 0.008, w - 0.008) * band(y, 0.008, h - 0.008))
        return blend(base, (0.1, 0.1, 0.1), band(x, w / 2 - 0.06, w / 2 + 0.06) * band(y, h - 0.07, h - 0.05))

    return Material(paint, gloss=0.2, texel_m=FINE_TEXEL_M)


def screen(canvas: Canvas) -> np.ndarray:
    """A dark screen in a black frame."""
    base = canvas.colour((0.02, 0.02, 0.022))
    return blend(base, (0.04, 0.06, 0.09), inside(canvas, 0.02, 0.02, canvas.width_m - 0.02, canvas.height_m - 0.02))


def whiteboard(canvas: Canvas) -> np.ndarray:
    """A white board with some writing."""
    base = canvas.colour((0.75, 0.76, 0.76))
    lines = (np.sin(canvas.y * 2 * np.pi / 0.13) > 0.75) & (canvas.noise(0.15, 0.05) > 0.1)
    written = inside(canvas, 0.15, 0.3, 0.7 * canvas.width_m, canvas.height_m - 0.12) * lines
    base = blend(base, (0.05, 0.07, 0.3), 0.8 * written)
    rim = 1 - inside(canvas, 0.03, 0.03, canvas.width_m - 0.03, canvas.height_m - 0.03)
    return blend(base, (0.25, 0.25, 0.25), rim)


def leaves(canvas: Canvas) -> np.ndarray:
    """Foliage: light and dark green."""
    tone = np.clip(1 + 0.5 * canvas.noise(0.05) + 0.4 * canvas.noise(0.02), 0.15, 2.2)
    return canvas.colour((0.06, 0.15, 0.04)) * tone[..., None]
