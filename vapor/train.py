"""Training of the variational pose regressor: one loop."""

from __future__ import annotations

import json
import math
import zlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from time import perf_counter
from typing import Any, Literal

import numpy as np
import torch
from jaxtyping import Int64
from torch.optim.swa_utils import get_ema_multi_avg_fn

from filtering.se3 import Poses
from sequences.frame import Frame
from sequences.options import SequenceOptions
from vapor.augment import jitter_and_normalise, random_crops
from vapor.calibrate import CalibrationResult, calibrate
from vapor.checkpoint import MAX_PRIOR_POSES, Calibration, Checkpoint, save_checkpoint, spaced
from vapor.familiarity import EXEMPLARS, learn_familiarity
from vapor.holding_out import Split, hold_out, within_map
from vapor.loss import training_loss
from vapor.network import PoseRegressor, SceneBox
from vapor.scene_scale import default_errors
from vapor.train_config import TrainConfig, learning_rate, samples_per_image
from vapor.training_check import TrainingCheck, check
from vapor.training_set import (
    TrainingError,
    TrainingSet,
    load_training_set,
    open_sequences,
    require_apart,
)
from vapor.training_start import initial_model, start
from vapor.training_state import TrainingState, load_state, save_state, state_path
from vapor.validation import Validation, predict, validate


@dataclass(frozen=True)
class Progress:
    """Where a training stands.

    Attributes:
        stage: "reading" of images, "holding out" of some, "training", "calibrating", "checking".
        done: Images read or held out, steps done since the training's start, interrupted or not, or held-out images
            seen.
        total: Steps or images in all; None while reading.
        epoch: The current epoch, from 1.
        epochs: Of so many.
        loss: Mean training loss of this epoch so far.
        learning_rate: Of the last step.
        seconds: Of training in this call, reading and judging left out.
        validation: Figures of the last epoch judged.
        best: Figures of the best epoch.
        notes: What was held out and why, told once before the first step.
    """

    stage: Literal["reading", "holding out", "training", "calibrating", "checking"]
    done: int
    total: int | None = None
    epoch: int = 0
    epochs: int = 0
    loss: float | None = None
    learning_rate: float | None = None
    seconds: float = 0.0
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
        seconds: Wall clock of this call's training, reading and interruptions left out.
        images_seen: Of this call.
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
        require_apart(data, validation or None)
    held_out = open_sequences(validation, reading)
    return train_on(open_sequences(data, reading), output, config, validation=held_out, progress=progress)


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
    frame, central = config.network.frame_size, config.augment.crop == "central"
    loaded = load_training_set(sequences, frame, central=central, progress=lambda n: report(Progress("reading", n)))
    held_out = load_training_set(validation, frame, central=central) if validation else None
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
    split = hold_out(loaded, config.validation_share) if held_out is None else within_map(loaded, held_out)
    training = split.training
    if len(training) < 2:
        raise TrainingError(f"{', '.join(names['data'])}: {len(training)} training images, expected at least 2")
    box = SceneBox.around(training.poses)
    state = start(config, box.union(initial.box) if initial else box, training.poses, initial)
    return _fit(state, split, names, output, config, report)


def _fit(
    state: TrainingState,
    split: Split,
    names: dict[str, Any],
    output: Path,
    config: TrainConfig,
    report: ProgressCallback,
) -> TrainResult:
    training, held_out = split.training, split.held_out
    judged = held_out.select(spaced(len(held_out), config.validation_images))
    poses = zlib.crc32(training.poses.as_matrix().tobytes())
    identity = {**names, "images": len(training), "poses": poses, "held_out": len(judged), **_settings(config)}
    if config.resume and state_path(output).exists():
        load_state(state_path(output), state, identity)
    report(Progress("holding out", len(held_out), notes=split.notes))
    begin, first_epoch, spent_s = perf_counter(), state.epoch, 0.0
    best = _best(state.history, config)
    while state.epoch < config.epochs:
        begin_epoch = perf_counter()
        loss = _train_epoch(state, training, config, report, best, begin_epoch - spent_s)
        spent_s += perf_counter() - begin_epoch
        state.epoch += 1
        if len(judged):
            kept = state.average if config.average else state.network
            figures = validate(
                kept,
                judged,
                Calibration(config.bandwidth_translation_m, config.bandwidth_rotation_rad),
                num_samples=config.loss.num_samples,
                seed=config.seed,
                epoch=state.epoch,
                train_loss=loss,
            )
            state.history.append(figures)
            best = _best(state.history, config)
            if best is figures:
                state.best = _weights(kept)
        save_state(state_path(output), state, identity)
    seconds = perf_counter() - begin

    weights = state.best or _weights(state.average if config.average else state.network)
    provenance = {
        **names,
        "training_images": len(training),
        "images_seen": state.epoch * len(training),
        "seed": config.seed,
        "config": _settings(config),
        "selected_by": config.select_by if best else "last epoch",
        "validation": asdict(best) if best else None,
        "holding_out": list(split.notes),
    }
    prior_poses = _prior_poses(state.average, weights, training, config.seed)
    widths = config.bandwidth_translation_m, config.bandwidth_rotation_rad
    calibration = Calibration(*widths, default_errors(prior_poses))
    calibrated = familiarity = checked = None
    if config.calibrate:
        familiarity = learn_familiarity(state.average, training.select(spaced(len(training), EXEMPLARS)), judged)
        calibrated = calibrate(
            state.average,  # with the weights kept, as `_prior_poses` left it
            held_out,
            prior_poses,
            calibration,
            training=training,
            familiarity=familiarity,
            max_images=config.validation_images,
            seed=config.seed,
            advance=lambda done, total: report(Progress("calibrating", done, total, best=best)),
        )
        checked, calibration = check(
            state.average,
            split.source,
            split.judged,
            calibrated,
            familiarity,
            prior_poses,
            seed=config.seed,
            advance=lambda done, total: report(Progress("checking", done, total, best=best)),
        )
        provenance |= {"calibration": calibrated.provenance, "check": checked.as_json if checked else None}
    checkpoint = Checkpoint(
        config.network,
        state.network.box,
        calibration,
        prior_poses,
        weights,
        json.loads(json.dumps(provenance)),
        familiarity,
    )
    save_checkpoint(output, checkpoint, half=config.half)
    state_path(output).unlink(missing_ok=True)
    images_seen = (state.epoch - first_epoch) * len(training)
    apart = held_out.images is not training.images
    skipped = training.skipped + held_out.skipped if apart else training.skipped
    notices = training.notices + held_out.notices if apart else training.notices
    return TrainResult(
        checkpoint, tuple(state.history), best, seconds, images_seen, calibrated, checked, skipped, notices
    )


def _train_epoch(
    state: TrainingState,
    training: TrainingSet,
    config: TrainConfig,
    report: ProgressCallback,
    best: Validation | None,
    begin_s: float,
) -> float:
    """One pass over the images in random order, an incomplete last batch left out; returns the mean loss.

    Told progress counts seconds from `begin_s` of `perf_counter`.
    """
    network, device = state.network, state.network.pixel_mean.device
    rng = np.random.default_rng([config.seed, state.epoch])
    generator = torch.Generator(device).manual_seed(int(rng.integers(2**62)))
    batch = min(config.batch_size, len(training))
    steps = len(training) // batch
    order = rng.permutation(len(training))[: steps * batch].reshape(steps, batch)
    true_translation = torch.from_numpy(training.poses.translation).float().to(device)
    true_rotation = torch.from_numpy(training.poses.rotation).float().to(device)
    bfloat16 = _uses_bfloat16(config, device)
    network.train()
    total = 0.0
    for number, indices in enumerate(order):
        if config.loss.relative > 0.0:
            indices = _paired(indices, training.sequence, config.loss.pair_gap, rng=rng)
        step = state.epoch * steps + number
        rate = learning_rate(config, step, steps)
        for group in state.optimizer.param_groups:
            group["lr"] = rate
        size = config.network.image_width, config.network.image_height
        crops = random_crops(training.images, training.rows[indices], *size, config.augment, rng=rng)
        pixels = torch.from_numpy(crops).to(device)
        images = jitter_and_normalise(pixels, network.pixel_mean, network.pixel_std, config.augment, rng=rng)
        samples = samples_per_image(config, step, steps) if config.network.head == "variational" else 1
        shape = len(indices), samples, network.noise_dim
        noise = torch.randn(shape, generator=generator, device=device)
        truth = true_translation[indices], true_rotation[indices]
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
        last = state.history[-1] if state.history else None
        report(
            Progress(
                "training",
                step + 1,
                steps * config.epochs,
                epoch=state.epoch + 1,
                epochs=config.epochs,
                loss=total / (number + 1),
                learning_rate=rate,
                seconds=perf_counter() - begin_s,
                validation=last,
                best=best,
            )
        )
    return total / steps


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
    separable convolutions do not gain by it.
    """
    if config.precision != "auto":
        return config.precision == "bfloat16"
    if device.type == "cuda":
        return torch.cuda.is_bf16_supported(including_emulation=False)
    if config.network.backbone == "efficientnet-lite0":
        return False
    capabilities = torch.cpu.get_capabilities()
    return bool(capabilities.get("avx512_bf16") or capabilities.get("amx_bf16"))


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


def _best(history: Sequence[Validation], config: TrainConfig) -> Validation | None:
    """The best epoch so far, of equally good ones the last: at first none may be good at all."""
    return max(reversed(history), key=lambda figures: getattr(figures, config.select_by), default=None)


def _prior_poses(network: PoseRegressor, weights: dict[str, torch.Tensor], training: TrainingSet, seed: int) -> Poses:
    """world_from_camera, (n,): a posterior sample of each of n evenly spaced training images, with these weights."""
    network.load_state_dict(weights)
    images = training.select(spaced(len(training), MAX_PRIOR_POSES))
    return Poses.concatenate(list(predict(network, images, 1, seed)))


def _weights(network: PoseRegressor) -> dict[str, torch.Tensor]:
    return {name: value.detach().cpu().clone() for name, value in network.state_dict().items()}


def _settings(config: TrainConfig) -> dict[str, Any]:
    """What makes a training this one, as JSON; file names without folders."""
    return {key: value.name if isinstance(value, Path) else value for key, value in config.settings().items()}
