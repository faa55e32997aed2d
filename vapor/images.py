"""Camera images -> the square uint8 images that the network sees, alike in training and in use."""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import UInt8

from filtering.errors import VaporTrackError


def resize_shortest_edge(image: UInt8[np.ndarray, "h w 3"], edge: int) -> UInt8[np.ndarray, "h2 w2 3"]:
    """The image scaled so that its shorter side has `edge` pixels, each the mean of the area it covers."""
    height, width = image.shape[:2]
    scale = edge / min(height, width)
    if scale == 1.0:
        return image
    size = max(edge, round(width * scale)), max(edge, round(height * scale))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR))


def centre_crop(image: UInt8[np.ndarray, "h w 3"], size: int) -> UInt8[np.ndarray, "size size 3"]:
    """The square of that many pixels in the middle of the image."""
    height, width = image.shape[:2]
    y, x = (height - size) // 2, (width - size) // 2
    return image[y : y + size, x : x + size]


def prepare(image: np.ndarray, shortest_edge: int, size: int) -> UInt8[np.ndarray, "size size 3"]:
    """What the network sees of an RGB image in use: shortest edge scaled, centre cropped.

    Raises:
        VaporTrackError: the image is not (H, W, 3) uint8.
    """
    if image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 3 or image.size == 0:
        raise VaporTrackError(f"image has shape {image.shape} and type {image.dtype}, expected (H, W, 3) uint8 RGB")
    return centre_crop(resize_shortest_edge(image, shortest_edge), size)
