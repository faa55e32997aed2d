"""OOD score of an image: its distance to the nearest of some training images of a network."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float32, Float64

from filtering.errors import VaporTrackError
from vapor.regressors.network_config import Backbone, stage_channels

LEAST_IMAGES = 50
QUANTILE = 0.995
"""Fraction of images of the place that are in distribution, by which the threshold is set."""
CHROMA_EDGES = (-0.1, -0.05, -0.03, -0.015, 0.0, 0.015, 0.03, 0.05, 0.1)
"""Bounds between kinds of colours."""
CHROMA = 2 * (len(CHROMA_EDGES) + 1)
"""Number of colour features in a description of an image; they come last."""


@dataclass(frozen=True)
class OodModel:
    """Descriptions of training images of a network, and the threshold distance of images out of distribution.

    An image is described by d numbers (`Describer`). They are centred, divided by `scale`, projected on p principal
    axes, and stretched. The distance of two images is Euclidean there; the residual of an image beside the axes is one
    more coordinate, in which training images are at 0.

    Attributes:
        centre: Mean description of training images.
        scale: Unit of each number.
        axes: Principal axes, orthonormal columns.
        stretch: Factor of each axis; the last factor is also the residual's.
        exemplars: n training images on the stretched axes.
        own_distance: The distance to other segments of the training data that one training image in 200 exceeds.
        threshold: Distance above which an image is out of distribution: `own_distance`, or the same of held-out images
            if larger.
    """

    centre: Float32[np.ndarray, " d"]
    scale: Float32[np.ndarray, " d"]
    axes: Float32[np.ndarray, "d p"]
    stretch: Float32[np.ndarray, " p"]
    exemplars: Float32[np.ndarray, "n p"]
    own_distance: float
    threshold: float

    def __post_init__(self) -> None:
        if not (0.0 < self.own_distance <= self.threshold < np.inf):
            raise VaporTrackError(
                f"OOD model: own_distance {self.own_distance} and threshold {self.threshold}, expected positive"
                " numbers, the latter no less than the former"
            )
        for name in ("scale", "stretch"):
            if not (getattr(self, name) > 0.0).all():
                raise VaporTrackError(f"OOD model: {name} has values that are not positive")

    def ood_score(self, descriptions: Float32[np.ndarray, "m d"]) -> Float64[np.ndarray, " m"]:
        """Scores of images with these descriptions: 0 for a training image, 1 at the threshold."""
        return self._distances(descriptions).min(axis=1) / self.threshold

    def with_threshold_of(self, held_out: Float32[np.ndarray, "m d"]) -> OodModel:
        """The same with the threshold by descriptions of held-out images; `own_distance` where these are too few."""
        if len(held_out) < LEAST_IMAGES:
            return replace(self, threshold=self.own_distance)
        distance = float(np.quantile(self._distances(held_out).min(axis=1), QUANTILE))
        return replace(self, threshold=max(self.own_distance, distance))

    @cached_property
    def _precise(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Axes, exemplars and their squared norms in float64, computed once."""
        exemplars = self.exemplars.astype(np.float64)
        return self.axes.astype(np.float64), exemplars.T, (exemplars**2).sum(axis=1)

    def _distances(self, descriptions: Float32[np.ndarray, "m d"]) -> Float64[np.ndarray, "m n"]:
        axes, exemplars, squares = self._precise
        standard = ((descriptions - self.centre) / self.scale).astype(np.float64)
        projected = standard @ axes
        left_over = (standard**2).sum(axis=1) - (projected**2).sum(axis=1)
        projected *= self.stretch
        squared = (projected**2).sum(axis=1)[:, None] + squares
        squared -= 2.0 * projected @ exemplars
        squared = np.maximum(squared, 0.0) + np.maximum(left_over, 0.0)[:, None] * float(self.stretch[-1]) ** 2
        return np.sqrt(squared)


def description_size(backbone: Backbone) -> int:
    """d, the size of a description by this backbone."""
    return sum(stage_channels(backbone)) + CHROMA
