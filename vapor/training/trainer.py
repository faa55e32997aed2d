"""Trainer: a training epoch by epoch, with evaluation on held-out images and reports of progress."""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np
import torch

from vapor.checkpoints.calibration import Calibration
from vapor.evaluation.validation import Validation, validate
from vapor.regressors.base import PoseRegressor
from vapor.training.config import TrainConfig
from vapor.training.epoch import features_for, train_epoch
from vapor.training.holding_out import Split
from vapor.training.memory import VARIANTS, remember
from vapor.training.processes import is_first
from vapor.training.progress import Progress, ProgressCallback
from vapor.training.schedule import evaluation_interval, finishing, step_cost, steps_in_epoch
from vapor.training.state import Saving, TrainingState, share_state
from vapor.training_data.training_set import TrainingSet

_FEWEST = 4  # epochs
_WARM_UP, _TIMED = 3, 8  # steps
_EVALUATION = 0.5  # of the time of a step an image: to evaluate it


class Trainer:
    """A training under way: on the images that are not held out and, once the model was evaluated, on everything.

    Attributes:
        state: Its state.
        config: The configuration, with its number of epochs.
        goes_on: Whether held-out images are learned from once the model was evaluated.
        epochs: Number of epochs, with those after the evaluation, which are a stage of their own in the progress.
        best: Figures of the best epoch so far.
    """

    def __init__(
        self,
        state: TrainingState,
        split: Split,
        config: TrainConfig,
        saving: Saving,
        report: ProgressCallback,
        planned: Plan | None = None,
    ) -> None:
        """Begin or go on; `planned` is how long its epochs will take, None where that is not known."""
        self.state, self.config, self._saving = state, config, saving
        self._planned, self._took_s = planned, 0.0
        more = len(split.everything) > len(split.training)
        self.goes_on = bool(split.held_out_mask.any()) and config.finish > 0 and more
        self.epochs = state.epochs + (finishing(config).known_epochs if self.goes_on else 0)
        self.best = best_epoch(state.history, config)
        self._split, self._report = split, report

    @property
    def images_seen(self) -> int:
        """Number of images in the epochs so far."""
        return sum(len(self._images(epoch)) for epoch in range(self.state.epoch))

    def learn(self) -> PoseRegressor:
        """Learn from images that are not held out; returns the best network, in the first process, to be evaluated."""
        state, evaluated = self.state, self._split.evaluated(self.config.validation_images)
        while state.epoch < state.epochs:
            begin_s = perf_counter()
            loss = self._epoch()
            if is_first():
                self._evaluate(evaluated, loss)
                self._saving.save(state, last=state.epoch == state.epochs)
            self._took_s += perf_counter() - begin_s
        model, features = deepcopy(state.average), features_for(state, self._split.training)
        if is_first():
            model.load_state_dict(state.best or weights_of(self._kept))
            remember(model, features)
        return model

    def finish(self, model: PoseRegressor) -> TrainingSet:
        """Let an evaluated model learn from everything, if that is configured; returns the images it learned from."""
        state, learned = self.state, self._split.everything if self.goes_on else self._split.training
        if self.goes_on and state.epoch == state.epochs:
            for network in (state.network, state.average):
                network.load_state_dict(model.state_dict())
            share_state(state)
        while state.epoch < self.epochs:
            begin_s = perf_counter()
            self._epoch()
            if is_first():
                self._saving.save(state)
            self._took_s += perf_counter() - begin_s
        features = features_for(state, learned)
        if is_first():
            if self.goes_on:
                model.load_state_dict(weights_of(self._kept))
            remember(model, features)
        return learned

    @property
    def _kept(self) -> PoseRegressor:
        """The network whose weights become the model's."""
        return self.state.average if self.config.ema_decay else self.state.network

    def _epoch(self) -> float:
        """Learn from all images once; returns the mean loss."""
        state, begin_s = self.state, perf_counter()
        finished = state.epoch >= state.epochs
        config, since = (finishing(self.config), state.epochs) if finished else (self.config, 0)
        epochs = (self.epochs if finished else state.epochs) - since
        steps, epoch, planned = steps_in_epoch(self._images(state.epoch), config), state.epoch - since, self._planned

        def report(step: int, loss: float) -> None:
            progress = Progress(
                "training on everything" if finished else "training",
                epoch * steps + step,
                epochs * steps,
                epoch=epoch + 1,
                epochs=epochs,
                loss=loss,
                validation=None if finished or not state.history else state.history[-1],
                left_s=None if planned is None else planned.left_s(state.epoch, step / steps, self._took_s),
            )
            self._report(progress)

        loss = train_epoch(state, self._images(state.epoch), config, report, since=since)
        state.epoch += 1
        state.seconds += perf_counter() - begin_s
        return loss

    def _evaluate(self, held_out: TrainingSet, loss: float) -> None:
        """Compare the weights with the best so far, except between two evaluations and while images are small.

        `loss` is the mean loss of the epoch.
        """
        state, config = self.state, self.config
        interval = evaluation_interval(len(self._split.training), len(held_out))
        small = step_cost(config, state.epoch - 1) < 1.0
        if not len(held_out) or small or (state.epoch % interval and state.epoch < state.epochs):
            return
        kept = self._kept
        remember(kept, state.features)
        widths = Calibration(config.bandwidth_translation_m, config.bandwidth_rotation_rad)
        figures = validate(
            kept,
            held_out,
            widths,
            num_samples=config.loss.num_samples,
            seed=config.seed,
            epoch=state.epoch,
            train_loss=loss,
        )
        state.history.append(figures)
        self.best = best_epoch(state.history, config)
        if self.best is figures:
            state.best = weights_of(kept)

    def _images(self, epoch: int) -> TrainingSet:
        return self._split.training if epoch < self.state.epochs else self._split.everything


def best_epoch(history: Sequence[Validation], config: TrainConfig) -> Validation | None:
    """The best epoch so far; of equally good ones the last, as the first ones may all have no image right."""
    return max(reversed(history), key=lambda figures: getattr(figures, config.select_by), default=None)


def weights_of(network: PoseRegressor) -> dict[str, torch.Tensor]:
    """Copies of a network's parameters and statistics on the CPU, by name."""
    return {name: value.detach().cpu().clone() for name, value in network.state_dict().items()}


@dataclass(frozen=True)
class Plan:
    """Seconds that each epoch of a training will take, by the time of some steps; `epochs` come before the finish."""

    epochs: int
    epoch_s: tuple[float, ...]

    @property
    def seconds(self) -> float:
        """Of all epochs."""
        return sum(self.epoch_s)

    def left_s(self, epoch: int, done: float, took_s: float) -> float:
        """Seconds left of the epochs before the finish, or of the finish.

        A fraction of an epoch is done, and those before it, counted from 0, took so long.
        """
        before_s, until = sum(self.epoch_s[:epoch]), self.epochs if epoch < self.epochs else len(self.epoch_s)
        left_s = sum(self.epoch_s[epoch:until]) - done * self.epoch_s[epoch]
        return left_s * (took_s / before_s if before_s else 1.0)


def plan(state: TrainingState, split: Split, evaluated: int, config: TrainConfig) -> Plan:
    """As many epochs as fit into the configured hours, evaluation and finishing included, and what they will take.

    The state before the first step is left as it is. `evaluated` is the number of held-out images of an evaluation.
    """
    trial, training, everything = deepcopy(state), split.training, len(split.everything)
    batch = min(config.batch_size, len(training))
    rows = np.resize(np.arange(len(training)), (_WARM_UP + _TIMED) * batch)
    stamps = [perf_counter()]
    once = replace(config, epochs=1, batch_size=batch, small_images_first=0.0)
    train_epoch(trial, training.select(rows), once, lambda step, loss: stamps.append(perf_counter()))
    per_image = float(np.median(np.diff(stamps[_WARM_UP:]))) / batch
    evaluation = _EVALUATION * evaluated / evaluation_interval(len(training), evaluated)
    extraction = 0.0  # of the features of all images, in one variation
    if trial.features is not None:  # evaluation is quick then
        extraction, evaluation = everything * (stamps[1] - stamps[0]) / (2 * len(rows)), 0.0

    def of(epochs: int) -> Plan:
        known = replace(config, epochs=epochs)
        learning = [per_image * (len(training) * step_cost(known, epoch) + evaluation) for epoch in range(epochs)]
        varied = [extraction * (epoch < VARIANTS) for epoch in range(epochs)]
        count = finishing(known).known_epochs if config.finish > 0 and everything > len(training) else 0
        finish = [per_image * everything] * count
        epoch_s = [sum(parts) for parts in zip(learning, varied, strict=True)] + finish
        epoch_s[0] += extraction  # as they are
        epoch_s[-1] += extraction  # varied, of everything
        return Plan(epochs, tuple(epoch_s))

    found = of(min(_FEWEST, config.most_epochs))
    for epochs in range(found.epochs + 1, config.most_epochs + 1):
        longer = of(epochs)
        if longer.seconds > 3600.0 * config.hours:
            break
        found = longer
    return found
