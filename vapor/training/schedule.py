"""What changes over a training: learning rate and number of samples, and how often the network is evaluated."""

from __future__ import annotations

import math
from dataclasses import replace

from vapor.training.config import TrainConfig
from vapor.training_data.training_set import TrainingSet

_FINISHING_RATE = 0.3  # of the largest learning rate, when a trained model goes on with more data


def learning_rate(config: TrainConfig, step: int, steps_per_epoch: int) -> float:
    """The learning rate of one step, counted from 0 over the whole training."""
    if config.schedule == "steps":
        decays = min(step // steps_per_epoch // config.decay_epochs, config.decay_times)
        return config.learning_rate * config.decay_factor**decays
    done = (step + 0.5) / (steps_per_epoch * config.known_epochs)
    if done < config.warmup:
        return config.learning_rate * (1 - math.cos(math.pi * done / config.warmup)) / 2
    return config.learning_rate * (1 + math.cos(math.pi * (done - config.warmup) / (1 - config.warmup))) / 2


def samples_per_image(config: TrainConfig, step: int, steps_per_epoch: int) -> int:
    """Posterior samples per image of one step, counted from 0 over the whole training: geometric growth, then M."""
    winners, samples = config.loss.num_winners, config.loss.num_samples
    done = step / (steps_per_epoch * config.known_epochs)
    if done >= config.ewta_fraction:
        return samples
    return int(winners * (samples / winners) ** (done / config.ewta_fraction))


def steps_in_epoch(images: TrainingSet, config: TrainConfig) -> int:
    """An incomplete last batch is left out; where there are fewer images than a batch, they are one."""
    return max(len(images) // config.batch_size, 1)


def evaluation_interval(training: int, evaluated: int) -> int:
    """Epochs from one evaluation to the next: of more images than are trained on it would take longer than an epoch."""
    return max(1, math.ceil(evaluated / training))


def finishing(config: TrainConfig) -> TrainConfig:
    """How a model that was evaluated goes on with everything: fewer epochs, lower rates."""
    epochs = max(1, round(config.finish * config.known_epochs))
    return replace(config, epochs=epochs, learning_rate=_FINISHING_RATE * config.learning_rate, ewta_fraction=0.0)
