"""How many epochs fit into the time that a training may take."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import replace
from time import perf_counter

import numpy as np

from vapor.training.config import TrainConfig
from vapor.training.epoch import train_epoch
from vapor.training.holding_out import Split
from vapor.training.memory import VARIANTS
from vapor.training.schedule import evaluation_interval, step_cost
from vapor.training.state import TrainingState

_FEWEST = 4  # epochs
_WARM_UP, _TIMED = 3, 8  # steps
_EVALUATION = 0.5  # of the time of a step an image: to evaluate it


def fitting_epochs(state: TrainingState, split: Split, evaluated: int, config: TrainConfig) -> int:
    """How many epochs fit into the hours that a training may take, evaluation and finishing included.

    Args:
        state: Before the first step; it is left as it is.
        split: What is trained on.
        evaluated: Held-out images that epochs are evaluated on.
        config: How.
    """
    trial, training, most = deepcopy(state), split.training, config.most_epochs
    batch = min(config.batch_size, len(training))
    rows = np.resize(np.arange(len(training)), (_WARM_UP + _TIMED) * batch)
    stamps = [perf_counter()]
    once = replace(config, epochs=1, small_images_first=0.0)
    train_epoch(trial, training.select(rows), once, lambda step, loss, rate: stamps.append(perf_counter()))
    per_image = float(np.median(np.diff(stamps[_WARM_UP:]))) / batch
    more = config.finish * len(split.everything) if len(split.everything) > len(training) else 0.0
    evaluation = _EVALUATION * evaluated / evaluation_interval(len(training), evaluated)
    extraction, epochs = np.zeros(most), np.arange(1, most + 1)
    if trial.features is not None:  # twice of all images, once more for each way in which they are varied
        per_pass = (stamps[1] - stamps[0]) / (2 * len(rows))
        varied = np.minimum(epochs, VARIANTS)
        extraction, evaluation = per_pass * len(split.everything) * (2 + varied), 0.0  # which is quick then
    spared = np.array([_spared(replace(config, epochs=n)) for n in range(1, most + 1)]) * len(training)
    seconds = extraction + per_image * (epochs * (len(training) + more + evaluation) - spared)
    return max(min(_FEWEST, most), int((seconds <= 3600.0 * config.hours).sum()))


def _spared(config: TrainConfig) -> float:
    """How many epochs less a training takes because its first images are small."""
    return sum(1.0 - step_cost(config, epoch) for epoch in range(config.known_epochs))
