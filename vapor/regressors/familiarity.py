"""How unlike the images that a network was trained on an image is: distance to the nearest of some of them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import torch
from jaxtyping import Float, Float32, Float64, UInt8
from torch import Tensor, nn
from torch.nn import functional

from filtering.errors import VaporTrackError
from vapor.regressors.base import PoseRegressor

LEAST_IMAGES = 50
QUANTILE = 0.995
"""Fraction of images that are no further from the training images than counts as familiar."""
_CELL_PX, _DARK = 4, 30.0
_CHROMA_EDGES = (-0.1, -0.05, -0.03, -0.015, 0.0, 0.015, 0.03, 0.05, 0.1)
CHROMA = 2 * (len(_CHROMA_EDGES) + 1)
"""How many of the numbers in a description of an image tell of its colours; they come last."""


@dataclass(frozen=True)
class Familiarity:
    """What the training images of a network look like to it.

    An image is described by d numbers (`Describer`). Less the mean and in units of `scale`, they are projected on p
    principal axes, and stretched. The distance of two images is Euclidean there; what the axes leave over of an
    image is one coordinate more, in which training images are at 0.

    Attributes:
        centre: Mean description of training images.
        scale: What counts as 1 in each number.
        axes: Orthonormal columns.
        stretch: Factor of each axis; the last one is also that of what is left over.
        exemplars: n training images on the stretched axes.
        own_distance: Only one training image in 200 is further from all those of other segments of the training data.
        threshold: Distance from which on an image counts as foreign: the former, or the same of held-out images if that
            is more.
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
                f"familiarity: own_distance {self.own_distance} and threshold {self.threshold}, expected positive"
                " numbers, the latter no less than the former"
            )
        for name in ("scale", "stretch"):
            if not (getattr(self, name) > 0.0).all():
                raise VaporTrackError(f"familiarity: {name} has values that are not positive")

    def unfamiliarity(self, descriptions: Float32[np.ndarray, "m d"]) -> Float64[np.ndarray, " m"]:
        """Score of images with these descriptions: 0 an image trained on, 1 at the threshold, above it foreign."""
        return self._distances(descriptions).min(axis=1) / self.threshold

    def with_threshold_of(self, held_out: Float32[np.ndarray, "m d"]) -> Familiarity:
        """The same with the threshold that descriptions of held-out images ask for; the training's own if too few."""
        if len(held_out) < LEAST_IMAGES:
            return replace(self, threshold=self.own_distance)
        distance = float(np.quantile(self._distances(held_out).min(axis=1), QUANTILE))
        return replace(self, threshold=max(self.own_distance, distance))

    def _distances(self, descriptions: Float32[np.ndarray, "m d"]) -> Float64[np.ndarray, "m n"]:
        standard = ((descriptions - self.centre) / self.scale).astype(np.float64)
        projected = standard @ self.axes
        left_over = (standard**2).sum(axis=1) - (projected**2).sum(axis=1)
        projected *= self.stretch
        squared = (projected**2).sum(axis=1)[:, None] + (self.exemplars.astype(np.float64) ** 2).sum(axis=1)
        squared -= 2.0 * projected @ self.exemplars.T.astype(np.float64)
        squared = np.maximum(squared, 0.0) + np.maximum(left_over, 0.0)[:, None] * float(self.stretch[-1]) ** 2
        return np.sqrt(squared)


class Describer:
    """Describes images by what the network's backbone makes of them on its way to a pose.

    The mean of every channel after each of four stages, and, as a network trained under changing colours says little
    of them, how common which colours are: histograms of how much more red, and more blue, than green there is in
    cells of 4 × 4 pixels, as square roots. It listens to the network: the last batch that went through is described.
    A context manager stops listening at its end.

    Args:
        network: Listened to from now on.
    """

    def __init__(self, network: PoseRegressor) -> None:
        self._means: dict[int, Tensor] = {}
        self._handles = [
            stage.register_forward_hook(partial(self._listen, number))
            for number, stage in enumerate(network.backbone.stages)
        ]

    def __enter__(self) -> Describer:
        return self

    def __exit__(self, *_: object) -> None:
        for handle in self._handles:
            handle.remove()

    def last(self, images: UInt8[Tensor, "b h w 3"]) -> Float32[np.ndarray, "b d"]:
        """Descriptions of the images of the last batch, RGB as they were before `PoseRegressor.normalise`."""
        means = [self._means[number] for number in range(len(self._handles))]
        return torch.cat([*means, _colours(images)], dim=1).cpu().numpy()

    def _listen(self, number: int, _stage: nn.Module, _inputs: object, output: Tensor) -> None:
        self._means[number] = output.detach().float().mean(dim=(2, 3))


def description_size(network: PoseRegressor) -> int:
    """d, how many numbers describe an image."""
    return sum(network.backbone.stage_channels) + CHROMA


def _colours(images: UInt8[Tensor, "b h w 3"]) -> Float[Tensor, "b c"]:
    cells = functional.avg_pool2d(images.permute(0, 3, 1, 2).float(), _CELL_PX).flatten(2)
    red, green, blue = cells.unbind(dim=1)
    chroma = torch.stack([red - green, blue - green], dim=1) / (cells.sum(dim=1, keepdim=True) + _DARK)
    bins = torch.bucketize(chroma, torch.tensor(_CHROMA_EDGES, device=images.device), right=True)
    kinds = torch.arange(len(_CHROMA_EDGES) + 1, device=images.device)
    return (bins[..., None] == kinds).float().mean(dim=2).sqrt().flatten(1)
