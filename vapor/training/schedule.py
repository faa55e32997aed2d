"""Schedules of a training: learning rate, number of samples, image size and evaluation."""

from __future__ import annotations

import math
from dataclasses import replace

from vapor.training.config import TrainConfig
from vapor.training_data.training_set import TrainingSet

_SMALL = (0.4, 0.6)  # of the images' edges, one after the other
_SMALLEST = 32  # pixels of the shorter edge: the backbones have a stride of 32
_DECAY, _MOST_DECAYS = 0.8, 10  # of the rate, where it decays in steps as in the paper
_FINISHING_RATE = 0.3  # of the largest learning rate, when a trained model goes on with more data


def learning_rate(config: TrainConfig, step: int, steps_per_epoch: int) -> float:
    """The learning rate of one step, counted from 0 over the whole training."""
    if config.decay_epochs is not None:
        decays = min(step // steps_per_epoch // config.decay_epochs, _MOST_DECAYS)
        return config.learning_rate * _DECAY**decays
    done = (step + 0.5) / (steps_per_epoch * config.known_epochs)
    if done < config.warmup:
        return config.learning_rate * (1 - math.cos(math.pi * done / config.warmup)) / 2
    return config.learning_rate * (1 + math.cos(math.pi * (done - config.warmup) / (1 - config.warmup))) / 2


def image_size(config: TrainConfig, epoch: int) -> tuple[int, int]:
    """Width and height, pixels, of the images of an epoch, counted from 0; the first epochs may have small images."""
    c, done = config.network, epoch / config.known_epochs
    if done >= config.small_images_first:
        return c.image_width, c.image_height
    edge = _SMALL[int(len(_SMALL) * done / config.small_images_first)]
    edge = max(edge, _SMALLEST / min(c.image_width, c.image_height))
    return round(edge * c.image_width), round(edge * c.image_height)


def step_cost(config: TrainConfig, epoch: int) -> float:
    """Approximate time of a step of an epoch, in steps with whole images; a fifth does not depend on the size."""
    width, height = image_size(config, epoch)
    return 0.2 + 0.8 * width * height / (config.network.image_width * config.network.image_height)


def first_epoch_of_size(config: TrainConfig, epoch: int) -> int:
    """The first of the consecutive epochs up to this one whose images have the same size."""
    size = image_size(config, epoch)
    while epoch > 0 and image_size(config, epoch - 1) == size:
        epoch -= 1
    return epoch


def samples_per_image(config: TrainConfig, step: int, steps_per_epoch: int) -> int:
    """Number of posterior samples per image in a step, counted from 0 over the training: geometric growth, then M."""
    winners, samples = config.loss.num_winners, config.loss.num_samples
    done = step / (steps_per_epoch * config.known_epochs)
    if done >= config.ewta_fraction:
        return samples
    return int(winners * (samples / winners) ** (done / config.ewta_fraction))


def steps_in_epoch(images: TrainingSet, config: TrainConfig) -> int:
    """Number of steps in an epoch, without an incomplete last batch; all images are one batch where they are fewer."""
    return max(len(images) // config.batch_size, 1)


def evaluation_interval(training: int, evaluated: int) -> int:
    """Number of epochs from one evaluation to the next, so that evaluation takes no longer than training."""
    return max(1, math.ceil(evaluated / training))


def finishing(config: TrainConfig) -> TrainConfig:
    """Configuration of the training on everything after the evaluation: fewer epochs, lower rates."""
    epochs = max(1, round(config.finish * config.known_epochs))
    rate = _FINISHING_RATE * config.learning_rate
    return replace(config, epochs=epochs, learning_rate=rate, ewta_fraction=0.0, small_images_first=0.0)
