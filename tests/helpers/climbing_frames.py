"""Frames of a climb, with images of noise."""

import numpy as np

from sequences.frame import Frame
from tests.helpers.simulation import climb


def frames_of(count: int, *, odometry: bool = True, seed: int = 0, step_ns: int = 10**8) -> list[Frame]:
    rng = np.random.default_rng(seed)
    truth, increments = climb(count, rng=rng)
    images = rng.integers(0, 256, (count, 36, 36, 3), dtype=np.uint8)
    return [Frame(i * step_ns, images[i], increments[i] if odometry else None, truth[i]) for i in range(count)]
