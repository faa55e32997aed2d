"""How unlike the images that a network was trained on an image is: distance to the nearest of some of them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import torch
from jaxtyping import Float, Float32, Float64, Int64, UInt8
from torch import Tensor, nn
from torch.nn import functional

from filtering.errors import VaporTrackError
from vapor.images import centre_crop
from vapor.network import PoseRegressor
from vapor.training_set import TrainingSet

EXEMPLARS = 1000
"""Training images that an image is compared with, at most."""
LEAST_IMAGES = 50
_AXES = 48
_BATCH = 64
_FLATTEN = 0.3  # an axis of k times less variance than the first is stretched by k to the power of half of this
_QUANTILE = 0.995
_FEW_SEQUENCES, _BLOCKS = 8, 10
_CELL_PX, _DARK = 4, 30.0
_CHROMA_EDGES = (-0.1, -0.05, -0.03, -0.015, 0.0, 0.015, 0.03, 0.05, 0.1)
_CHROMA = 2 * (len(_CHROMA_EDGES) + 1)
_CHROMA_WEIGHT = 0.5


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
        own_distance: Only one training image in 200 is further from all those of other stretches of the training data.
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

    def judged_by(self, held_out: Float32[np.ndarray, "m d"]) -> Familiarity:
        """The same with the threshold that descriptions of held-out images ask for; the training's own if too few."""
        if len(held_out) < LEAST_IMAGES:
            return replace(self, threshold=self.own_distance)
        distance = float(np.quantile(self._distances(held_out).min(axis=1), _QUANTILE))
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
    of them, how common which colours are: histograms of the shares of red and of blue against green in cells of
    4 × 4 pixels, square roots. It listens to the network: the last batch that went through is described. A context
    manager stops listening at its end.

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
    return sum(network.backbone.stage_channels) + _CHROMA


def _colours(images: UInt8[Tensor, "b h w 3"]) -> Float[Tensor, "b c"]:
    cells = functional.avg_pool2d(images.permute(0, 3, 1, 2).float(), _CELL_PX).flatten(2)
    red, green, blue = cells.unbind(dim=1)
    shares = torch.stack([red - green, blue - green], dim=1) / (cells.sum(dim=1, keepdim=True) + _DARK)
    bins = torch.bucketize(shares, torch.tensor(_CHROMA_EDGES, device=images.device), right=True)
    kinds = torch.arange(len(_CHROMA_EDGES) + 1, device=images.device)
    return (bins[..., None] == kinds).float().mean(dim=2).sqrt().flatten(1)


def describe(network: PoseRegressor, images: TrainingSet) -> Float32[np.ndarray, "n d"]:
    """Descriptions of each image's centre crop; the network is in evaluation mode until all are done."""
    config, training, device = network.config, network.training, network.pixel_mean.device
    network.eval()
    found = np.empty((len(images), description_size(network)), np.float32)
    with Describer(network) as describer, torch.inference_mode():
        for start in range(0, len(images), _BATCH):
            whole = images.images[images.rows[start : start + _BATCH]]
            crops = np.stack([centre_crop(image, config.image_width, config.image_height) for image in whole])
            pixels = torch.from_numpy(crops).to(device)
            network.backbone(network.normalise(pixels))
            found[start : start + _BATCH] = describer.last(pixels)
    network.train(training)
    return found


def learn_familiarity(network: PoseRegressor, training: TrainingSet, held_out: TrainingSet) -> Familiarity | None:
    """What training images look like, and how far held-out ones are from them; None with fewer than 50 of the former.

    Args:
        network: With its final weights.
        training: Images in order of time, at most `EXEMPLARS` well spread ones.
        held_out: Images of the same place that it was not trained on; below 50 the training images alone decide.
    """
    if len(training) < LEAST_IMAGES:
        return None
    familiarity = fit_familiarity(describe(network, training), _stretches(training.sequence))
    return familiarity.judged_by(describe(network, held_out))


def fit_familiarity(descriptions: Float32[np.ndarray, "n d"], stretch: Int64[np.ndarray, " n"]) -> Familiarity:
    """From descriptions of training images alone, each from a numbered stretch of the data, of which there are some."""
    centre, spread = descriptions.mean(axis=0), descriptions.std(axis=0)
    spread = np.maximum(spread, 1e-3 * spread.mean() + 1e-6)
    backbone, chroma = descriptions.shape[1] - _CHROMA, _CHROMA
    weight = np.repeat([1.0 / np.sqrt(backbone), _CHROMA_WEIGHT / np.sqrt(chroma)], [backbone, chroma])
    scale = (spread / weight).astype(np.float32)
    standard = ((descriptions - centre) / scale).astype(np.float64)
    variance, axes = np.linalg.eigh(standard.T @ standard / len(standard))
    count = min(_AXES, len(variance), len(descriptions) - 1)
    variance, axes = np.maximum(variance[::-1][:count], 1e-6 * variance[-1] + 1e-12), axes[:, ::-1][:, :count]
    axes = _as_stored(axes)
    stretched = ((variance / variance[0]) ** (-_FLATTEN / 2)).astype(np.float32)
    exemplars = _as_stored(((descriptions - centre) / scale) @ axes * stretched)
    fitted = Familiarity(centre, scale, axes, stretched, exemplars, 1.0, 1.0)
    own = np.empty(len(descriptions))
    for number in np.unique(stretch):
        of_others = replace(fitted, exemplars=exemplars[stretch != number])
        own[stretch == number] = of_others.unfamiliarity(descriptions[stretch == number])
    distance = max(float(np.quantile(own, _QUANTILE)), 1e-6)
    return replace(fitted, own_distance=distance, threshold=distance)


def _stretches(sequence: Int64[np.ndarray, " n"]) -> Int64[np.ndarray, " n"]:
    """The sequences themselves; of few, tenths of all images."""
    if len(np.unique(sequence)) >= _FEW_SEQUENCES:
        return sequence
    return np.arange(len(sequence)) * _BLOCKS // len(sequence)


def _as_stored(values: np.ndarray) -> Float32[np.ndarray, "a b"]:
    """Rounded to float16, as which they are stored."""
    return values.astype(np.float16).astype(np.float32)
