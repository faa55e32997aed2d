"""What training images go through: random crop, blur, brightness, contrast and colour."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
import torch
from jaxtyping import Float, Float32, Int64, UInt8
from torch import Tensor
from torch.nn import functional

from filtering.errors import require_within

_GREY = np.array([0.299, 0.587, 0.114], np.float32)  # Rec. 601 luma


@dataclass(frozen=True)
class AugmentConfig:
    """How much training images vary; an amount a means a factor drawn from [1 − a, 1 + a]."""

    crop: Literal["central", "anywhere"] = "central"
    """Crops from the middle, of the network's aspect, or from the whole image: a crop far off centre shows what a
    turned camera would see."""
    brightness: float = 0.3
    """Amount of brightness."""
    contrast: float = 0.3
    """Amount of contrast about the image's mean grey."""
    saturation: float = 0.3
    """Amount of saturation."""
    colour: float = 0.1
    """Amount of each colour channel's own gain."""
    blur_probability: float = 0.3
    """Fraction of the images that are blurred."""
    blur_sigma_px: float = 1.0
    """Largest standard deviation of the Gaussian blur, pixels; each is drawn from half of it up."""
    light: float = 0.0
    """Standard deviation of the logarithm of light that falls unevenly, as lamps throw it at another hour."""

    def __post_init__(self) -> None:
        require_within(
            self,
            light=(0.0, 3.0),
            brightness=(0.0, 1.0),
            contrast=(0.0, 1.0),
            saturation=(0.0, 1.0),
            colour=(0.0, 1.0),
            blur_probability=(0.0, 1.0),
            blur_sigma_px=(0.0, 1e3),
        )


def random_crops(
    images: UInt8[np.ndarray, "n h w 3"],
    indices: Int64[np.ndarray, " b"],
    width: int,
    height: int,
    config: AugmentConfig,
    *,
    rng: np.random.Generator,
) -> UInt8[np.ndarray, "b height width 3"]:
    """A random part of each chosen image, some of them blurred; only what is cropped is read."""
    y = rng.integers(0, images.shape[1] - height, len(indices), endpoint=True)
    x = rng.integers(0, images.shape[2] - width, len(indices), endpoint=True)
    sigma = config.blur_sigma_px * rng.uniform(0.5, 1.0, len(indices))
    sigma[rng.random(len(indices)) >= config.blur_probability] = 0.0
    crops = np.empty((len(indices), height, width, 3), np.uint8)
    for crop, i, top, left, s in zip(crops, indices, y, x, sigma, strict=True):
        part = images[i, top : top + height, left : left + width]
        crop[:] = cv2.GaussianBlur(part, (0, 0), s) if s > 0 else part
    return crops


def colour_jitter(
    mean_grey: Float32[np.ndarray, " b"], config: AugmentConfig, *, rng: np.random.Generator
) -> tuple[Float32[np.ndarray, "b 3 3"], Float32[np.ndarray, "b 3"]]:
    """Random affine maps x → A x + a of RGB pixels in 0..255: brightness, contrast, saturation and channel gains.

    Args:
        mean_grey: Mean grey of each image, about which contrast turns.
        config: Amounts.
        rng: Source of the factors.
    """

    def factor(amount: float, *shape: int) -> np.ndarray:
        return rng.uniform(1 - amount, 1 + amount, (len(mean_grey), *shape)).astype(np.float32)

    contrast, saturation = factor(config.contrast), factor(config.saturation)[:, None, None]
    gain = factor(config.brightness)[:, None] * factor(config.colour, 3)
    colour = saturation * np.eye(3, dtype=np.float32) + (1 - saturation) * np.broadcast_to(_GREY, (3, 3))
    matrix = (gain * contrast[:, None])[:, :, None] * colour
    return matrix, gain * ((1 - contrast) * mean_grey)[:, None]


def _uneven_light(shape: tuple[int, ...], amount: float, *, rng: np.random.Generator) -> Float[Tensor, "b h w 1"]:
    """Factors by which light on images of a shape (b, h, w, 3) changes: smooth fields through three by three points."""
    points = torch.from_numpy(np.exp(amount * rng.standard_normal((shape[0], 1, 3, 3)))).float()
    field = functional.interpolate(points, size=shape[1:3], mode="bilinear", align_corners=True)
    return field.permute(0, 2, 3, 1)


def jitter_and_normalise(
    crops: UInt8[Tensor, "b h w 3"],
    pixel_mean: Float[Tensor, "3"],
    pixel_std: Float[Tensor, "3"],
    config: AugmentConfig,
    *,
    rng: np.random.Generator,
) -> Float[Tensor, "b 3 h w"]:
    """Colour jitter and the backbone's normalisation as one affine map per image; channels-last in memory."""
    grey = torch.tensor(_GREY, device=crops.device)
    mean_grey = crops[:, ::4, ::4].float().mean(dim=(1, 2)) @ grey  # a sixteenth of the pixels is enough for the mean
    matrix, offset = (
        torch.from_numpy(a).to(crops.device) for a in colour_jitter(mean_grey.cpu().numpy(), config, rng=rng)
    )
    matrix = matrix / pixel_std[:, None]
    offset = (offset - pixel_mean) / pixel_std
    pixels = crops.float()
    if config.light > 0.0:
        pixels.mul_(_uneven_light(crops.shape, config.light, rng=rng).to(crops.device)).clamp_(max=255.0)
    pixels = pixels.flatten(1, 2)
    mapped = torch.baddbmm(offset[:, None], pixels, matrix.transpose(1, 2))
    return mapped.unflatten(1, crops.shape[1:3]).permute(0, 3, 1, 2)
