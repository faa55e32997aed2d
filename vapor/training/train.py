"""Training of the variational pose regressor: one loop."""

from __future__ import annotations

import json
import zlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from copy import deepcopy
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Any, Literal

import numpy as np
import torch
from torch import Tensor

from filtering.se3 import Poses
from sequences.frame import Frame
from sequences.options import SequenceOptions
from vapor.calibration.calibrate import CalibrationResult, calibrate
from vapor.calibration.familiarity import EXEMPLARS, learn_familiarity
from vapor.checkpoints.calibration import Calibration
from vapor.checkpoints.checkpoint import Checkpoint
from vapor.checkpoints.file_format import save_checkpoint
from vapor.checkpoints.scene_scale import default_errors
from vapor.checkpoints.thinning import MAX_PRIOR_POSES, spaced
from vapor.evaluation.validation import Validation, predict, validate
from vapor.regressors.base import PoseRegressor, SceneBox
from vapor.regressors.familiarity import Familiarity
from vapor.regressors.retrieval import RetrievalRegressor, memory_of
from vapor.training.check import TrainingCheck, check
from vapor.training.config import TrainConfig
from vapor.training.epoch import finishing, fitting_epochs, judging_interval, see, steps_per_epoch, train_epoch
from vapor.training.holding_out import Split, hold_out, within_map
from vapor.training.memory import VARIANTS, described, remember
from vapor.training.start import initial_model, start
from vapor.training.state import TrainingState, load_state, save_state, state_path
from vapor.training_data.checks import require_variety, too_few
from vapor.training_data.entries import open_sequences
from vapor.training_data.leakage import require_no_leakage
from vapor.training_data.load import load_training_set
from vapor.training_data.training_set import TrainingError, TrainingSet


@dataclass(frozen=True)
class Progress:
    """Where a training stands.

    Attributes:
        stage: "reading" of images, "holding out" of some, "training", "calibrating", "checking" or "training
            on everything".
        done: Images read or held out, steps done since the training's start, interrupted or not, or held-out images
            seen.
        total: Steps or images in all; None while reading.
        epoch: The current epoch, from 1.
        epochs: Of so many.
        loss: Mean training loss of this epoch so far.
        learning_rate: Of the last step.
        seconds: Of training since its start, interrupted or not, reading and judging left out.
        left_s: Of training still to come, about.
        validation: Figures of the last epoch judged.
        best: Figures of the best epoch.
        notes: What was held out and why, told once before the first step.
    """

    stage: Literal["reading", "holding out", "training", "calibrating", "checking", "training on everything"]
    done: int
    total: int | None = None
    epoch: int = 0
    epochs: int = 0
    loss: float | None = None
    learning_rate: float | None = None
    seconds: float = 0.0
    left_s: float = 0.0
    validation: Validation | None = None
    best: Validation | None = None
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class TrainResult:
    """A finished training.

    Attributes:
        checkpoint: The model that was written.
        history: Figures of every epoch judged.
        best: Figures of the epoch that was kept; None without held-out images.
        seconds: Of training since its start, interrupted or not, reading and judging left out.
        images_seen: Likewise.
        calibration: What was calibrated at the end, and what that gained; None where it was not asked for.
        check: The filter on the held-out passes; None without any, or without odometry through them.
        skipped: Images and poses of all data that were left out in reading, by reason.
        notices: What a person should know of the data.
    """

    checkpoint: Checkpoint
    history: tuple[Validation, ...]
    best: Validation | None
    seconds: float
    images_seen: int
    calibration: CalibrationResult | None = None
    check: TrainingCheck | None = None
    skipped: Mapping[str, int] = field(default_factory=dict)
    notices: tuple[str, ...] = ()


ProgressCallback = Callable[[Progress], None]


def train(
    data: Sequence[Path | str],
    output: Path,
    config: TrainConfig,
    *,
    validation: Sequence[Path | str] = (),
    reading: SequenceOptions | None = None,
    progress: ProgressCallback | None = None,
) -> TrainResult:
    """Train on files and folders, and write the model.

    Args:
        data: Whatever `posed_frames` reads; `PATH@START:STOP` takes those frames of it only.
        output: The model file.
        config: How.
        validation: Held-out data, likewise, with no image of the former, of which those images count whose surroundings
            training images show; without it passes over ground that others cover are held out, and no two of the data
            may share images.
        reading: What to read of MCAP sequences, of both; None for all of it, as found.
        progress: Called after every image read and every step.

    Raises:
        TrainingError: unusable data or configuration, or a loss that is not finite.
        SequenceError: unreadable data.
        CheckpointError: an interrupted training of another configuration.
    """
    if validation or config.validation_share > 0:
        require_no_leakage(data, validation or None)
    odometry = "optional" if config.calibrate else "unread"  # which nothing else asks for
    held_out = open_sequences(validation, reading, odometry)
    return train_on(open_sequences(data, reading, odometry), output, config, validation=held_out, progress=progress)


def train_on(
    sequences: Mapping[str, Iterable[Frame]],
    output: Path,
    config: TrainConfig,
    *,
    validation: Mapping[str, Iterable[Frame]] | None = None,
    progress: ProgressCallback | None = None,
) -> TrainResult:
    """Train on frames by the name of their sequence; else as `train`."""
    output = Path(output)
    initial = _checked_start(output, config)
    report = progress or (lambda _: None)
    central = config.augment.crop == "central"

    loaded = load_training_set(
        sequences,
        lambda width, height: config.network_for(width, height).frame_size,
        central=central,
        progress=lambda n: report(Progress("reading", n)),
    )
    config = replace(config, network=config.network_for(*loaded.camera_size), aspect="network")
    frame = config.network.frame_size
    held_out = load_training_set(validation, frame, central=central, camera=loaded.camera) if validation else None
    names = {"data": list(sequences), "validation_data": list(validation or ())}
    return _train(loaded, held_out, names, output, config, initial, report)


def train_on_images(images: TrainingSet, names: Sequence[str], output: Path, config: TrainConfig) -> TrainResult:
    """Train on images that were read before, for many trainings on the same; some of them are held out as configured.

    Args:
        images: From `load_training_set`, for the configured frame size and crop.
        names: Of their sequences, for the model file.
        output: The model file.
        config: How.

    Raises:
        TrainingError: unusable images or configuration, or a loss that is not finite.
        CheckpointError: an interrupted training of another configuration.
    """
    initial = _checked_start(output, config)
    (width, height), found = config.network.frame_size, images.images.shape[1:3]
    central = config.augment.crop == "central"
    if found != (height, width) if central else (found[0] < height or found[1] < width):
        size, least = f"{found[1]} x {found[0]}", "" if central else "at least "
        raise TrainingError(f"images are {size} pixels, expected {least}{width} x {height} as the network's frame")
    if not 1 <= len(names) <= (count := len(np.unique(images.sequence))):
        raise TrainingError(f"{len(names)} names of files and folders with {count} sequences, expected 1 to {count}")
    named = {"data": list(names), "validation_data": []}
    return _train(images, None, named, output, config, initial, lambda _: None)


def _checked_start(output: Path, config: TrainConfig) -> Checkpoint | None:
    """The model to start from, if any; raises what would otherwise be told after reading or hours of training."""
    if not output.parent.is_dir():
        raise TrainingError(f"{output}: cannot be written, expected the folder {output.parent} to exist")
    if output.is_dir():
        raise TrainingError(f"{output}: is a folder, expected the name of a model file to write")
    return initial_model(config)


def _train(
    loaded: TrainingSet,
    held_out: TrainingSet | None,
    names: dict[str, Any],
    output: Path,
    config: TrainConfig,
    initial: Checkpoint | None,
    report: ProgressCallback,
) -> TrainResult:
    if len(loaded) < 2:
        raise TrainingError(f"{', '.join(names['data'])}: {len(loaded)} training images, expected at least 2")
    try:
        require_variety(loaded)
    except TrainingError as error:
        raise TrainingError(f"{', '.join(names['data'])}: {error}") from error
    split = hold_out(loaded, config.validation_share) if held_out is None else within_map(loaded, held_out)
    training, notices = split.training, initial.notices if initial else ()
    box = SceneBox.around(split.everything.poses)
    state = start(config, box.union(initial.box) if initial else box, training.poses, initial)
    result = _fit(state, split, names, output, config, report)
    return replace(result, notices=(*notices, *result.notices))


def _fit(
    state: TrainingState,
    split: Split,
    names: dict[str, Any],
    output: Path,
    config: TrainConfig,
    report: ProgressCallback,
) -> TrainResult:
    judged = split.held_out.select(spaced(len(split.held_out), config.validation_images))
    poses = zlib.crc32(split.training.poses.as_matrix().tobytes())
    identity = {**names, "images": len(split.training), "poses": poses, "held_out": len(judged), **_settings(config)}
    resumed = config.resume and state_path(output).exists()
    told = load_state(state_path(output), state, identity) if resumed else ()
    report(Progress("holding out", len(split.held_out), notes=(*told, *split.notes)))
    state.epochs = state.epochs or config.epochs or fitting_epochs(state, split, len(judged), config)
    course = _Course(state, split, replace(config, epochs=state.epochs), report)

    while state.epoch < state.epochs:
        course.judge(judged, course.epoch())
        save_state(state_path(output), state, identity)
    model = deepcopy(state.average)
    model.load_state_dict(state.best or _weights(course.kept))
    remember(model, see(state, split.training))
    found = _found(model, split, judged, config, lambda *where: report(Progress(*where, best=course.best)))

    if course.goes_on and state.epoch == state.epochs:
        for network in (state.network, state.average):
            network.load_state_dict(model.state_dict())
    while state.epoch < course.epochs:
        course.epoch()
        save_state(state_path(output), state, identity)
    if course.goes_on:
        model.load_state_dict(_weights(course.kept))
    learned = split.everything if course.goes_on else split.training
    remember(model, see(state, learned))
    familiarity = _familiar(model, split.training, judged) if config.calibrate else None
    checkpoint = Checkpoint(
        config.network,
        state.network.box,
        found.calibration,
        _prior_poses(model, learned, config.seed),
        _weights(model),
        json.loads(
            json.dumps(
                {
                    **names,
                    "training_images": len(learned),
                    "images_seen": course.images_seen(state.epoch),
                    "seed": config.seed,
                    "config": _settings(course.config),
                    "selected_by": config.select_by if course.best else "last epoch",
                    "validation": asdict(course.best) if course.best else None,
                    "holding_out": list(split.notes),
                    **found.provenance,
                }
            )
        ),
        familiarity,
        split.training.camera,
        memory_of(model),
    )
    save_checkpoint(output, checkpoint, store_float16=config.half)
    state_path(output).unlink(missing_ok=True)
    apart = split.held_out.images is not split.training.images
    skipped, notices = split.training.skipped, split.training.notices
    return TrainResult(
        checkpoint,
        tuple(state.history),
        course.best,
        state.seconds,
        course.images_seen(state.epoch),
        found.calibrated,
        found.check,
        skipped + split.held_out.skipped if apart else skipped,
        (*notices, *(split.held_out.notices if apart else ()), *too_few(split.everything)),
    )


class _Course:
    """A training under way: first on what is not held out, then, once the model was judged, on everything.

    Attributes:
        state: Where it stands.
        config: With its number of epochs.
        goes_on: Whether there is more to learn from once the model was judged.
        epochs: In all.
        best: Figures of the best epoch so far.
    """

    def __init__(self, state: TrainingState, split: Split, config: TrainConfig, report: ProgressCallback) -> None:
        self.state, self.config = state, config
        self.goes_on = bool(split.judged.any()) and config.finish > 0 and len(split.everything) > len(split.training)
        self.epochs = state.epochs + (finishing(config).known_epochs if self.goes_on else 0)
        self.best = _best(state.history, config)
        self._split, self._report = split, report
        self._per_step_s = 0.0  # of the last steps
        self._judged: Tensor | None = None  # what a backbone that does not learn says of the images judged by

    @property
    def kept(self) -> PoseRegressor:
        """The network whose weights are kept."""
        return self.state.average if self.config.average else self.state.network

    def images_seen(self, epochs: int) -> int:
        """How many images were seen when so many epochs were done."""
        return sum(len(self._images(epoch)) for epoch in range(epochs))

    def epoch(self) -> float:
        """Learn from all images once; returns the mean loss."""
        state, seconds_before, begin_s = self.state, self.state.seconds, perf_counter() - self.state.seconds
        judged = state.epoch < state.epochs
        config, since = (self.config, 0) if judged else (finishing(self.config), state.epochs)
        steps = [steps_per_epoch(self._images(epoch), config) for epoch in range(self.epochs)]
        before = sum(steps[: state.epoch])
        looks = 1 if state.seen is not None else 2  # at all images: as they are, and varied in this epoch's way
        first_s = 0.0

        def report(step: int, loss: float, rate: float) -> None:
            nonlocal first_s
            seconds, done = perf_counter() - begin_s, before + step
            if step == 1:
                first_s = seconds
                self._per_step_s = self._per_step_s or seconds / done
            else:
                self._per_step_s = (seconds - first_s) / (step - 1)
            left_s = self._per_step_s * (sum(steps) - done)
            if state.seen is not None:
                left_s += (first_s - seconds_before) / looks * max(min(VARIANTS, state.epochs) - state.epoch - 1, 0)
            self._report(
                Progress(
                    "training" if judged else "training on everything",
                    done,
                    sum(steps),
                    epoch=state.epoch + 1,
                    epochs=self.epochs,
                    loss=loss,
                    learning_rate=rate,
                    seconds=seconds,
                    left_s=left_s,
                    validation=state.history[-1] if state.history else None,
                    best=self.best,
                )
            )

        loss = train_epoch(state, self._images(state.epoch), config, report, since=since)
        state.epoch += 1
        state.seconds = perf_counter() - begin_s
        return loss

    def judge(self, judged: TrainingSet, loss: float) -> None:
        """Compare the weights with the best so far, now and then; mean loss of the epoch as given."""
        state, config = self.state, self.config
        interval = judging_interval(len(self._split.training), len(judged))
        if not len(judged) or (state.epoch % interval and state.epoch < state.epochs):
            return
        kept = self.kept
        remember(kept, state.seen)
        if self._judged is None and isinstance(kept, RetrievalRegressor):
            self._judged = described(kept, judged)
        widths = Calibration(config.bandwidth_translation_m, config.bandwidth_rotation_rad)
        figures = validate(
            kept,
            judged,
            widths,
            num_samples=config.loss.num_samples,
            seed=config.seed,
            epoch=state.epoch,
            train_loss=loss,
            feature=self._judged,
        )
        state.history.append(figures)
        self.best = _best(state.history, config)
        if self.best is figures:
            state.best = _weights(kept)

    def _images(self, epoch: int) -> TrainingSet:
        return self._split.training if epoch < self.state.epochs else self._split.everything


@dataclass(frozen=True)
class _Found:
    """What held-out images say of a model."""

    calibration: Calibration
    calibrated: CalibrationResult | None = None
    check: TrainingCheck | None = None

    @property
    def provenance(self) -> dict[str, Any]:
        """For the model file."""
        if self.calibrated is None:
            return {}
        return {"calibration": self.calibrated.provenance, "check": self.check.as_json if self.check else None}


def _found(
    model: PoseRegressor,
    split: Split,
    judged: TrainingSet,
    config: TrainConfig,
    advance: Callable[[Literal["calibrating", "checking"], int, int], None],
) -> _Found:
    prior_poses = _prior_poses(model, split.training, config.seed)
    widths = config.bandwidth_translation_m, config.bandwidth_rotation_rad
    calibration = Calibration(*widths, default_errors(prior_poses))
    if not config.calibrate:
        return _Found(calibration)
    familiarity = _familiar(model, split.training, judged)
    calibrated = calibrate(
        model,
        split.held_out,
        prior_poses,
        calibration,
        training=split.training,
        familiarity=familiarity,
        max_images=config.validation_images,
        seed=config.seed,
        advance=partial(advance, "calibrating"),
    )
    checked, calibration = check(
        model,
        split.source,
        split.judged,
        calibrated,
        familiarity,
        prior_poses,
        seed=config.seed,
        advance=partial(advance, "checking"),
    )
    return _Found(calibration, calibrated, checked)


def _familiar(model: PoseRegressor, training: TrainingSet, judged: TrainingSet) -> Familiarity | None:
    return learn_familiarity(model, training.select(spaced(len(training), EXEMPLARS)), judged)


def _best(history: Sequence[Validation], config: TrainConfig) -> Validation | None:
    """The best epoch so far, of equally good ones the last: at first none may be good at all."""
    return max(reversed(history), key=lambda figures: getattr(figures, config.select_by), default=None)


def _prior_poses(model: PoseRegressor, images: TrainingSet, seed: int) -> Poses:
    """world_from_camera, (n,): a posterior sample of each of n evenly spaced images."""
    return Poses.concatenate(list(predict(model, images.select(spaced(len(images), MAX_PRIOR_POSES)), 1, seed)))


def _weights(network: PoseRegressor) -> dict[str, torch.Tensor]:
    return {name: value.detach().cpu().clone() for name, value in network.state_dict().items()}


def _settings(config: TrainConfig) -> dict[str, Any]:
    """What makes a training this one, as JSON; file names without folders."""
    return {key: value.name if isinstance(value, Path) else value for key, value in config.settings().items()}
