"""Training of the paper's network on a device: images a second, and the time until it recalls as many poses."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from time import perf_counter
from typing import Literal

import numpy as np

from sequences.synthesize import synthesize
from vapor.benchmark.gpu.setting import Setting
from vapor.benchmark.gpu.stages import Deadline, Finding, OutOfTime
from vapor.checkpoints.calibration import Calibration
from vapor.engines.engine import Device
from vapor.evaluation.validation import validate
from vapor.images import centre_crop, scale_to_cover
from vapor.regressors.scene_box import SceneBox
from vapor.training.config import TrainConfig
from vapor.training.epoch import train_epoch
from vapor.training.presets import PRESETS
from vapor.training.schedule import steps_in_epoch
from vapor.training.state import TrainingState, start
from vapor.training_data.training_set import TrainingSet

SCENE = "round-table"
_PAPER, _FAST = PRESETS["paper-synthetic"], PRESETS["resnet18"]
_WARM_UP, _TIMED, _FEWEST = 2, 40, 3  # steps
_SHARE_OF_CPU, _SHARE_OF_RATE = 0.12, 0.08  # of the time that is left
_FILLED = 0.8  # of the time for a course: with what is learned from; the rest is for evaluation
_EVALUATIONS, _SAMPLES = 12, 200  # of a course, about; and posterior samples of an image in one
_Arithmetic = Literal["float32", "bfloat16"]


def time_training(setting: Setting, deadline: Deadline) -> Iterator[Finding]:
    """Images a second of the paper's training, and how long two precisions take to the same recall."""
    begin = perf_counter()
    training, held_out = _images(setting, deadline)
    count = len(training) + len(held_out)
    yield Finding(f"{SCENE}: images rendered", count / (perf_counter() - begin), "images/s", note=f"{count} images")
    rates: dict[tuple[str, _Arithmetic], float] = {}
    for batch in setting.sizes.training_batches:
        for device, precision in _ways(setting):
            what = f"paper's schedule, {batch} a batch, {precision} on {device}"
            found = _rate(what, _config(_PAPER, setting, batch, precision, device), training, deadline)
            rates[device, precision] = found.value
            yield found
    yield from _time_to_recall(setting, training, held_out, rates, deadline)


def _ways(setting: Setting) -> list[tuple[Device, _Arithmetic]]:
    on_device: list[tuple[Device, _Arithmetic]] = [(setting.device, "float32"), (setting.device, "bfloat16")]
    return [*on_device, ("cpu", "float32")] if setting.device == "cuda" else on_device


def _config(
    preset: TrainConfig, setting: Setting, batch: int, precision: _Arithmetic, device: Device, epochs: int = 1
) -> TrainConfig:
    """A preset with the network that is measured, its own shortcut apart."""
    network = replace(setting.sizes.paper, shortcut=preset.network.shortcut)
    return replace(preset, network=network, batch_size=batch, precision=precision, device=device, epochs=epochs)


def _images(setting: Setting, deadline: Deadline) -> tuple[TrainingSet, TrainingSet]:
    """Images of a rendered walk to train on, and others of the same walk, evenly spread, by which recall is judged."""
    s, size = setting.sizes, setting.sizes.paper.frame_size
    count = s.training + s.held_out
    walk = synthesize(SCENE, seed=0, num_frames=count, split="train", width=s.width, height=s.height)
    images = np.empty((count, size[1], size[0], 3), np.uint8)
    for number, image in enumerate(walk.images()):
        deadline.check()
        images[number] = centre_crop(scale_to_cover(image, *size), *size)
    every = TrainingSet(
        images,
        np.arange(count),
        walk.world_from_camera,
        np.zeros(count, np.int64),
        (SCENE,),
        (s.width, s.height),
        walk.image_times_ns,
        (None,) * count,
    )
    held_out = np.zeros(count, bool)
    held_out[np.linspace(0, count - 1, s.held_out).astype(np.int64)] = True
    return every.select(np.flatnonzero(~held_out)), every.select(np.flatnonzero(held_out))


def _started(config: TrainConfig, training: TrainingSet) -> TrainingState:
    return start(config, SceneBox.around(training.poses), training.poses, None)


def _rate(what: str, config: TrainConfig, training: TrainingSet, deadline: Deadline) -> Finding:
    """Images a second, by the median of steps that end when their loss is known; a part of the time that is left.

    Raises:
        OutOfTime: hardly any step was made.
    """
    share = _SHARE_OF_CPU if config.device == "cpu" else _SHARE_OF_RATE
    own = deadline.before((1.0 - share) * max(deadline.left_s, 0.0))
    stamps: list[float] = []

    def report(step: int, loss: float) -> None:
        stamps.append(perf_counter())
        if len(stamps) > _WARM_UP + _FEWEST:
            own.check()
        deadline.check()

    batch = min(config.batch_size, len(training))
    rows = np.sort(np.resize(np.arange(len(training)), (_WARM_UP + _TIMED) * batch))
    try:
        train_epoch(_started(config, training), training.select(rows), config, report)
    except OutOfTime:
        deadline.check()
    steps_s = np.diff(stamps)[_WARM_UP - 1 :]
    note = f"{len(steps_s)} steps of {1e3 * np.median(steps_s):.1f} ms, 95 % {1e3 * np.percentile(steps_s, 95):.1f} ms"
    return Finding(what, float(batch / np.median(steps_s)), "images/s", note=note)


@dataclass(frozen=True)
class Reached:
    """Seconds of training, images learned from, and sample recall on held-out images so far, 0 to 1."""

    seconds: float
    images: int
    recall: float


def _time_to_recall(
    setting: Setting,
    training: TrainingSet,
    held_out: TrainingSet,
    rates: Mapping[tuple[str, _Arithmetic], float],
    deadline: Deadline,
) -> Iterator[Finding]:
    """Time of training, without evaluation, until the fast schedule recalls as much in float32 as in bfloat16."""
    epochs = int(_FILLED * 0.5 * deadline.left_s * rates[setting.device, "float32"] / len(training))
    epochs = min(setting.sizes.epochs, epochs)
    if epochs < 2:
        raise OutOfTime("there is no time for two epochs of the fast schedule, so recalls are not compared")
    courses: dict[_Arithmetic, list[Reached]] = {}
    kept: tuple[tuple[_Arithmetic, float], ...] = (("float32", 0.5), ("bfloat16", 0.0))  # of the time, for the next
    for precision, later in kept:
        batch = min(_FAST.batch_size, len(training))
        config = _config(_FAST, setting, batch, precision, setting.device, epochs)
        own = deadline.before(later * deadline.left_s)
        courses[precision] = course = _course(config, training, held_out, own)
        best = max(course, key=lambda each: each.recall)
        note = f"after {best.images} images in {best.seconds:.1f} s, the best of {course[-1].images} images"
        yield Finding(f"fast schedule, {precision}: sample recall", 100.0 * best.recall, "%", note=note)
    recall = min(max(each.recall for each in course) for course in courses.values())
    if recall == 0.0:  # there was too little time for any pose to be recalled: there is no time to state
        return
    for precision, course in courses.items():
        first = next(each for each in course if each.recall >= recall)
        note = f"{first.images} images; evaluation apart"
        if (on_cpu := rates.get(("cpu", "float32"))) is not None and setting.device != "cpu":
            note += f"; on the processor, by its images a second, {first.images / on_cpu:.0f} s"
        what = f"fast schedule, {precision}: time to {100.0 * recall:.1f} % recall"
        yield Finding(what, first.seconds, "s", note=note)


def _course(config: TrainConfig, training: TrainingSet, held_out: TrainingSet, deadline: Deadline) -> list[Reached]:
    """What a training has reached, some times on its way; where time is short, not to its end.

    Raises:
        OutOfTime: it was not evaluated once.
    """
    state, course, seconds = _started(config, training), [], 0.0
    widths = Calibration(config.bandwidth_translation_m, config.bandwidth_rotation_rad)
    images = steps_in_epoch(training, config) * config.batch_size
    interval = max(1, config.known_epochs // _EVALUATIONS)
    try:
        while state.epoch < config.known_epochs:
            begin = perf_counter()
            loss = train_epoch(state, training, config, deadline.check)
            seconds += perf_counter() - begin
            state.epoch += 1
            if state.epoch % interval == 0:
                kept = state.average if config.ema_decay else state.network
                figures = validate(
                    kept, held_out, widths, num_samples=_SAMPLES, seed=0, epoch=state.epoch, train_loss=loss
                )
                course.append(Reached(seconds, state.epoch * images, figures.sample_recall))
    except OutOfTime:
        if not course:
            raise
    return course
