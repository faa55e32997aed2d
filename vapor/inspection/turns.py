"""How far the view turned from one image to the next, by how it shifts."""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import Float32, Float64, UInt8

_WIDTH_PX = 80
_VIEW_RAD = 1.0  # its width: the course of the turns is what counts, not how large they are


def outline(image: UInt8[np.ndarray, "h w 3"]) -> Float32[np.ndarray, "a b"]:
    """What is kept of an RGB image until the next one: grey, 80 pixels wide."""
    size = _WIDTH_PX, max(2, round(image.shape[0] * _WIDTH_PX / image.shape[1]))
    small = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA))
    return np.asarray(cv2.cvtColor(small, cv2.COLOR_RGB2GRAY), np.float32)


def turn_between(before: Float32[np.ndarray, "a b"], after: Float32[np.ndarray, "c d"]) -> Float64[np.ndarray, " 3"]:
    """Rotation vector of the camera in its own axes, about the vertical and the horizontal one only, some radians.

    By phase correlation (Kuglin and Hines 1975). A view that shifts as the camera moves sideways seems to turn, too; a
    turn about the view's own axis is not seen. Zero where the images have no size in common.
    """
    if before.shape != after.shape:
        return np.zeros(3)
    window = cv2.createHanningWindow(before.shape[::-1], cv2.CV_32F)
    shift, _ = cv2.phaseCorrelate(before, after, window)
    right, down = np.nan_to_num(np.array(shift)) * _VIEW_RAD / _WIDTH_PX
    return np.array([down, -right, 0.0])
