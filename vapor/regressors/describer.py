"""Describer: an image -> the numbers by which `Familiarity` tells whether it is like those of the training."""

from __future__ import annotations

from functools import partial

import torch
from jaxtyping import Float, Float32, UInt8
from torch import Tensor, nn
from torch.nn import functional

from vapor.regressors.base import PoseRegressor
from vapor.regressors.familiarity import CHROMA_EDGES

_CELL_PX, _DARK = 4, 30.0


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

    def last(self, images: UInt8[Tensor, "b h w 3"]) -> Float32[Tensor, "b d"]:
        """Descriptions of the images of the last batch, RGB as they were before `PoseRegressor.normalise`."""
        means = [self._means[number] for number in range(len(self._handles))]
        return torch.cat([*means, _colours(images)], dim=1)

    def _listen(self, number: int, _stage: nn.Module, _inputs: object, output: Tensor) -> None:
        self._means[number] = output.detach().float().mean(dim=(2, 3))


def _colours(images: UInt8[Tensor, "b h w 3"]) -> Float[Tensor, "b c"]:
    cells = functional.avg_pool2d(images.permute(0, 3, 1, 2).float(), _CELL_PX).flatten(2)
    red, green, blue = cells.unbind(dim=1)
    chroma = torch.stack([red - green, blue - green], dim=1) / (cells.sum(dim=1, keepdim=True) + _DARK)
    # A tensor of the edges would be copied to the GPU, which may not happen while kernels are recorded.
    bins = torch.stack([chroma >= edge for edge in CHROMA_EDGES]).sum(dim=0)
    kinds = torch.arange(len(CHROMA_EDGES) + 1, device=images.device)
    return (bins[..., None] == kinds).float().mean(dim=2).sqrt().flatten(1)
