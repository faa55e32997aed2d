"""How single images look, in a few numbers each: sharp or blurred, dark or blown out, the same as the one before."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float64, UInt8

SIDE_PX = 240
"""Images are measured at this size of their shorter side."""

_MUCH_BLURRIER, _DULLER = 0.3, 0.7  # than the recording's median: variance, and variance over that of coarse detail
_DARK, _BRIGHT = 25, 250  # of 255
_NEARLY_ALL, _MUCH = 0.9, 0.4  # of the pixels
_JUMP = 0.5  # of log2 of the mean brightness


class Look(NamedTuple):
    """What is kept of one image.

    Attributes:
        sharpness: Variance of the Laplacian of the grey image, scaled to a shorter side of 240 pixels.
        coarse: The same of the image at a quarter of that size, where blur takes less of it.
        brightness: Mean of the grey image, 0 to 255.
        dark: Fraction of its pixels below 25.
        bright: Fraction of its pixels of 250 and more.
        digest: A checksum of all its bytes.
        width: Of the whole image, pixels.
        height: Likewise.
    """

    sharpness: float
    coarse: float
    brightness: float
    dark: float
    bright: float
    digest: int
    width: int
    height: int


def look_at(image: UInt8[np.ndarray, "h w 3"]) -> Look:
    """The numbers of one RGB image."""
    scale = SIDE_PX / min(image.shape[:2])
    size = max(1, round(image.shape[1] * scale)), max(1, round(image.shape[0] * scale))
    method = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    grey = cv2.cvtColor(np.asarray(cv2.resize(image, size, interpolation=method)), cv2.COLOR_RGB2GRAY)
    coarse = cv2.resize(grey, (max(size[0] // 4, 1), max(size[1] // 4, 1)), interpolation=cv2.INTER_AREA)
    return Look(
        float(cv2.Laplacian(grey, cv2.CV_32F).var()),
        float(cv2.Laplacian(coarse, cv2.CV_32F).var()),
        float(grey.mean()),
        float((grey < _DARK).mean()),
        float((grey >= _BRIGHT).mean()),
        zlib.crc32(np.ascontiguousarray(image).data),
        image.shape[1],
        image.shape[0],
    )


@dataclass(frozen=True)
class Looks:
    """Images of one recording, n of them, in order.

    Attributes:
        sharpness: Variance of the Laplacian, (n,).
        brightness: Mean of the grey image, 0 to 255, (n,).
        blurred: Much blurrier than the recording's median, and not only as there is less to see, (n,).
        dark: Nearly black, (n,).
        blown: With a large part blown out, (n,).
        jumps: Half a stop brighter or darker than the image before, (n,).
        repeated: The same to the last bit as the image before, (n,).
    """

    sharpness: Float64[np.ndarray, " n"]
    brightness: Float64[np.ndarray, " n"]
    blurred: Bool[np.ndarray, " n"]
    dark: Bool[np.ndarray, " n"]
    blown: Bool[np.ndarray, " n"]
    jumps: Bool[np.ndarray, " n"]
    repeated: Bool[np.ndarray, " n"]

    @staticmethod
    def of(looks: Sequence[Look]) -> Looks:
        """What the numbers of a recording's images, at least one, say beside each other."""
        sharpness, coarse, brightness, dark, bright = (
            np.array([look[i] for look in looks], np.float64) for i in range(5)
        )
        fine = sharpness / np.maximum(coarse, 1e-6)
        blurred = sharpness < _MUCH_BLURRIER * np.median(sharpness)
        blurred &= (fine < _DULLER * np.median(fine)) & (dark < _NEARLY_ALL)
        stops = np.log2(brightness + 1.0)
        digests = np.array([look.digest for look in looks], np.int64)
        return Looks(
            sharpness,
            brightness,
            blurred,
            dark >= _NEARLY_ALL,
            bright >= _MUCH,
            np.abs(np.diff(stops, prepend=stops[:1])) > _JUMP,
            np.diff(digests, prepend=digests[:1] - 1) == 0,
        )
