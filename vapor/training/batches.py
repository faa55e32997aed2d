"""Batches that a network learns from: images varied anew every time, or features that were extracted before."""

from __future__ import annotations

from typing import Protocol

import numpy as np
import torch
from jaxtyping import Int64
from torch import Tensor

from vapor.regressors.base import PoseRegressor
from vapor.regressors.loss import Loss
from vapor.regressors.memory import RecallingRegressor
from vapor.training.augment import jitter_and_normalise, random_crops
from vapor.training.config import TrainConfig
from vapor.training.memory import TrainingFeatures, remember
from vapor.training.precision import uses_bfloat16
from vapor.training_data.training_set import TrainingSet

_REMEMBERED = 32  # steps from one to the next time that all images are remembered anew, at least


class Batches(Protocol):
    """Gives the loss of one batch of an epoch after another."""

    def loss(self, indices: Int64[np.ndarray, " b"], number: int, samples: int) -> Loss:
        """The loss of the images with these indices.

        Args:
            indices: Of the batch.
            number: Of the step in this epoch, from 0.
            samples: Posterior samples per image that the schedule asks for.
        """
        ...


class ImageBatches:
    """Random crops of images in random colours and light.

    Args:
        network: In training mode.
        training: The images.
        config: How they are varied, and the loss.
        rng: Of what varies.
        generator: Of the noise that samples are made from, on the network's device.
    """

    def __init__(
        self,
        network: PoseRegressor,
        training: TrainingSet,
        config: TrainConfig,
        *,
        rng: np.random.Generator,
        generator: torch.Generator,
    ) -> None:
        self._network, self._training, self._config = network, training, config
        self._rng, self._generator = rng, generator
        self._device = network.pixel_mean.device
        self._translation = torch.from_numpy(training.poses.translation).float().to(self._device)
        self._rotation = torch.from_numpy(training.poses.rotation).float().to(self._device)
        self._bfloat16 = uses_bfloat16(config, self._device)

    def loss(self, indices: Int64[np.ndarray, " b"], number: int, samples: int) -> Loss:
        """As `Batches` says."""
        network, training, c = self._network, self._training, self._config
        size = c.network.image_width, c.network.image_height
        crops = random_crops(training.images, training.rows[indices], *size, c.augment, rng=self._rng)
        pixels = torch.from_numpy(crops).to(self._device)
        images = jitter_and_normalise(pixels, network.pixel_mean, network.pixel_std, c.augment, rng=self._rng)
        shape = len(indices), network.samples_in_training(samples), network.noise_dim
        noise = torch.randn(shape, generator=self._generator, device=self._device)
        with torch.autocast(self._device.type, torch.bfloat16, enabled=self._bfloat16):
            return network.loss(images, self._translation[indices], self._rotation[indices], noise, c.loss)


class FeatureBatches:
    """Features of images that were varied in one of a few ways, some numbers left out; for a regressor with a memory.

    Args:
        network: In training mode.
        features: Of the images.
        epoch: Whose way of varying is taken.
        config: The loss, and what fraction of the numbers is left out.
        generator: Of which are left out, on the network's device.
    """

    def __init__(
        self,
        network: RecallingRegressor,
        features: TrainingFeatures,
        epoch: int,
        config: TrainConfig,
        *,
        generator: torch.Generator,
    ) -> None:
        self._network, self._features, self._config, self._generator = network, features, config, generator
        bfloat16 = uses_bfloat16(config, network.pixel_mean.device)
        self._varied = features.varied(network, epoch, config, bfloat16=bfloat16)
        count = len(features.images)
        self._interval = max(_REMEMBERED, count // min(config.batch_size, count) // _REMEMBERED)

    def loss(self, indices: Int64[np.ndarray, " b"], number: int, samples: int) -> Loss:
        """As `Batches` says; now and then the memory is made anew with the weights of then."""
        features, c = self._features, self._config
        if number % self._interval == 0:
            remember(self._network, features)
        feature = _dropped_out(self._varied[indices].float(), c.network.dropout, self._generator)
        truth = features.translation[indices], features.rotation[indices]
        return self._network.loss_of_features(feature, *truth, features.hidden(indices), c.loss)


def _dropped_out(feature: Tensor, dropped: float, generator: torch.Generator) -> Tensor:
    """Features (b, f) with a fraction of their numbers left out, the others larger in return."""
    kept = torch.rand(feature.shape, generator=generator, device=feature.device) >= dropped
    return feature * kept / (1.0 - dropped)
