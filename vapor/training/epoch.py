"""One pass over the training images: what every training consists of."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Int64, UInt8
from torch import Tensor, nn
from torch.optim.swa_utils import get_ema_multi_avg_fn

from vapor.regressors.network_config import regressor_class
from vapor.regressors.retrieval import RecallingRegressor
from vapor.training.augment import Variation, draw_variation, jitter_and_normalise, one_ahead, random_crops
from vapor.training.config import TrainConfig
from vapor.training.memory import TrainingFeatures, extract_training_features, remember
from vapor.training.processes import mean_of_all, own_part
from vapor.training.schedule import first_epoch_of_size, image_size, learning_rate, samples_per_image, steps_in_epoch
from vapor.training.state import TrainingState
from vapor.training_data.training_set import TrainingError, TrainingSet

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


def paired(
    indices: Int64[np.ndarray, " b"], sequence: Int64[np.ndarray, " n"], gap: int, *, rng: np.random.Generator
) -> Int64[np.ndarray, " b"]:
    """The first half of a batch, then for each of it another image of its sequence, at most `gap` images away."""
    first = indices[: len(indices) // 2]
    there = first + rng.choice([-1, 1], len(first)) * rng.integers(1, gap, len(first), endpoint=True)
    outside = (there < 0) | (there >= len(sequence))
    outside |= sequence[np.clip(there, 0, len(sequence) - 1)] != sequence[first]
    there = np.where(outside, 2 * first - there, there)  # on the other side, where there is none on this
    missing = (
        (there < 0) | (there >= len(sequence)) | (sequence[np.clip(there, 0, len(sequence) - 1)] != sequence[first])
    )
    return np.concatenate([first, np.where(missing, first, there)])


def uses_bfloat16(config: TrainConfig, device: torch.device) -> bool:
    """Whether the encoder is trained in bfloat16.

    With "auto" where that is faster than float32: without instructions for it, it is many times slower, and on a CPU
    separable convolutions do not gain by it where they learn.
    """
    if config.precision != "auto":
        return config.precision == "bfloat16"
    if device.type == "cuda":
        return torch.cuda.is_bf16_supported(including_emulation=False)
    if config.network.backbone == "efficientnet-lite0" and not regressor_class(config.network.head).frozen_backbone:
        return False
    capabilities = torch.cpu.get_capabilities()
    return bool(capabilities.get("avx512_bf16") or capabilities.get("amx_bf16"))


StepCallback = Callable[[int, float, float], None]
"""Told after every step how many of this epoch are done, the mean loss so far and the learning rate."""


def train_epoch(
    state: TrainingState, training: TrainingSet, config: TrainConfig, report: StepCallback, *, since: int = 0
) -> float:
    """One pass over the images in random order, an incomplete last batch left out; returns the mean loss.

    Args:
        state: Between two epochs; its weights and its average learn, its count of epochs is left as it is.
        training: The images.
        config: How, with its number of epochs.
        report: Called after every step.
        since: The epoch in which the schedule of learning rates began.

    Raises:
        TrainingError: the loss is not finite.
    """
    network = state.network
    rng = np.random.default_rng([config.seed, state.epoch])
    generator = torch.Generator(network.pixel_mean.device).manual_seed(int(rng.integers(2**62)))
    batch = min(config.batch_size, len(training))
    steps = steps_in_epoch(training, config)
    order = rng.permutation(len(training))[: steps * batch].reshape(steps, batch)
    network.train()
    batches = _batches(state, training, config, image_size(config, state.epoch - since), rng, generator)
    resized = first_epoch_of_size(config, state.epoch - since) * steps  # an average over two sizes suits neither
    total = 0.0
    for number, prepared in enumerate(batches.prepared(order)):
        step = (state.epoch - since) * steps + number
        rate = learning_rate(config, step, steps)
        for group in state.optimizer.param_groups:
            group["lr"] = rate
        loss = batches.loss(prepared, number, samples_per_image(config, step, steps))
        state.optimizer.zero_grad(set_to_none=True)
        loss.backward()
        state.optimizer.step()
        update_average(state.average, network, config.ema_decay, step - resized)
        total += (value := float(mean_of_all(loss.detach())))
        if not math.isfinite(value):
            raise TrainingError(
                f"loss is {value} in epoch {state.epoch + 1}, step {number + 1}, expected a finite number;"
                f" a smaller learning rate than {config.learning_rate} may help"
            )
        report(number + 1, total / (number + 1), rate)
    return total / steps


def _batches(
    state: TrainingState,
    training: TrainingSet,
    config: TrainConfig,
    size: tuple[int, int],
    rng: np.random.Generator,
    generator: torch.Generator,
) -> Batches:
    recalling, features = state.network.recalling, features_for(state, training)
    if recalling is not None and features is not None:
        return FeatureBatches(state, recalling, features, config, generator=generator)
    return ImageBatches(state, training, config, rng=rng, generator=generator, size=size)


def features_for(state: TrainingState, images: TrainingSet) -> TrainingFeatures | None:
    """Features of images, extracted once, for a regressor that recalls images; None for any other."""
    network, average = state.network.recalling, state.average.recalling
    if network is None or average is None:
        return None
    if state.features is None or state.features.images is not images:
        state.features = extract_training_features(network, images, state.features)
        average.standardise_like(network)
    return state.features


@torch.no_grad()
def update_average(average: nn.Module, network: nn.Module, decay: float, step: int) -> None:
    """Move the average towards the weights and BatchNorm statistics; faster in the first steps, which know little.

    Args:
        average: Changed in place.
        network: Of the same shape.
        decay: What is left of the average after a step; 0 leaves the average as it is.
        step: Counted from 0 over the whole training.
    """
    if not decay:
        return
    pairs = list(zip(average.state_dict().values(), network.state_dict().values(), strict=True))
    numbers = [pair for pair in pairs if pair[0].is_floating_point()]
    move = get_ema_multi_avg_fn(min(decay, (1 + step) / (10 + step)))
    move([mine for mine, _ in numbers], [its for _, its in numbers], 0)
    for mine, its in pairs:
        if not mine.is_floating_point():
            mine.copy_(its)
