"""What training images go through: random crop, blur, brightness, contrast and colour."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
import torch
from jaxtyping import Float, Float32, Float64, Int64, UInt8
from scipy.spatial.transform import Rotation
from torch import Tensor
from torch.nn import functional

from filtering.errors import require_within

_GREY = np.array([0.299, 0.587, 0.114], np.float32)  # Rec. 601 luma


@dataclass(frozen=True)
class AugmentConfig:
    """How much training images vary; an amount a means a factor drawn from [1 − a, 1 + a]."""

    crop: Literal["central", "anywhere"] = "central"
    """Crops from the middle, of the network's aspect, or from the whole image: one far off centre shows what a turned
    camera would."""
    brightness: float = 0.3
    """Amount of brightness."""
    contrast: float = 0.3
    """Amount of contrast about the image's mean grey."""
    saturation: float = 0.3
    """Amount of saturation."""
    colour: float = 0.1
    """Amount of each colour channel's own gain."""
    blur_probability: float = 0.3
    """Share of the images that are blurred."""
    blur_sigma_px: float = 1.0
    """Largest standard deviation of the Gaussian blur, pixels; each is drawn from half of it up."""
    turn_deg: float = 6.0
    """Largest angle by which each camera is turned about each of its axes, pose and image alike, where it is known."""
    light: float = 0.3
    """Standard deviation of the logarithm of light that falls unevenly, as lamps throw it at another hour."""
    erase_probability: float = 0.0
    """Share of the images of which a rectangle is painted over, as by someone who stands there."""
    erase_share: float = 0.3
    """Largest share of the image's area that it covers; each is drawn from a tenth of it up."""

    def __post_init__(self) -> None:
        require_within(
            self,
            turn_deg=(0.0, 45.0),
            light=(0.0, 3.0),
            erase_probability=(0.0, 1.0),
            erase_share=(0.0, 1.0),
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
    focal_px: tuple[float, float] | None = None,
    rng: np.random.Generator,
) -> tuple[UInt8[np.ndarray, "b height width 3"], Float64[np.ndarray, "b 3 3"]]:
    """A random part of each chosen image, some of them blurred and painted over; only what is needed is read.

    Args:
        images: Of cameras whose axes go through the middle.
        indices: Of those chosen.
        width: Of the parts, pixels.
        height: Likewise.
        config: Amounts.
        focal_px: Focal lengths of the images, pixels: the parts are what turned cameras see. None where unknown: they
            are cut out anywhere.
        rng: Source of all that is random.

    Returns:
        The parts, and by what the cameras are turned: the pose of each is that of its image times this rotation.
    """
    count, (rows, columns) = len(indices), images.shape[1:3]
    y, x = (rng.integers(0, size, count, endpoint=True) for size in (rows - height, columns - width))
    turns = np.tile(np.eye(3), (count, 1, 1))
    if focal_px is not None and config.turn_deg > 0:
        turns = Rotation.from_rotvec(rng.uniform(-1, 1, (count, 3)) * np.radians(config.turn_deg)).as_matrix()
    sigma = config.blur_sigma_px * rng.uniform(0.5, 1.0, count)
    sigma[rng.random(count) >= config.blur_probability] = 0.0
    crops = np.empty((count, height, width, 3), np.uint8)
    for crop, i, top, left, turn, s in zip(crops, indices, y, x, turns, sigma, strict=True):
        if focal_px is not None and config.turn_deg > 0:
            part = _turned(images[i], turn, width, height, focal_px)
        else:
            part = images[i, top : top + height, left : left + width]
        crop[:] = cv2.GaussianBlur(part, (0, 0), s) if s > 0 else part
    _erase(crops, config, rng=rng)
    return crops, turns


def _turned(
    image: UInt8[np.ndarray, "h w 3"],
    turn: Float64[np.ndarray, "3 3"],
    width: int,
    height: int,
    focal_px: tuple[float, float],
) -> UInt8[np.ndarray, "height width 3"]:
    """What the camera sees once it is turned; beyond the image's border the border goes on."""
    inner, outer = (
        np.array([[focal_px[0], 0, (w - 1) / 2], [0, focal_px[1], (h - 1) / 2], [0, 0, 1]])
        for w, h in ((width, height), (image.shape[1], image.shape[0]))
    )
    seen = outer @ turn @ np.linalg.inv(inner)
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return np.asarray(cv2.warpPerspective(image, seen, (width, height), flags=flags, borderMode=cv2.BORDER_REPLICATE))


def _erase(crops: UInt8[np.ndarray, "b h w 3"], config: AugmentConfig, *, rng: np.random.Generator) -> None:
    """Paint rectangles of one random colour over some of the images."""
    if config.erase_probability == 0.0:
        return
    height, width = crops.shape[1:3]
    for index in np.flatnonzero(rng.random(len(crops)) < config.erase_probability):
        area, aspect = config.erase_share * rng.uniform(0.1, 1.0), np.exp(rng.uniform(-1.0, 1.0))
        tall, wide = (min((area * aspect) ** 0.5, 1.0), min((area / aspect) ** 0.5, 1.0))
        top, left = rng.uniform(0, 1 - tall) * height, rng.uniform(0, 1 - wide) * width
        rows = slice(int(top), int(top + tall * height))
        crops[index, rows, int(left) : int(left + wide * width)] = rng.integers(0, 256, 3, dtype=np.uint8)


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
    mean_grey = crops[:, ::4, ::4].float().mean(dim=(1, 2)) @ grey  # a sixteenth of the pixels tell the mean
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
