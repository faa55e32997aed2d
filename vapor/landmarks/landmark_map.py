"""The map: points of a place, what they look like, and which training images show which of them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float32, Int8, Int32

from filtering.mapped_views import MappedViews
from filtering.se3 import Poses
from sequences.frame import Camera
from vapor.landmarks.features import Basis, Features, unit_vectors
from vapor.landmarks.view_camera import ViewCamera

LEAST_INLIERS = 12
"""Landmarks that a pose must be seen by to be one."""


@dataclass(frozen=True)
class LandmarkMap:
    """p points that n images show, the key images.

    Attributes:
        stated: What was stated of the camera of the images, at the size at which features are found; None where
            nothing was. Images of this camera are read through `camera`.
        camera: The camera that took them, at the same size, as it was found; the stated one where that fits as well.
        depth_m: How far away things are, median, metres.
        points: Where points are, metres, (p, 3).
        descriptors: What they look like, in a byte a number (`features.stored`), (p, d).
        rotation: Of world_from_camera of the key images, (n, 3, 3).
        translation: Likewise, metres, (n, 3).
        begins: Where in `shown` the points of each key image begin, and where those of the last one end, (n + 1,).
        shown: The points that key images show, image by image, (s,).
        mean: Of SIFT descriptors, see `Basis`, (128,).
        axes: Likewise, (128, d).
        words: Typical descriptors, (w, d).
        summary_axes: Axes of what images look like as a whole, (w · d, k).
        summaries: What each key image looks like as a whole, unit vectors, (n, k).
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
        """In which features are described."""
        return Basis(self.mean, self.axes)

    @cached_property
    def poses(self) -> Poses:
        """world_from_camera of the key images, batch (n,)."""
        return Poses(self.rotation.astype(np.float64), self.translation.astype(np.float64))

    def shown_by(self, image: int) -> Int32[np.ndarray, " k"]:
        """The points that a key image shows."""
        return self.shown[self.begins[image] : self.begins[image + 1]]

    def mapped(
        self, reach: float = 1.0, elsewhere: float = 0.0, ignored: Bool[np.ndarray, " n"] | None = None
    ) -> MappedViews:
        """The views of key images that show as many points as a pose needs, see `MappedViews`.

        Args:
            reach: As there.
            elsewhere: As there.
            ignored: Key images that do not count, (n,); None for none.
        """
        used = np.diff(self.begins) >= LEAST_INLIERS
        if ignored is not None:
            used &= ~ignored
        return MappedViews(self.poses[np.flatnonzero(used)], self.depth_m, reach, elsewhere)

    def summary(self, features: Features) -> Float32[np.ndarray, " k"]:
        """What an image looks like as a whole, by its features in the map's basis; a unit vector."""
        return unit_vectors(summed_up(features.descriptors, self.words)[None] @ self.summary_axes)[0]


def summed_up(descriptors: Float32[np.ndarray, "n d"], words: Float32[np.ndarray, "w d"]) -> Float32[np.ndarray, " v"]:
    """How descriptors differ from the words nearest to them, in all, word by word (VLAD; Arandjelović, CVPR 2013)."""
    nearest = (descriptors @ words.T - 0.5 * np.square(words).sum(axis=1)).argmax(axis=1)
    member = (nearest == np.arange(len(words))[:, None]).astype(np.float32)
    apart = member @ descriptors - member.sum(axis=1, keepdims=True) * words
    return unit_vectors(unit_vectors(apart).reshape(1, -1))[0]
