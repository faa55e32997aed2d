"""One pass over the training images: what every training consists of."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import torch

from vapor.training.batches import Batches, FeatureBatches, ImageBatches
from vapor.training.config import TrainConfig
from vapor.training.ema import update_average
from vapor.training.memory import TrainingFeatures, extract_training_features
from vapor.training.processes import mean_of_all
from vapor.training.schedule import first_epoch_of_size, image_size, learning_rate, samples_per_image, steps_in_epoch
from vapor.training.state import TrainingState
from vapor.training_data.training_set import TrainingError, TrainingSet

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
