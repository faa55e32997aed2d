"""The map: points of a place, their descriptors, the camera, and the key images that show each point."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int8, Int32

from filtering.mapped_views import MappedViews
from filtering.se3 import Poses
from sequences.frame import Camera
from vapor.landmarks.features import Basis, Features, unit_vectors

_ROUNDS = 8  # of the fixed point that takes distortion away
LEAST_INLIERS = 12
"""Landmarks that a pose must be seen by to be one."""


@dataclass(frozen=True)
class ViewCamera:
    """A pinhole camera with radial distortion: the ray (x, y, 1) is seen at f (1 + k₁ r² + k₂ r⁴) (x, y) + c."""

    camera: Camera
    k1: float = 0.0
    k2: float = 0.0

    @property
    def focal(self) -> Float64[np.ndarray, "2"]:
        """Focal lengths, pixels."""
        return np.array([self.camera.fx, self.camera.fy])

    @property
    def centre(self) -> Float64[np.ndarray, "2"]:
        """Principal point, pixels."""
        return np.array([self.camera.cx, self.camera.cy])

    @property
    def size(self) -> Float64[np.ndarray, "2"]:
        """Width and height, pixels."""
        return np.array([self.camera.width, self.camera.height], np.float64)

    def rays(self, pixels: Float64[np.ndarray, "n 2"]) -> Float64[np.ndarray, "n 2"]:
        """The x and y of rays (x, y, 1) through pixels."""
        seen = (pixels - self.centre) / self.focal
        if self.k1 == self.k2 == 0.0:
            return seen
        ray = seen
        for _ in range(_ROUNDS):
            squared = np.square(ray).sum(axis=1, keepdims=True)
            ray = seen / np.maximum(1.0 + squared * (self.k1 + self.k2 * squared), 0.2)
        return ray

    def pixels(self, rays: Float64[np.ndarray, "n 2"]) -> Float64[np.ndarray, "n 2"]:
        """Pixels of rays (x, y, 1), given by x and y."""
        squared = np.square(rays).sum(axis=1, keepdims=True)
        return self.focal * (1.0 + squared * (self.k1 + self.k2 * squared)) * rays + self.centre

    def undistorted(self, pixels: Float64[np.ndarray, "n 2"]) -> Float64[np.ndarray, "n 2"]:
        """Pixels in the camera without distortion."""
        return pixels if self.k1 == self.k2 == 0.0 else self.rays(pixels) * self.focal + self.centre


@dataclass(frozen=True)
class LandmarkMap:
    """p points that n key images show.

    Attributes:
        stated: Stated camera of the images, at the size of the features; None without one.
        camera: The fitted camera at that size, or the stated one where that fits as well. It is used for images whose
            stated camera is `stated`.
        depth_m: Median distance of the scene, metres.
        points: Metres, (p, 3).
        descriptors: In a byte a number (`features.stored`), (p, d).
        rotation: Of world_from_camera of the key images, (n, 3, 3).
        translation: Of world_from_camera of the key images, metres, (n, 3).
        begins: Where the points of each key image begin in `shown`, and where the last one's end, (n + 1,).
        shown: The points that key images show, image by image, (s,).
        mean: See `Basis`, (128,).
        axes: See `Basis`, (128, d).
        words: Typical descriptors, (w, d).
        summary_axes: Axes of summaries, (w · d, k).
        summaries: Of the key images, unit vectors, (n, k).
    """

    stated: Camera | None
    camera: ViewCamera
    depth_m: float
    points: Float32[np.ndarray, "p 3"]
    descriptors: Int8[np.ndarray, "p d"]
    rotation: Float32[np.ndarray, "n 3 3"]
    translation: Float32[np.ndarray, "n 3"]
    begins: Int32[np.ndarray, " m"]
    shown: Int32[np.ndarray, " s"]
    mean: Float32[np.ndarray, " q"]
    axes: Float32[np.ndarray, "q d"]
    words: Float32[np.ndarray, "w d"]
    summary_axes: Float32[np.ndarray, "v k"]
    summaries: Float32[np.ndarray, "n k"]

    @cached_property
    def basis(self) -> Basis:
        """Basis of the descriptors."""
        return Basis(self.mean, self.axes)

    @cached_property
    def poses(self) -> Poses:
        """world_from_camera of the key images, (n,)."""
        return Poses(self.rotation.astype(np.float64), self.translation.astype(np.float64))

    def shown_by(self, image: int) -> Int32[np.ndarray, " k"]:
        """The points that a key image shows."""
        return self.shown[self.begins[image] : self.begins[image + 1]]

    def mapped(
        self, reach: float = 1.0, elsewhere: float = 0.0, ignored: Bool[np.ndarray, " n"] | None = None
    ) -> MappedViews:
        """The views of key images, but the ignored, that show as many points as a pose needs, see `MappedViews`."""
        used = np.diff(self.begins) >= LEAST_INLIERS
        if ignored is not None:
            used &= ~ignored
        return MappedViews(self.poses[np.flatnonzero(used)], self.depth_m, reach, elsewhere)

    def summary(self, features: Features) -> Float32[np.ndarray, " k"]:
        """Summary of an image by its features in the map's basis; a unit vector."""
        return unit_vectors(summed_up(features.descriptors, self.words)[None] @ self.summary_axes)[0]


def summed_up(descriptors: Float32[np.ndarray, "n d"], words: Float32[np.ndarray, "w d"]) -> Float32[np.ndarray, " v"]:
    """Sums of the differences of descriptors from their nearest words (VLAD; Arandjelović, CVPR 2013)."""
    nearest = (descriptors @ words.T - 0.5 * np.square(words).sum(axis=1)).argmax(axis=1)
    member = (nearest == np.arange(len(words))[:, None]).astype(np.float32)
    apart = member @ descriptors - member.sum(axis=1, keepdims=True) * words
    return unit_vectors(unit_vectors(apart).reshape(1, -1))[0]
