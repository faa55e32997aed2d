"""Training of a pose regressor: from recordings to a model file, whatever its head."""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, cast

import numpy as np

from sequences.frame import Frame
from sequences.options import SequenceOptions
from vapor.checkpoints.checkpoint import Checkpoint
from vapor.checkpoints.file_format import save_checkpoint
from vapor.regressors.scene_box import SceneBox
from vapor.training.config import TrainConfig
from vapor.training.holding_out import hold_out, within_map
from vapor.training.landmarks import find_landmarks
from vapor.training.model_file import calibrate_and_check, model_checkpoint
from vapor.training.processes import from_first, is_first, require_shares
from vapor.training.progress import Progress, ProgressCallback, TrainResult
from vapor.training.state import Saving, initial_model, share_state, start, state_path
from vapor.training.trainer import Trainer, plan
from vapor.training_data.checks import require_variety, too_few
from vapor.training_data.entries import open_sequences, require_no_leakage
from vapor.training_data.load import load_training_set
from vapor.training_data.training_set import TrainingError, TrainingSet


def train(
    data: Sequence[Path | str],
    output: Path | str,
    config: TrainConfig,
    *,
    validation: Sequence[Path | str] = (),
    reading: SequenceOptions | None = None,
    progress: ProgressCallback | None = None,
) -> TrainResult:
    """Train on files and folders, and write the model.

    Args:
        data: Anything that `posed_frames` reads; `PATH@START:STOP` takes only those frames.
        output: The model file.
        config: Configuration.
        validation: Held-out data, with no image of `data`. Images whose surroundings no training image shows are
            ignored. Without it, passes over ground that others cover are held out, and no two entries of `data` may
            share images.
        reading: Options of reading MCAP sequences; None for the defaults.
        progress: Called after every image read and every step.

    Raises:
        TrainingError: unusable data or configuration, or a loss that is not finite.
        SequenceError: unreadable data.
        CheckpointError: an interrupted training of another configuration.

    Example:
        >>> from dataclasses import replace
        >>> import vapor
        >>> config = replace(vapor.PRESETS["auto"], epochs=1, landmarks=False, calibrate=False)  # to try it out
        >>> result = vapor.train(["walk1.mcap", "walk2.mcap"], "mine.safetensors", config, validation=["walk3.mcap"])
        >>> model = vapor.VaporObservationModel.from_checkpoint("mine.safetensors")
    """
    if validation or config.validation_fraction > 0:
        require_no_leakage(data, validation or None)
    odometry = "optional" if config.calibrate else "unread"  # only calibration needs it
    held_out = open_sequences(validation, reading, odometry)
    return train_on(open_sequences(data, reading, odometry), output, config, validation=held_out, progress=progress)


def train_on(
    sequences: Mapping[str, Iterable[Frame]],
    output: Path | str,
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
        views=config.landmarks,
        progress=lambda n: report(Progress("reading", n)),
    )
    config = replace(config, network=config.network_for(*loaded.camera_size), aspect="network")
    frame = config.network.frame_size
    held_out = (
        load_training_set(
            validation,
            frame,
            central=central,
            camera=loaded.camera,
            views=config.landmarks,
            view_camera=loaded.view_camera,
        )
        if validation
        else None
    )
    names = {"data": list(sequences), "validation_data": list(validation or ())}
    return _train(loaded, held_out, names, output, config, initial, report)


def train_on_images(images: TrainingSet, names: Sequence[str], output: Path, config: TrainConfig) -> TrainResult:
    """Train on images that were loaded before, for the configured frame size and crop; else as `train`.

    `names` are the names of the sequences, for the model file.

    Raises:
        TrainingError: images smaller than the network's frame, or another number of names than of sequences.
    """
    initial = _checked_start(output, config)
    (width, height), found = config.network.frame_size, images.images.shape[1:3]
    if found[0] < height or found[1] < width:
        size = f"{found[1]} x {found[0]}"
        raise TrainingError(f"images are {size} pixels, expected at least {width} x {height} as the network's frame")
    if not 1 <= len(names) <= (count := len(np.unique(images.sequence))):
        raise TrainingError(f"{len(names)} names of files and folders with {count} sequences, expected 1 to {count}")
    named = {"data": list(names), "validation_data": []}
    return _train(images, None, named, output, config, initial, lambda _: None)


def _checked_start(output: Path, config: TrainConfig) -> Checkpoint | None:
    """The model to start from, if any; raises the errors that would otherwise come after hours of training."""
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
    split = hold_out(loaded, config.validation_fraction) if held_out is None else within_map(loaded, held_out)
    training = split.training
    box = SceneBox.around(split.everything.poses)
    state = start(config, box.union(initial.box) if initial else box, training.poses, initial)
    require_shares(min(config.batch_size, len(training)), pairs=config.loss.relative > 0.0)
    evaluated = split.evaluated(config.validation_images)
    poses = zlib.crc32(training.poses.as_matrix().tobytes())
    identity = {**names, "images": len(training), "poses": poses, "held_out": len(evaluated), **_settings(config)}
    saving = Saving(state_path(output), identity)
    if config.resume and is_first():
        saving.resume(state)
    share_state(state)
    report(Progress("holding out", len(split.held_out), notes=tuple(split.notes)))
    planned = None
    if not (state.epochs or config.epochs):
        planned = from_first(plan(state, split, len(evaluated), config))
        report(Progress("training", 0, epochs=planned.epochs, left_s=planned.left_s(0, 0.0, 0.0)))
        state.epochs = planned.epochs
    state.epochs = state.epochs or config.known_epochs
    trainer = Trainer(state, split, replace(config, epochs=state.epochs), saving, report, planned)
    model, found, of_landmarks = trainer.learn(), None, ()
    if is_first():
        landmarks, of_landmarks = find_landmarks(
            split.everything, config.camera, lambda *where: report(Progress(*where))
        )
        found = calibrate_and_check(model, split, config, landmarks, lambda *where: report(Progress(*where)))

    learned = trainer.finish(model)
    if found is None:
        return from_first(cast(TrainResult, None))  # the result is the first process'
    provenance = {
        **names,
        "training_images": len(learned),
        "images_seen": trainer.images_seen,
        "seed": config.seed,
        "config": _settings(trainer.config),
        "selected_by": config.select_by if trainer.best else "last epoch",
        "validation": asdict(trainer.best) if trainer.best else None,
        "holding_out": list(split.notes),
        "landmarks": list(of_landmarks),
    }
    checkpoint = model_checkpoint(model, learned, split, found, config, provenance)
    save_checkpoint(output, checkpoint, store_float16=True)
    saving.remove()
    apart = split.held_out.images is not split.training.images
    skipped, notices = split.training.skipped, split.training.notices
    return from_first(
        TrainResult(
            checkpoint,
            tuple(state.history),
            trainer.best,
            state.seconds,
            trainer.images_seen,
            found.calibrated,
            found.check,
            skipped + split.held_out.skipped if apart else skipped,
            (*notices, *(split.held_out.notices if apart else ()), *too_few(split.everything), *of_landmarks),
            len(evaluated),
            split.evidence,
        )
    )


def _settings(config: TrainConfig) -> dict[str, Any]:
    """Settings that identify a training, as JSON; file names without folders."""
    return {key: value.name if isinstance(value, Path) else value for key, value in config.settings().items()}
