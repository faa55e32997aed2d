"""One pass over the training images: what every training consists of."""

from __future__ import annotations

import math
from collections.abc import Callable
from copy import deepcopy
from dataclasses import replace
from time import perf_counter

import numpy as np
import torch
from jaxtyping import Int64
from torch import Tensor
from torch.optim.swa_utils import get_ema_multi_avg_fn

from vapor.regressors.loss import retrieval_loss, training_loss
from vapor.regressors.retrieval import RetrievalRegressor
from vapor.training.augment import jitter_and_normalise, random_crops
from vapor.training.config import TrainConfig, learning_rate, samples_per_image
from vapor.training.holding_out import Split
from vapor.training.memory import VARIANTS, Seen, look, remember
from vapor.training.state import TrainingState
from vapor.training_data.training_set import TrainingError, TrainingSet

StepCallback = Callable[[int, float, float], None]
"""Told after every step how many of this epoch are done, the mean loss so far and the learning rate."""

_FINISHING_RATE = 0.3  # of the largest learning rate, when a trained model goes on with more data
_FEWEST = 4  # epochs
_WARM_UP, _TIMED = 3, 8  # steps
_SEEN = 0.5  # of the time of a step an image: to judge by it
_REMEMBERED = 32  # steps from one to the next time that all images are remembered anew, at least


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
    network, device = state.network, state.network.pixel_mean.device
    rng = np.random.default_rng([config.seed, state.epoch])
    generator = torch.Generator(device).manual_seed(int(rng.integers(2**62)))
    batch = min(config.batch_size, len(training))
    steps = steps_per_epoch(training, config)
    order = rng.permutation(len(training))[: steps * batch].reshape(steps, batch)
    true_translation = torch.from_numpy(training.poses.translation).float().to(device)
    true_rotation = torch.from_numpy(training.poses.rotation).float().to(device)
    bfloat16 = _uses_bfloat16(config, device)
    network.train()
    seen, interval = see(state, training), max(_REMEMBERED, len(training) // batch // _REMEMBERED)
    varied = None
    if seen is not None and isinstance(network, RetrievalRegressor):
        varied = seen.varied(network, state.epoch, config, bfloat16=bfloat16)
    total = 0.0
    for number, indices in enumerate(order):
        if config.loss.relative > 0.0:
            indices = _paired(indices, training.sequence, config.loss.pair_gap, rng=rng)
        step = (state.epoch - since) * steps + number
        rate = learning_rate(config, step, steps)
        for group in state.optimizer.param_groups:
            group["lr"] = rate
        truth = true_translation[indices], true_rotation[indices]
        if seen is not None and varied is not None and isinstance(network, RetrievalRegressor):
            if number % interval == 0:
                remember(network, seen)
            feature = _dropped_out(varied[indices].float(), config.network.dropout, generator)
            loss = retrieval_loss(network, feature, *truth, seen.hidden(indices), config.loss)
        else:
            size = config.network.image_width, config.network.image_height
            crops = random_crops(training.images, training.rows[indices], *size, config.augment, rng=rng)
            pixels = torch.from_numpy(crops).to(device)
            images = jitter_and_normalise(pixels, network.pixel_mean, network.pixel_std, config.augment, rng=rng)
            samples = samples_per_image(config, step, steps) if config.network.head == "variational" else 1
            shape = len(indices), samples, network.noise_dim
            noise = torch.randn(shape, generator=generator, device=device)
            with torch.autocast(device.type, torch.bfloat16, enabled=bfloat16):
                loss = training_loss(network, images, *truth, noise, config.loss)
        state.optimizer.zero_grad(set_to_none=True)
        loss.total.backward()
        state.optimizer.step()
        _update_average(state, config.average, step)
        total += (value := float(loss.total.detach()))
        if not math.isfinite(value):
            raise TrainingError(
                f"loss is {value} in epoch {state.epoch + 1}, step {number + 1}, expected a finite number;"
                f" a smaller learning rate than {config.learning_rate} may help"
            )
        report(number + 1, total / (number + 1), rate)
    return total / steps


def see(state: TrainingState, images: TrainingSet) -> Seen | None:
    """Images as a retrieval regressor sees them, found once; None for one that remembers nothing."""
    if not isinstance(state.network, RetrievalRegressor):
        return None
    if state.seen is None or state.seen.images is not images:
        state.seen = look(state.network, images, state.seen)
        for name in ("centre", "spread"):
            getattr(state.average, name).copy_(getattr(state.network, name))
    return state.seen


def steps_per_epoch(images: TrainingSet, config: TrainConfig) -> int:
    """An incomplete last batch is left out; where there are fewer images than a batch, they are one."""
    return max(len(images) // config.batch_size, 1)


def judging_interval(training: int, judged: int) -> int:
    """Epochs from one comparison to the next: where fewer images are trained on than judged, it would take longer."""
    return max(1, math.ceil(judged / training))


def finishing(config: TrainConfig) -> TrainConfig:
    """How a model that was judged goes on with everything: fewer epochs, lower rates."""
    epochs = max(1, round(config.finish * config.known_epochs))
    return replace(config, epochs=epochs, learning_rate=_FINISHING_RATE * config.learning_rate, evolve=0.0)


def fitting_epochs(state: TrainingState, split: Split, judged: int, config: TrainConfig) -> int:
    """How many epochs fit into the hours that a training may take, judging and finishing included.

    Args:
        state: Before the first step; it is left as it is.
        split: What is trained on.
        judged: Held-out images by which epochs are judged.
        config: How.
    """
    trial, training, most = deepcopy(state), split.training, config.most_epochs
    batch = min(config.batch_size, len(training))
    rows = np.resize(np.arange(len(training)), (_WARM_UP + _TIMED) * batch)
    stamps = [perf_counter()]
    once = replace(config, epochs=1)
    train_epoch(trial, training.select(rows), once, lambda step, loss, rate: stamps.append(perf_counter()))
    per_image = float(np.median(np.diff(stamps[_WARM_UP:]))) / batch
    more = config.finish * len(split.everything) if len(split.everything) > len(training) else 0.0
    judging = _SEEN * judged / judging_interval(len(training), judged)
    looks = np.zeros(most)
    if trial.seen is not None:  # twice at all images, once more for each way in which they are varied; judging is quick
        per_look = (stamps[1] - stamps[0]) / (2 * len(rows))
        varied = np.minimum(np.arange(1, most + 1), VARIANTS)
        looks, judging = per_look * len(split.everything) * (2 + varied), 0.0
    seconds = looks + np.arange(1, most + 1) * per_image * (len(training) + more + judging)
    return max(min(_FEWEST, most), int((seconds <= 3600.0 * config.hours).sum()))


def _paired(
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


def _uses_bfloat16(config: TrainConfig, device: torch.device) -> bool:
    """Whether the encoder is trained in bfloat16.

    With "auto" where that is faster than float32: without instructions for it, it is many times slower, and on a CPU
    separable convolutions do not gain by it where they learn.
    """
    if config.precision != "auto":
        return config.precision == "bfloat16"
    if device.type == "cuda":
        return torch.cuda.is_bf16_supported(including_emulation=False)
    if config.network.backbone == "efficientnet-lite0" and config.network.head != "retrieval":
        return False
    capabilities = torch.cpu.get_capabilities()
    return bool(capabilities.get("avx512_bf16") or capabilities.get("amx_bf16"))


def _dropped_out(feature: Tensor, share: float, generator: torch.Generator) -> Tensor:
    """Features (b, f) with a share of their numbers left out, the others larger in return."""
    kept = torch.rand(feature.shape, generator=generator, device=feature.device) >= share
    return feature * kept / (1.0 - share)


@torch.no_grad()
def _update_average(state: TrainingState, decay: float, step: int) -> None:
    """Move the average towards the weights and BatchNorm statistics; faster in the first steps, which know little."""
    if not decay:
        return
    pairs = list(zip(state.average.state_dict().values(), state.network.state_dict().values(), strict=True))
    numbers = [pair for pair in pairs if pair[0].is_floating_point()]
    move = get_ema_multi_avg_fn(min(decay, (1 + step) / (10 + step)))
    move([mine for mine, _ in numbers], [its for _, its in numbers], 0)
    for mine, its in pairs:
        if not mine.is_floating_point():
            mine.copy_(its)
