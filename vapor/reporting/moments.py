"""Moments of a run: what was believed, little of it, at as many images as a page can show."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Float64

from filtering.estimate import Mode
from filtering.se3 import Poses

_MOST = 300
_PARTICLES = 60


@dataclass(frozen=True)
class Moment:
    """What was believed after one image.

    Attributes:
        index: Number of the image.
        particles: Positions of 60 particles, equally weighted, (60, 3), metres.
        modes: Positions of the hypotheses, best first, (k, 3), metres.
        weights: Their weights, (k,).
    """

    index: int
    particles: Float32[np.ndarray, "60 3"]
    modes: Float32[np.ndarray, "k 3"]
    weights: Float64[np.ndarray, " k"]


class MomentCollector:
    """Keeps every image's moment, or, of more than 300 images, those of every second, fourth, eighth, ..."""

    def __init__(self) -> None:
        self._moments: list[Moment] = []
        self._seen, self._every = 0, 1

    def add(self, modes: Sequence[Mode], cloud: Poses) -> None:
        """Take the next image.

        Args:
            modes: Hypotheses after it, best first.
            cloud: Poses that stand for the belief, at least 60.
        """
        if self._seen % self._every == 0:
            which = np.linspace(0, len(cloud) - 1, _PARTICLES).astype(int)
            places = np.stack([mode.world_from_camera.translation for mode in modes]).astype(np.float32)
            weights = np.array([mode.weight for mode in modes])
            particles = cloud.translation[which].astype(np.float32)
            self._moments.append(Moment(self._seen, particles, places, weights))
            if len(self._moments) > _MOST:
                self._every *= 2
                self._moments = self._moments[::2]
        self._seen += 1

    @property
    def moments(self) -> tuple[Moment, ...]:
        """Those that are kept, in order of time."""
        return tuple(self._moments)
