"""Camera images -> the uint8 images that the network sees, the same way in training and in use."""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import UInt8

from filtering.errors import VaporTrackError
from vapor.regressors.network_config import NetworkConfig


def cover_size(columns: int, rows: int, width: int, height: int) -> tuple[int, int]:
    """Width and height of an image, given its columns and rows, after scaling it to just cover a frame."""
    scale = max(width / columns, height / rows)
    return max(width, round(columns * scale)), max(height, round(rows * scale))


def scale_to_cover(image: UInt8[np.ndarray, "h w *c"], width: int, height: int) -> UInt8[np.ndarray, "h2 w2 *c"]:
    """The image scaled to just cover a frame of this width and height, by averaging over areas."""
    rows, columns = image.shape[:2]
    scale = max(width / columns, height / rows)
    if scale == 1.0:
        return image
    size = cover_size(columns, rows, width, height)
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR))


def centre_crop(image: UInt8[np.ndarray, "h w *c"], width: int, height: int) -> UInt8[np.ndarray, "height width *c"]:
    """The middle of the image, of this width and height."""
    y, x = (image.shape[0] - height) // 2, (image.shape[1] - width) // 2
    return image[y : y + height, x : x + width]


def prepare(image: np.ndarray, config: NetworkConfig) -> UInt8[np.ndarray, "image_height image_width 3"]:
    """The network's input of an RGB image in use: the middle of the image, scaled to the frame of training crops.

    Raises:
        VaporTrackError: the image is not (H, W, 3) uint8.
    """
    require_rgb(image)
    return centre_crop(scale_to_cover(image, *config.frame_size), config.image_width, config.image_height)


def require_rgb(image: np.ndarray) -> None:
    """Raise VaporTrackError where an image is not (H, W, 3) uint8."""
    if image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 3 or image.size == 0:
        raise VaporTrackError(f"image has shape {image.shape} and type {image.dtype}, expected (H, W, 3) uint8 RGB")
