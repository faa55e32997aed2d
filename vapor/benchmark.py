"""Measurements: how long the parts of a step take, and how often a scene is localized."""

from __future__ import annotations

import json
import multiprocessing
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from filtering.localizer import LocalizerConfig, ParticleLocalizer
from filtering.motion import Odometry
from filtering.se3 import Poses
from sequences.messages import decode_image_bytes
from sequences.synthesize import synthesize, write_synthetic
from vapor.observation import VaporObservationModel
from vapor.run import RunConfig, run

_IMAGE_SHAPE = (240, 320, 3)


@dataclass(frozen=True)
class Timing:
    """Wall-clock time of one part of a step.

    Attributes:
        part: What was timed.
        median_ms: Median over the repetitions, milliseconds.
        p95_ms: 95th percentile, milliseconds.
    """

    part: str
    median_ms: float
    p95_ms: float


def time_step(model: VaporObservationModel, *, repetitions: int, particles: Sequence[int], seed: int) -> list[Timing]:
    """Time decoding, network and filter one by one, on an image of noise and odometry at walking pace.

    Args:
        model: The network and its number of posterior samples.
        repetitions: Of every part, after three that do not count.
        particles: Sizes of the filter to time.
        seed: Of the image and all draws.
    """
    rng = np.random.default_rng(seed)
    image = rng.integers(0, 256, _IMAGE_SHAPE, dtype=np.uint8)
    blurred = cv2.GaussianBlur(image, (0, 0), 3)  # compresses like a photograph, unlike noise
    encoded = bytes(cv2.imencode(".jpg", blurred, [cv2.IMWRITE_JPEG_QUALITY, 90])[1])
    timings = [
        _time("decode a JPEG image of 320 × 240", lambda: decode_image_bytes(encoded), repetitions),
        _time(f"network, {model.num_samples} samples", lambda: model.observe(blurred, rng=rng), repetitions),
    ]
    step = Odometry(Poses.exp(np.array([0.05, 0, 0, 0, 0, 0.01])), np.diag([0.005**2] * 3 + [0.003**2] * 3))
    for count in particles:
        localizer = ParticleLocalizer(model, LocalizerConfig(num_particles=count), rng=rng)
        localizer.step(blurred, None)
        posteriors = iter([model.observe(blurred, rng=rng) for _ in range(repetitions + 3)])
        label = f"filter, {count} particles and {model.num_samples} samples"
        timings.append(_time(label, lambda loc=localizer, p=posteriors: loc.update(next(p), step), repetitions))
    return timings


def _time(part: str, call: Callable[[], object], repetitions: int) -> Timing:
    durations_ms = []
    for _ in range(repetitions + 3):
        begin = time.perf_counter()
        call()
        durations_ms.append(1e3 * (time.perf_counter() - begin))
    median_ms, p95_ms = np.percentile(durations_ms[3:], [50, 95])
    return Timing(part, float(median_ms), float(p95_ms))


@dataclass(frozen=True)
class Trial:
    """One synthetic sequence to localize.

    Attributes:
        scene: Name of the scene.
        seed: Of the sequence and of the filter.
        frames: Number of images.
        model: Model file, or name of a model that ships.
    """

    scene: str
    seed: int
    frames: int
    model: str


def localize_trials(
    trials: Sequence[Trial], directory: Path, config: RunConfig, *, workers: int
) -> Iterator[dict[str, Any]]:
    """Render and localize every trial, `workers` at a time; yields each one's report as it is done.

    Results lie in one directory a trial. A trial whose report is there, made with the same settings, is not run again.
    """
    pending = []
    for trial in trials:
        folder = directory / f"{trial.scene}-{trial.seed}"
        done = _finished(folder, trial, config)
        if done is not None:
            yield done
        else:
            pending.append((trial, folder))
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, mp_context=context) as pool:
        futures = [pool.submit(_localize, trial, folder, config) for trial, folder in pending]
        for future in as_completed(futures):
            yield future.result()


def _localize(trial: Trial, folder: Path, config: RunConfig) -> dict[str, Any]:
    folder.mkdir(parents=True, exist_ok=True)
    sequence = folder / "sequence.mcap"
    if not sequence.exists():
        write_synthetic(synthesize(trial.scene, seed=trial.seed, num_frames=trial.frames), sequence)
    report = asdict(trial) | run(sequence, trial.model, folder, _with_seed(config, trial.seed)).report
    (folder / "trial.json").write_text(json.dumps({"settings": _settings(trial, config), "report": report}))
    return report


def _finished(folder: Path, trial: Trial, config: RunConfig) -> dict[str, Any] | None:
    try:
        stored = json.loads((folder / "trial.json").read_text())
    except (OSError, ValueError):
        return None
    return stored["report"] if stored["settings"] == _settings(trial, config) else None


def _settings(trial: Trial, config: RunConfig) -> dict[str, Any]:
    return json.loads(json.dumps({"trial": asdict(trial), "config": asdict(_with_seed(config, trial.seed))}))


def _with_seed(config: RunConfig, seed: int) -> RunConfig:
    return replace(config, seed=seed)
