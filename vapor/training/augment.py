"""Augmentation of training images, a batch ahead of its use: random crop, blur, brightness, contrast and colour."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import TypeVar

import cv2
import numpy as np
import torch
from jaxtyping import Float, Float32, Int64, UInt8
from torch import Tensor
from torch.nn import functional

from vapor.training.augment_config import AugmentConfig

_GREY = np.array([0.299, 0.587, 0.114], np.float32)  # Rec. 601 luma
Item = TypeVar("Item")
Result = TypeVar("Result")


@dataclass(frozen=True)
class Variation:
    """Random variation of each image of a batch.

    Attributes:
        top: First row of its crop.
        left: First column of its crop.
        sigma_px: Standard deviation of its blur; 0 for none.
        contrast: Factor of contrast.
        saturation: Factor of saturation.
        gain: Factor of each channel.
        light: Logarithm of the light at three by three points; None for even light.
    """

    top: Int64[np.ndarray, " b"]
    left: Int64[np.ndarray, " b"]
    sigma_px: Float[np.ndarray, " b"]
    contrast: Float32[np.ndarray, " b"]
    saturation: Float32[np.ndarray, " b"]
    gain: Float32[np.ndarray, "b 3"]
    light: Float[np.ndarray, "b 1 3 3"] | None

    def __getitem__(self, part: Int64[np.ndarray, " k"]) -> Variation:
        """The variation of some of the images."""
        found = {name: value[part] for name, value in vars(self).items() if value is not None}
        return replace(self, **found)


def draw_variation(config: AugmentConfig, count: int, spare: tuple[int, int], *, rng: np.random.Generator) -> Variation:
    """Draw the variation of `count` images, which have `spare` rows and columns more than crops of them."""

    def factor(amount: float, *shape: int) -> np.ndarray:
        return rng.uniform(1 - amount, 1 + amount, (count, *shape)).astype(np.float32)

    top, left = (rng.integers(0, most, count, endpoint=True) for most in spare)
    sigma_px = config.blur_sigma_px * rng.uniform(0.5, 1.0, count)
    sigma_px[rng.random(count) >= config.blur_probability] = 0.0
    contrast, saturation = factor(config.contrast), factor(config.saturation)
    gain = factor(config.brightness)[:, None] * factor(config.colour, 3)
    light = config.light * rng.standard_normal((count, 1, 3, 3)) if config.light > 0.0 else None
    return Variation(top, left, sigma_px, contrast, saturation, gain, light)


def random_crops(
    images: UInt8[np.ndarray, "n h w 3"],
    indices: Int64[np.ndarray, " b"],
    variation: Variation,
    size: tuple[int, int],
    shrunk: tuple[int, int] | None = None,
) -> UInt8[np.ndarray, "b h2 w2 3"]:
    """The drawn part of each chosen image, with the drawn blur; only these parts are read.

    Parts have a width and height of `size` pixels, and are shrunk to `shrunk` by averaging where that is given.
    """
    (width, height), shrunk = size, shrunk or size
    crops = np.empty((len(indices), shrunk[1], shrunk[0], 3), np.uint8)
    drawn = variation.top, variation.left, variation.sigma_px
    for crop, i, top, left, sigma in zip(crops, indices, *drawn, strict=True):
        part = images[i, top : top + height, left : left + width]
        part = cv2.GaussianBlur(part, (0, 0), sigma) if sigma > 0 else part
        crop[:] = part if shrunk == size else cv2.resize(part, shrunk, interpolation=cv2.INTER_AREA)
    return crops


def _colours(
    variation: Variation, mean_grey: Float32[np.ndarray, " b"]
) -> tuple[Float32[np.ndarray, "b 3 3"], Float32[np.ndarray, "b 3"]]:
    """Affine maps x → A x + a of RGB pixels in 0..255; contrast turns about the mean grey of each image."""
    contrast, saturation, gain = variation.contrast, variation.saturation[:, None, None], variation.gain
    colour = saturation * np.eye(3, dtype=np.float32) + (1 - saturation) * np.broadcast_to(_GREY, (3, 3))
    matrix = (gain * contrast[:, None])[:, :, None] * colour
    return matrix, gain * ((1 - contrast) * mean_grey)[:, None]


def jitter_and_normalise(
    crops: UInt8[Tensor, "b h w 3"],
    pixel_mean: Float[Tensor, "3"],
    pixel_std: Float[Tensor, "3"],
    variation: Variation,
) -> Float[Tensor, "b 3 h w"]:
    """The drawn colours and the backbone's normalisation as one affine map per image; channels-last in memory."""
    grey = torch.tensor(_GREY, device=crops.device)
    mean_grey = crops[:, ::4, ::4].float().mean(dim=(1, 2)) @ grey  # a sixteenth of the pixels is enough for the mean
    matrix, offset = (torch.from_numpy(a).to(crops.device) for a in _colours(variation, mean_grey.cpu().numpy()))
    matrix = matrix / pixel_std[:, None]
    offset = (offset - pixel_mean) / pixel_std
    pixels = crops.float()
    if variation.light is not None:
        points = torch.from_numpy(np.exp(variation.light)).float()
        light = functional.interpolate(points, size=crops.shape[1:3], mode="bilinear", align_corners=True)
        pixels.mul_(light.permute(0, 2, 3, 1).to(crops.device)).clamp_(max=255.0)
    pixels = pixels.flatten(1, 2)
    mapped = torch.baddbmm(offset[:, None], pixels, matrix.transpose(1, 2))
    return mapped.unflatten(1, crops.shape[1:3]).permute(0, 3, 1, 2)


def one_ahead(function: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
    """`function(item)` of every item, in order; a thread computes each result while the previous one is in use.

    One thread computes all results, so random numbers that `function` draws do not depend on timing. An error is raised
    in place of its result.
    """
    with ThreadPoolExecutor(1, thread_name_prefix="ahead") as thread:
        coming: Future[Result] | None = None
        for item in items:
            ready, coming = coming, thread.submit(function, item)
            if ready is not None:
                yield ready.result()
        if coming is not None:
            yield coming.result()
