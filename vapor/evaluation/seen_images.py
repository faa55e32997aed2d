"""Features and descriptions of images; a backbone that never learns sees each image once."""

from __future__ import annotations

import zlib
from collections.abc import Iterator

import numpy as np
import torch
from jaxtyping import Float, Float32, Int64, UInt8
from torch import Tensor

from vapor.images import centre_crop
from vapor.regressors.backbones import Describer
from vapor.regressors.base import PoseRegressor
from vapor.regressors.ood_model import description_size
from vapor.regressors.retrieval import RetrievalRegressor
from vapor.training_data.training_set import SeenImages, TrainingSet

_BATCH, _GPU_BATCH = 16, 64  # on a processor maps of up to 19 MB, which `keep_freed_memory` keeps


@torch.no_grad()
def features_of(network: RetrievalRegressor, images: TrainingSet) -> Float[Tensor, "n f"]:
    """Features of the centre crops of images, on the network's device."""
    numbers = _seen(network, images).numbers[images.rows]
    return network.standardised_numbers(torch.from_numpy(numbers).to(network.centre.device))


def describe_images(network: PoseRegressor, images: TrainingSet) -> Float32[np.ndarray, "n d"]:
    """Descriptions of each image's centre crop (`Describer`), with the network in evaluation mode."""
    if network.recalling is not None:
        return _seen(network.recalling, images).descriptions[images.rows]
    found, training = np.empty((len(images), description_size(network.config.backbone)), np.float32), network.training
    network.eval()
    with Describer(network) as describer, torch.inference_mode():
        for part, pixels in crops_of(network, images.images, images.rows):
            network.backbone(network.normalise(pixels))
            found[part] = describer.last(pixels).cpu().numpy()
    network.train(training)
    return found


def crops_of(
    network: PoseRegressor, images: UInt8[np.ndarray, "m h w 3"], rows: Int64[np.ndarray, " n"], size: int | None = None
) -> Iterator[tuple[slice, UInt8[Tensor, "b h2 w2 3"]]]:
    """Slices of some rows of images, and the centre crops of these, on the network's device, `size` at a time."""
    config, device = network.config, network.pixel_mean.device
    size = size or (_BATCH if device.type == "cpu" else _GPU_BATCH)
    for start in range(0, len(rows), size):
        whole = images[rows[start : start + size]]
        crops = np.stack([centre_crop(image, config.image_width, config.image_height) for image in whole])
        yield slice(start, start + len(crops)), torch.from_numpy(crops).to(device)


def _seen(network: RetrievalRegressor, images: TrainingSet) -> SeenImages:
    """What the backbone makes of images, which it is shown unless it was before."""
    seen = images.seen
    backbone = zlib.crc32(f"{network.config.image_width} {network.config.image_height}".encode())
    for value in network.backbone.state_dict().values():
        backbone = zlib.crc32(value.cpu().numpy().tobytes(), backbone)
    if backbone != seen.backbone:
        count, size = len(images.images), description_size(network.config.backbone)
        seen.backbone, seen.shown = backbone, np.zeros(count, bool)
        seen.numbers = np.empty((count, len(network.centre)), np.float32)
        seen.descriptions = np.empty((count, size), np.float32)
    new = np.unique(images.rows[~seen.shown[images.rows]])
    with Describer(network) as describer, torch.inference_mode():
        for part, pixels in crops_of(network, images.images, new):
            seen.numbers[new[part]] = network.numbers(network.normalise(pixels)).cpu().numpy()
            seen.descriptions[new[part]] = describer.last(pixels).cpu().numpy()
    seen.shown[new] = True
    return seen
