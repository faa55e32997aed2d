"""Local features of an image, and their matches.

Source: Lowe, "Distinctive image features from scale-invariant keypoints", 2004 (SIFT, by OpenCV); Arandjelović and
Zisserman, "Three things everyone should know to improve object retrieval", CVPR 2012 (roots of its histograms).
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float32, Float64, Int8, Int64, UInt8

SIFT_SIZE = 128
SIZE = 64
"""Numbers of a descriptor, principal components of a SIFT descriptor's roots."""
_UNIT = 127.0  # what 1 is in a stored descriptor
_CONTRAST = 0.01  # low: a wall has features too


@dataclass(frozen=True)
class Features:
    """Pixels of n local features, from the centre of the first pixel, and their descriptors, unit vectors."""

    pixels: Float64[np.ndarray, "n 2"]
    descriptors: Float32[np.ndarray, "n d"]

    def __len__(self) -> int:
        return len(self.pixels)


def extract(view: UInt8[np.ndarray, "h w"], count: int, *, longest: int) -> Features:
    """The strongest features of a grey image, with SIFT's 128 numbers, found at most `longest` pixels wide or high."""
    scale = min(1.0, longest / max(view.shape))
    height, width = (max(1, round(scale * edge)) for edge in view.shape)
    small = view if scale == 1.0 else cv2.resize(view, (width, height), interpolation=cv2.INTER_AREA)
    sift: cv2.SIFT = cv2.SIFT.create(nfeatures=count, contrastThreshold=_CONTRAST, enable_precise_upscale=True)
    found, described = sift.detectAndCompute(small, None)
    if not found:
        return Features(np.empty((0, 2)), np.empty((0, SIFT_SIZE), np.float32))
    at = np.array(cv2.KeyPoint.convert(found), np.float64)
    described = np.asarray(described, np.float32)
    roots = np.sqrt(described / np.maximum(described.sum(axis=1, keepdims=True), 1e-9))
    zoom = np.array([view.shape[1] / width, view.shape[0] / height])
    return Features((at + 0.5) * zoom - 0.5, roots)


@dataclass(frozen=True)
class Basis:
    """Principal components of a place's descriptors, at half the size: mean (128,) and axes (128, 64)."""

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
        """The features with reduced descriptors."""
        return Features(features.pixels, unit_vectors((features.descriptors - self.mean) @ self.axes))


def unit_vectors(vectors: Float32[np.ndarray, "n d"]) -> Float32[np.ndarray, "n d"]:
    """Vectors of length 1; zeros stay zeros."""
    return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-9)


def stored(descriptors: Float32[np.ndarray, "n d"]) -> Int8[np.ndarray, "n d"]:
    """Unit vectors in a byte a number."""
    return np.rint(_UNIT * descriptors).astype(np.int8)


def restored(descriptors: Int8[np.ndarray, "n d"]) -> Float32[np.ndarray, "n d"]:
    """The inverse of `stored`."""
    return descriptors.astype(np.float32) * np.float32(1.0 / _UNIT)


def mutual_matches(
    one: Float32[np.ndarray, "n d"], other: Float32[np.ndarray, "m d"], ratio: float
) -> tuple[Int64[np.ndarray, " k"], Int64[np.ndarray, " k"]]:
    """Indices of pairs of unit vectors that are each other's nearest, in increasing order of the first.

    `ratio` is the greatest ratio of the distances of the first's nearest and second nearest (Lowe 2004).
    """
    if not len(one) or not len(other):
        return np.empty(0, np.int64), np.empty(0, np.int64)
    likeness = one @ other.T
    rows = np.arange(len(one))
    nearest = likeness.argmax(axis=1)
    best = likeness[rows, nearest]
    if likeness.shape[1] > 1:
        likeness[rows, nearest] = -2.0
        first = np.flatnonzero(1.0 - best < ratio**2 * (1.0 - likeness.max(axis=1)))
        likeness[rows, nearest] = best
    else:
        first = rows
    second = nearest[first]
    mutual = likeness[:, second].argmax(axis=0) == first
    return first[mutual], second[mutual]


def within(
    one: Float64[np.ndarray, "n 2"], other: Float64[np.ndarray, "m 2"], most_px: float
) -> tuple[Int64[np.ndarray, " p"], Int64[np.ndarray, " p"]]:
    """Indices of all pairs of pixels within this distance along both axes."""
    order = np.argsort(other[:, 0], kind="stable")
    begin = np.searchsorted(other[order, 0], one[:, 0] - most_px, "left")
    count = np.searchsorted(other[order, 0], one[:, 0] + most_px, "right") - begin
    i = np.repeat(np.arange(len(one)), count)
    j = order[np.arange(len(i)) + np.repeat(begin - np.cumsum(count) + count, count)]
    near = np.abs(one[i, 1] - other[j, 1]) <= most_px
    return i[near], j[near]


def mutual_matches_among(
    likeness: Float32[np.ndarray, " p"], i: Int64[np.ndarray, " p"], j: Int64[np.ndarray, " p"]
) -> tuple[Int64[np.ndarray, " k"], Int64[np.ndarray, " k"]]:
    """The pairs (i, j) that are each other's most similar among the given ones, in increasing order of i."""
    order = np.lexsort([j, i, -likeness])
    i, j = i[order], j[order]
    taken = np.zeros(len(order), bool)
    taken[np.intersect1d(np.unique(i, return_index=True)[1], np.unique(j, return_index=True)[1])] = True
    first, second = i[taken], j[taken]
    order = np.argsort(first, kind="stable")
    return first[order], second[order]
