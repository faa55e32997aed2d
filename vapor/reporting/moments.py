"""Moments of a run: what was believed, little of it, at as many images as a page can show."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Float64, UInt8

from vapor.reporting.keyframes import Keyframe, shrunk

_MOST = 300
_PARTICLES = 60
_IMAGE_SIDE = 200  # pixels
_JPEG_QUALITY = 70


@dataclass(frozen=True)
class Moment:
    """What was believed after one image.

    Attributes:
        index: Number of the image.
        particles: Positions of 60 particles, equally weighted, (60, 3), metres.
        modes: Positions of the hypotheses, best first, (k, 3), metres.
        weights: Their weights, (k,).
        jpeg: The image, its longer side at most 200 pixels, as a JPEG file; empty where there is none.
    """

    index: int
    particles: Float32[np.ndarray, "60 3"]
    modes: Float32[np.ndarray, "k 3"]
    weights: Float64[np.ndarray, " k"]
    jpeg: bytes


class MomentCollector:
    """Keeps every image's moment, or, of more than 300 images, those of every second, fourth, eighth, ..."""

    def __init__(self) -> None:
        self._moments: list[Moment] = []
        self._seen, self._every = 0, 1

    def add(self, keyframe: Keyframe) -> None:
        """Take the next image."""
        if self._seen % self._every == 0:
            which = np.linspace(0, len(keyframe.cloud) - 1, _PARTICLES).astype(int)
            places = np.stack([mode.world_from_camera.translation for mode in keyframe.modes]).astype(np.float32)
            weights = np.array([mode.weight for mode in keyframe.modes])
            particles = keyframe.cloud.translation[which].astype(np.float32)
            self._moments.append(Moment(self._seen, particles, places, weights, _small_jpeg(keyframe.thumbnail)))
            if len(self._moments) > _MOST:
                self._every *= 2
                self._moments = self._moments[::2]
        self._seen += 1

    @property
    def moments(self) -> tuple[Moment, ...]:
        """Those that are kept, in order of time."""
        return tuple(self._moments)


def _small_jpeg(image: UInt8[np.ndarray, "height width 3"]) -> bytes:
    if image.size == 0:
        return b""
    import cv2

    small = cv2.cvtColor(shrunk(image, _IMAGE_SIDE), cv2.COLOR_RGB2BGR)
    return cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])[1].tobytes()
