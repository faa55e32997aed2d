"""What is painted in more than one scene: a door, a radiator, the sky behind a window."""

from __future__ import annotations

import numpy as np

from sequences.rendering import texture
from sequences.rendering.texture import Canvas, blend, inside


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
    base = texture.wood(canvas)
    for low, high in ((0.14, 0.86), (1.02, 1.88)):
        outer = inside(canvas, 0.13, low, canvas.width_m - 0.13, high)
        inner = inside(canvas, 0.155, low + 0.025, canvas.width_m - 0.155, high - 0.025)
        base = blend(base, (0.07, 0.035, 0.015), 0.65 * (outer - inner))
    return blend(base, (0.10, 0.06, 0.03), 0.5 * np.exp(-np.broadcast_to(canvas.y, canvas.shape) / 0.08))


def radiator(canvas: Canvas) -> np.ndarray:
    """Cream ribs and the dark between them."""
    ribs = 0.5 + 0.5 * np.cos(canvas.x * 2 * np.pi / 0.05) + 0 * canvas.y
    return blend(canvas.colour((0.62, 0.60, 0.55)), (0.14, 0.135, 0.12), np.clip(ribs - 0.25, 0, 1) ** 2)
