"""How the doors of a building are painted."""

from __future__ import annotations

import numpy as np

from sequences.rendering import pictures
from sequences.rendering.texture import Canvas, Material, blend, inside, weathered
from sequences.scenes.building.paint.colours import Rgb, colour, grey


def draw_door(rng: np.random.Generator) -> Material:
    """How a door's leaf is painted: wood, or one colour."""
    if rng.random() < 0.45:
        stain = rng.uniform(0.5, 2.2, 3) * rng.uniform(0.7, 1.3)
        return Material(lambda canvas: pictures.door(canvas) * stain.astype(np.float32), gloss=0.3, texel_m=0.01)
    rgb = colour(rng, 0.7, 0.3) if rng.random() < 0.6 else grey(rng)
    return painted_door(rgb)


def painted_door(rgb: Rgb) -> Material:
    """A smooth leaf in one colour with a kick plate and a slim pane."""

    def paint(canvas: Canvas) -> np.ndarray:
        base = weathered(canvas, canvas.colour(rgb), 0.03)
        base = blend(base, (0.4, 0.4, 0.39), inside(canvas, 0.03, 0.02, canvas.width_m - 0.03, 0.22))
        return blend(base, (0.05, 0.06, 0.07), inside(canvas, 0.62, 1.0, 0.76, 1.8))

    return Material(paint, gloss=0.25, texel_m=0.01)
