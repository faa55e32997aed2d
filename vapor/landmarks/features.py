"""Local features of an image: where they are, and what they look like.

Source: Lowe, "Distinctive image features from scale-invariant keypoints", 2004 (SIFT, by OpenCV); Arandjelović and
Zisserman, "Three things everyone should know to improve object retrieval", CVPR 2012 (roots of its histograms).
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float32, Float64, Int8, UInt8

SIFT_SIZE = 128
SIZE = 64
"""Numbers of a descriptor, principal components of a SIFT descriptor's roots."""
_UNIT = 127.0  # what 1 is in a stored descriptor
_CONTRAST = 0.01  # low: a wall has features too


@dataclass(frozen=True)
class Features:
    """n local features of an image.

    Attributes:
        pixels: Where they are, x and y from the centre of the first pixel, (n, 2).
        descriptors: What they look like, unit vectors, (n, d).
    """

    pixels: Float64[np.ndarray, "n 2"]
    descriptors: Float32[np.ndarray, "n d"]

    def __len__(self) -> int:
        return len(self.pixels)


def extract(view: UInt8[np.ndarray, "h w"], count: int, *, longest: int) -> Features:
    """The strongest features of a grey image, with all numbers of SIFT.

    Args:
        view: Grey.
        count: At most.
        longest: The image is shrunk to so many pixels along its longer edge where it is larger: time goes with size.
    """
    small = shrunk(view, longest)
    sift: cv2.SIFT = cv2.SIFT.create(nfeatures=count, contrastThreshold=_CONTRAST, enable_precise_upscale=True)
    found, described = sift.detectAndCompute(small, None)
    if not found:
        return Features(np.empty((0, 2)), np.empty((0, SIFT_SIZE), np.float32))
    at = np.array(cv2.KeyPoint.convert(found), np.float64)
    described = np.asarray(described, np.float32)
    roots = np.sqrt(described / np.maximum(described.sum(axis=1, keepdims=True), 1e-9))
    return Features(in_full_size(at, small, view), roots)


def shrunk(view: UInt8[np.ndarray, "h w"], longest: int) -> UInt8[np.ndarray, "h2 w2"]:
    """A grey image with at most so many pixels along its longer edge, shrunk by areas where it has more."""
    scale = min(1.0, longest / max(view.shape))
    height, width = (max(1, round(scale * edge)) for edge in view.shape)
    return view if scale == 1.0 else np.asarray(cv2.resize(view, (width, height), interpolation=cv2.INTER_AREA))


def in_full_size(
    pixels: Float64[np.ndarray, "n 2"], small: UInt8[np.ndarray, "h2 w2"], view: UInt8[np.ndarray, "h w"]
) -> Float64[np.ndarray, "n 2"]:
    """Where pixels of an image are in the one that it was resized from."""
    zoom = np.array([view.shape[1] / small.shape[1], view.shape[0] / small.shape[0]])
    return (pixels + 0.5) * zoom - 0.5


@dataclass(frozen=True)
class Basis:
    """The principal components of a place's descriptors: half the numbers tell as much.

    Attributes:
        mean: Of the roots of SIFT descriptors, (128,).
        axes: Principal axes, (128, 64).
    """

    mean: Float32[np.ndarray, " s"]
    axes: Float32[np.ndarray, "s d"]

    @staticmethod
    def of(descriptors: Float32[np.ndarray, "n s"]) -> Basis:
        """The components of n descriptors, n ≥ 1."""
        mean = descriptors.mean(axis=0)
        centred = (descriptors - mean).astype(np.float64)
        _, axes = np.linalg.eigh(centred.T @ centred)
        return Basis(mean, np.ascontiguousarray(axes[:, ::-1][:, :SIZE]).astype(np.float32))

    def reduced(self, features: Features) -> Features:
        """The same features, described by their components."""
        return Features(features.pixels, unit_vectors((features.descriptors - self.mean) @ self.axes))


def unit_vectors(vectors: Float32[np.ndarray, "n d"]) -> Float32[np.ndarray, "n d"]:
    """Vectors of length 1; zeros stay zeros."""
    return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-9)


def stored(descriptors: Float32[np.ndarray, "n d"]) -> Int8[np.ndarray, "n d"]:
    """Unit vectors in a byte a number."""
    return np.rint(_UNIT * descriptors).astype(np.int8)


def restored(descriptors: Int8[np.ndarray, "n d"]) -> Float32[np.ndarray, "n d"]:
    """What `stored` has stored."""
    return descriptors.astype(np.float32) * np.float32(1.0 / _UNIT)
