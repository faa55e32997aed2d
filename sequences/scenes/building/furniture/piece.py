"""A piece of furniture: its back is to the wall y = 0, and it begins at x = 0."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sequences.rendering import texture
from sequences.rendering.mesh import Part
from sequences.rendering.texture import Material, plain
from sequences.scenes.building.paint.colours import colour


@dataclass(frozen=True)
class Piece:
    """A piece of furniture.

    Attributes:
        part: What it is made of.
        width, depth, height: The box around it, metres, from x = y = z = 0.
    """

    part: Part
    width: float
    depth: float
    height: float


def timber(rng: np.random.Generator) -> Material:
    """Wood in some stain, or paint."""
    if rng.random() < 0.3:
        return plain(colour(rng, 0.6, 0.4), gloss=0.2)
    stain = float(rng.uniform(0.5, 2.2))
    return Material(lambda canvas: texture.wood(canvas) * np.float32(stain), gloss=0.2, texel_m=0.012)
