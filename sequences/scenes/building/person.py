"""Someone who stands about in a building."""

from __future__ import annotations

import numpy as np

from sequences.rendering.mesh import Part
from sequences.rendering.texture import plain
from sequences.scenes.building.paint.colours import colour

PERSON_RADIUS = 0.27  # of a circle around a person, metres


def person(rng: np.random.Generator) -> Part:
    """Someone who stands at the origin and looks along y: dressed, with arms, head and hair."""
    part, k = Part(), float(rng.uniform(0.9, 1.08))
    trousers, shirt = plain(colour(rng, 0.5, 0.12)), plain(colour(rng, 0.9, 0.35), amount=0.1)
    skin_tone = float(rng.uniform(0.25, 1.0))
    skin = plain((0.5 * skin_tone, 0.32 * skin_tone, 0.24 * skin_tone))
    hair = plain(colour(rng, 0.5, 0.07))
    for x in (-0.09, 0.09):
        part.box((x - 0.06, -0.1, 0), (x + 0.06, 0.16, 0.08 * k), plain((0.04, 0.04, 0.04)), "xXyYZ")
        part.beam((x, 0, 0.05), (x, 0, 0.86 * k), 0.085, trousers, 8)
    part.beam((0, 0, 0.82 * k), (0, 0, 1.12 * k), 0.165, shirt, 10)
    part.beam((0, 0, 1.1 * k), (0, 0, 1.42 * k), 0.185, shirt, 10)
    part.box((-0.13, -0.12, 1.41 * k), (0.13, 0.12, 1.43 * k), shirt, "Z")
    for x in (-0.2, 0.2):
        part.beam((x, 0.0, 1.4 * k), (1.1 * x, 0.03, 1.1 * k), 0.05, shirt, 6)
        part.beam((1.1 * x, 0.03, 1.1 * k), (x, 0.09, 0.84 * k), 0.04, skin, 6)
    part.beam((0, 0, 1.42 * k), (0, 0, 1.52 * k), 0.055, skin, 6)
    part.beam((0, 0.01, 1.5 * k), (0, 0.01, 1.7 * k), 0.1, skin, 10)
    part.beam((0, -0.02, 1.58 * k), (0, -0.02, 1.77 * k), 0.108, hair, 10)
    part.box((-0.08, -0.1, 1.765 * k), (0.08, 0.06, 1.77 * k), hair, "Z")
    return part
