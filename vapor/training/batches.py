"""Batches that a network learns from: images varied anew every time, or features that were extracted before."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Int64, UInt8
from torch import Tensor

from vapor.regressors.memory import RecallingRegressor
from vapor.training.ahead import one_ahead
from vapor.training.augment import Variation, draw_variation, jitter_and_normalise, random_crops
from vapor.training.config import TrainConfig
from vapor.training.memory import TrainingFeatures, remember
from vapor.training.pairs import paired
from vapor.training.precision import uses_bfloat16
from vapor.training.processes import own_part
from vapor.training.state import TrainingState
from vapor.training_data.training_set import TrainingSet

_REMEMBERED = 32  # steps from one to the next time that all images are remembered anew, at least


@runtime_checkable
class Batches(Protocol):
    """Gives the loss of one batch of an epoch after another; of its own part of each where processes share them."""

    def prepared(self, order: Int64[np.ndarray, "steps b"]) -> Iterable[Any]:
        """What `loss` takes of each batch, by the indices of its images."""
        ...

    def loss(self, batch: Any, number: int, samples: int) -> Tensor:
        """The loss of a batch, a scalar.

        Args:
            batch: From `prepared`.
            number: Of the step in this epoch, from 0.
            samples: Posterior samples per image that the schedule asks for.
        """
        ...


@dataclass(frozen=True)
class ImageBatch:
    """Crops of some of the images of a batch.

    Attributes:
        count: Of the images of the whole batch.
        own: Which of them these are: all, where no other process learns from the rest.
        indices: Of these in the training set.
        crops: Of these.
        variation: Of these.
    """

    count: int
    own: Int64[np.ndarray, " k"]
    indices: Int64[np.ndarray, " k"]
    crops: UInt8[np.ndarray, "k h w 3"]
    variation: Variation


class ImageBatches:
    """Random crops of images in random colours and light.

    Args:
        state: Its network is in training mode.
        training: The images.
        config: How they are varied, and the loss.
        rng: Of what varies.
        generator: Of the noise that samples are made from, on the network's device.
        size: Width and height to which crops are shrunk, pixels.
    """

    def __init__(
        self,
        state: TrainingState,
        training: TrainingSet,
        config: TrainConfig,
        *,
        rng: np.random.Generator,
        generator: torch.Generator,
        size: tuple[int, int],
    ) -> None:
        self._learner, self._network = state.learner, state.network
        self._training, self._config, self._size = training, config, size
        self._rng, self._generator = rng, generator
        self._device = state.network.pixel_mean.device
        self._translation = torch.from_numpy(training.poses.translation).float().to(self._device)
        self._rotation = torch.from_numpy(training.poses.rotation).float().to(self._device)
        self._bfloat16 = uses_bfloat16(config, self._device)

    def prepared(self, order: Int64[np.ndarray, "steps b"]) -> Iterator[ImageBatch]:
        """As `Batches` says; each batch is cropped while the network learns from the one before."""
        return one_ahead(self._prepare, order)

    def _prepare(self, indices: Int64[np.ndarray, " b"]) -> ImageBatch:
        images, rows, c = self._training.images, self._training.rows, self._config
        if c.loss.relative > 0.0:
            indices = paired(indices, self._training.sequence, c.loss.pair_gap, rng=self._rng)
        size = c.network.image_width, c.network.image_height
        spare = images.shape[1] - size[1], images.shape[2] - size[0]
        variation = draw_variation(c.augment, len(indices), spare, rng=self._rng)
        own, count = own_part(len(indices), pairs=c.loss.relative > 0.0), len(indices)
        indices, variation = indices[own], variation[own]
        return ImageBatch(
            count, own, indices, random_crops(images, rows[indices], variation, size, self._size), variation
        )

    def loss(self, batch: ImageBatch, number: int, samples: int) -> Tensor:
        """As `Batches` says."""
        network = self._network
        pixels = torch.from_numpy(batch.crops).to(self._device)
        images = jitter_and_normalise(pixels, network.pixel_mean, network.pixel_std, batch.variation)
        shape = batch.count, network.samples_in_training(samples), network.noise_dim
        noise = torch.randn(shape, generator=self._generator, device=self._device)[batch.own]
        truth = self._translation[batch.indices], self._rotation[batch.indices]
        with torch.autocast(self._device.type, torch.bfloat16, enabled=self._bfloat16):
            return self._learner("loss", images, *truth, noise, self._config.loss)


class FeatureBatches:
    """Features of images that were varied in one of a few ways, some numbers left out; for a regressor with a memory.

    Args:
        state: Its network is in training mode.
        network: The same.
        features: Of the images.
        config: The loss, and what fraction of the numbers is left out.
        generator: Of which are left out, on the network's device.
    """

    def __init__(
        self,
        state: TrainingState,
        network: RecallingRegressor,
        features: TrainingFeatures,
        config: TrainConfig,
        *,
        generator: torch.Generator,
    ) -> None:
        self._learner, self._network = state.learner, network
        self._features, self._config, self._generator = features, config, generator
        bfloat16 = uses_bfloat16(config, network.pixel_mean.device)
        self._varied = features.varied(network, state.epoch, config, bfloat16=bfloat16)
        count = len(features.images)
        self._interval = max(_REMEMBERED, count // min(config.batch_size, count) // _REMEMBERED)

    def prepared(self, order: Int64[np.ndarray, "steps b"]) -> Iterable[Int64[np.ndarray, " b"]]:
        """The indices: all else is there."""
        return order

    def loss(self, batch: Int64[np.ndarray, " b"], number: int, samples: int) -> Tensor:
        """As `Batches` says; now and then the memory is made anew with the weights of then."""
        features, c = self._features, self._config
        if number % self._interval == 0:
            remember(self._network, features)
        own = own_part(len(batch))
        feature = _dropped_out(self._varied[batch].float(), c.network.dropout, self._generator)[own]
        indices = batch[own]
        truth = features.translation[indices], features.rotation[indices]
        return self._learner("loss_of_features", feature, *truth, features.hidden(indices), c.loss)


def _dropped_out(feature: Tensor, dropped: float, generator: torch.Generator) -> Tensor:
    """Features (b, f) with a fraction of their numbers left out, the others larger in return."""
    kept = torch.rand(feature.shape, generator=generator, device=feature.device) >= dropped
    return feature * kept / (1.0 - dropped)
