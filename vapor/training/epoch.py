"""One pass over the training images: batches, their losses, and the steps that follow from them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence

import numpy as np
import torch
from jaxtyping import Int64, UInt8
from torch import Tensor
from torch.optim.swa_utils import get_ema_multi_avg_fn

from vapor.regressors.base import PoseRegressor
from vapor.regressors.network_config import regressor_class
from vapor.regressors.retrieval import RetrievalRegressor
from vapor.training.augment import Variation, draw_variation, jitter_and_normalise, one_ahead, random_crops
from vapor.training.config import TrainConfig
from vapor.training.memory import TrainingFeatures, extract_training_features, remember
from vapor.training.processes import mean_of_all, own_part
from vapor.training.schedule import first_epoch_of_size, image_size, learning_rate, samples_per_image, steps_in_epoch
from vapor.training.state import TrainingState
from vapor.training_data.training_set import TrainingError, TrainingSet

_REMEMBERED = 32  # steps between two updates of the memory of all images, at least

StepCallback = Callable[[int, float], None]
"""Called after every step with the number of steps of this epoch and the mean loss so far."""
_Order = Int64[np.ndarray, "steps b"]


def train_epoch(
    state: TrainingState, training: TrainingSet, config: TrainConfig, report: StepCallback, *, since: int = 0
) -> float:
    """One pass over the images in random order, without an incomplete last batch; returns the mean loss.

    Args:
        state: State between two epochs. Weights and average change, the count of epochs does not.
        training: The images.
        config: The configuration, with its number of epochs.
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
    epoch = state.epoch - since
    recalling, features = network.recalling, features_for(state, training)
    if recalling is not None and features is not None:
        losses = _losses_of_features(state, recalling, features, config, order, generator)
    else:
        losses = _losses_of_images(state, training, config, order, epoch * steps, rng, generator)
    resized = first_epoch_of_size(config, epoch) * steps  # an average over two sizes suits neither
    pairs, total = averaged(state.average, network), 0.0
    for number, loss in enumerate(losses):
        step = epoch * steps + number
        rate = learning_rate(config, step, steps)
        for group in state.optimizer.param_groups:
            group["lr"] = rate
        state.optimizer.zero_grad(set_to_none=True)
        loss.backward()
        state.optimizer.step()
        update_average(pairs, config.ema_decay, step - resized)
        total += (value := float(mean_of_all(loss.detach())))
        if not math.isfinite(value):
            raise TrainingError(
                f"loss is {value} in epoch {state.epoch + 1}, step {number + 1}, expected a finite number;"
                f" a smaller learning rate than {config.learning_rate} may help"
            )
        report(number + 1, total / (number + 1))
    return total / steps


def features_for(state: TrainingState, images: TrainingSet) -> TrainingFeatures | None:
    """Features of images, extracted once, for a regressor that recalls images; None for other regressors."""
    network, average = state.network.recalling, state.average.recalling
    if network is None or average is None:
        return None
    if state.features is None or state.features.images is not images:
        state.features = extract_training_features(network, images, state.features)
        average.standardise_like(network)
    return state.features


def _losses_of_images(
    state: TrainingState,
    training: TrainingSet,
    config: TrainConfig,
    order: _Order,
    first_step: int,
    rng: np.random.Generator,
    generator: torch.Generator,
) -> Iterator[Tensor]:
    """Losses of this process' part of each batch of crops, which is prepared while the previous one is learned from."""
    network, images, pairs = state.network, training.images, config.loss.relative > 0.0
    device = network.pixel_mean.device
    translation = torch.from_numpy(training.poses.translation).float().to(device)
    rotation = torch.from_numpy(training.poses.rotation).float().to(device)
    bfloat16 = uses_bfloat16(config, device)
    size = config.network.image_width, config.network.image_height
    spare = images.shape[1] - size[1], images.shape[2] - size[0]
    shrunk = image_size(config, first_step // len(order))

    def prepare(
        indices: Int64[np.ndarray, " b"],
    ) -> tuple[Int64[np.ndarray, " k"], Int64[np.ndarray, " k"], UInt8[np.ndarray, "k h w 3"], Variation]:
        if pairs:
            indices = paired(indices, training.sequence, config.loss.pair_gap, rng=rng)
        variation = draw_variation(config.augment, len(indices), spare, rng=rng)
        own = own_part(len(indices), pairs=pairs)
        indices, variation = indices[own], variation[own]
        return own, indices, random_crops(images, training.rows[indices], variation, size, shrunk), variation

    for number, (own, indices, crops, variation) in enumerate(one_ahead(prepare, order)):
        pixels = torch.from_numpy(crops).to(device)
        normalised = jitter_and_normalise(pixels, network.pixel_mean, network.pixel_std, variation)
        samples = network.samples_in_training(samples_per_image(config, first_step + number, len(order)))
        count = order.shape[1] // 2 * 2 if pairs else order.shape[1]
        noise = torch.randn((count, samples, network.noise_dim), generator=generator, device=device)[own]
        with torch.autocast(device.type, torch.bfloat16, enabled=bfloat16):
            loss = state.learner("loss", normalised, translation[indices], rotation[indices], noise, config.loss)
        yield loss  # backward and the step of the optimiser are not in autocast


def _losses_of_features(
    state: TrainingState,
    network: RetrievalRegressor,
    features: TrainingFeatures,
    config: TrainConfig,
    order: _Order,
    generator: torch.Generator,
) -> Iterator[Tensor]:
    """Losses of this process' part of each batch of features after dropout; the memory is renewed at intervals."""
    device, dropout = network.pixel_mean.device, config.network.dropout
    varied = features.varied(network, state.epoch, config, bfloat16=uses_bfloat16(config, device))
    count = len(features.images)
    interval = max(_REMEMBERED, count // min(config.batch_size, count) // _REMEMBERED)
    for number, batch in enumerate(order):
        if number % interval == 0:
            remember(network, features)
        own = own_part(len(batch))
        feature = varied[batch].float()
        kept = torch.rand(feature.shape, generator=generator, device=device) >= dropout
        feature, indices = (feature * kept / (1.0 - dropout))[own], batch[own]
        truth = features.translation[indices], features.rotation[indices]
        yield state.learner("loss_of_features", feature, *truth, features.hidden(indices))


def paired(
    indices: Int64[np.ndarray, " b"], sequence: Int64[np.ndarray, " n"], gap: int, *, rng: np.random.Generator
) -> Int64[np.ndarray, " b"]:
    """The first half of a batch, then a partner for each: an image of its sequence, at most `gap` images away."""
    first = indices[: len(indices) // 2]

    def missing(there: Int64[np.ndarray, " h"]) -> np.ndarray:
        outside = (there < 0) | (there >= len(sequence))
        return outside | (sequence[np.clip(there, 0, len(sequence) - 1)] != sequence[first])

    there = first + rng.choice([-1, 1], len(first)) * rng.integers(1, gap, len(first), endpoint=True)
    there = np.where(missing(there), 2 * first - there, there)  # on the other side of the first image
    return np.concatenate([first, np.where(missing(there), first, there)])


def uses_bfloat16(config: TrainConfig, device: torch.device) -> bool:
    """Whether the encoder is trained in bfloat16.

    "auto" takes it where it is faster: with instructions for it, except for separable convolutions that learn on a CPU.
    """
    if config.precision != "auto":
        return config.precision == "bfloat16"
    if device.type == "cuda":
        return torch.cuda.is_bf16_supported(including_emulation=False)
    if config.network.backbone == "efficientnet-lite0" and not regressor_class(config.network.head).frozen_backbone:
        return False
    capabilities = getattr(torch.cpu, "get_capabilities", dict)()  # torch 2.6 does not tell: then float32
    return bool(capabilities.get("avx512_bf16") or capabilities.get("amx_bf16"))


def averaged(average: PoseRegressor, network: PoseRegressor) -> list[tuple[Tensor, Tensor]]:
    """Weights and BatchNorm statistics of an average and of its network, but of a backbone that never learns."""
    mine, its = average.state_dict(), network.state_dict()
    return [(mine[name], its[name]) for name in mine if not (network.frozen_backbone and name.startswith("backbone."))]


@torch.no_grad()
def update_average(pairs: Sequence[tuple[Tensor, Tensor]], decay: float, step: int) -> None:
    """Move an average towards its network, pairs from `averaged`; faster in the first steps of a training.

    `decay` is the weight of the old average; with 0 there is no average, and nothing is done.
    """
    if not decay:
        return
    numbers = [pair for pair in pairs if pair[0].is_floating_point()]
    move = get_ema_multi_avg_fn(min(decay, (1 + step) / (10 + step)))
    move([mine for mine, _ in numbers], [its for _, its in numbers], 0)
    for mine, its in pairs:
        if not mine.is_floating_point():
            mine.copy_(its)
