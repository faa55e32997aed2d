"""Training runs on scenes, each done once and cached."""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

from sequences.atomic import workspace
from sequences.datasets.listing import is_list
from vapor.cache import cached, digest
from vapor.checkpoints.file_format import load_checkpoint
from vapor.engines.engine import resolve_device
from vapor.evaluation.posterior import posterior_metrics
from vapor.evaluation.validation import exact_log_density, predict
from vapor.pipeline.config import RunConfig
from vapor.pipeline.run import run
from vapor.training.config import TrainConfig
from vapor.training.train import train_on_images
from vapor.training_data.entries import open_sequences, parse_entry
from vapor.training_data.load import load_training_set
from vapor.training_data.training_set import TrainingError, TrainingSet

_LEAST_HEIGHT, _SPARE = 96, 1.4  # of rendered images: pixels, and times what covers a frame
_RESULTS = 3  # counts up when the same training gives other results than before


@dataclass(frozen=True)
class Scene:
    """What networks are trained on and tested on.

    Attributes:
        name: For people, and for names of files.
        train: Files and folders, as `vapor-track train` takes them.
        test: Files and folders of which no image is trained on.
    """

    name: str
    train: tuple[str, ...]
    test: tuple[str, ...]


def identities(entries: Sequence[str]) -> list[list[str | int]]:
    """The identity of each of some files and folders, another one after a change."""
    return [identity(entry) for entry in entries]


def identity(entry: str) -> list[str | int]:
    """Where an entry lies, and sizes and times of change of its files: of a folder or a split, all of the folder."""
    path, _ = parse_entry(Path(entry).absolute())
    folder = path.parent if is_list(path) else path
    walked = (Path(at, name) for at, _, names in os.walk(folder, followlinks=True) for name in names)
    about: list[list[str | int]] = []
    for file in sorted(walked if folder.is_dir() else [path]):
        with suppress(FileNotFoundError):
            stat = file.stat()
            about.append([os.path.relpath(file, folder), stat.st_size, stat.st_mtime_ns])
    content = hashlib.sha256(json.dumps(about).encode()).hexdigest()
    return [str(Path(entry).resolve()), len(about), content]


def rendered_height(frame_size: tuple[int, int]) -> int:
    """Height of 4:3 images that cover a frame (width, height) when they are scaled down, pixels."""
    return max(_LEAST_HEIGHT, math.ceil(_SPARE * max(frame_size[1], frame_size[0] * 3 / 4)))


@dataclass(frozen=True)
class TrainingRun:
    """One training run and how it is tested.

    Attributes:
        label: What sets it apart from the other runs; part of a file name.
        config: How it is trained; its seed is that of the run.
        gamma: Fraction of an image's samples that must be near its true pose.
        num_samples: Posterior samples per test image.
        localize: Whether the particle filter runs over the test sequences, too.
    """

    scene: Scene
    label: str
    config: TrainConfig
    gamma: float
    num_samples: int
    localize: bool = False

    @property
    def name(self) -> str:
        """Begin of the names of its files."""
        return f"{self.scene.name}-{self.label}-{self.config.seed}"

    def trained_from(self) -> dict[str, Any]:
        """All that the model depends on, as JSON; it depends on no test."""
        settings = {k: identity(str(v)) if isinstance(v, Path) else v for k, v in self.config.settings().items()}
        return {**settings, "data": identities(self.scene.train), "results": _RESULTS}

    def settings(self) -> dict[str, Any]:
        """All that the result depends on, as JSON."""
        tested = {"gamma": self.gamma, "num_samples": self.num_samples, "localize": self.localize}
        return self.trained_from() | tested | {"test": identities(self.scene.test)}

    def model_file(self, directory: Path) -> Path:
        """Where the model lies, named after all that training depends on."""
        return directory / "runs" / f"{self.name}-{digest(self.trained_from())}.safetensors"


def carry_out(training: TrainingRun, directory: Path) -> dict[str, Any]:
    """The result of a training run, unless it is cached in `directory / "runs"`.

    A training that was interrupted goes on from its last saved epoch: its state lies beside where its model will.

    Returns:
        JSON: `scene`, `label`, `seed`; `seconds` of training and `images_seen`, all of `posterior_metrics`, and with
        `localize` `filter`, the report of every test sequence; or `error`, why it could not be trained.
    """
    runs = directory / "runs"
    runs.mkdir(parents=True, exist_ok=True)

    def compute() -> dict[str, Any]:
        try:
            cost = cached(runs / f"{training.name}-cost", training.trained_from(), lambda: _train(training, directory))
        except TrainingError as error:
            return {"error": str(error)}
        with workspace(runs, training.name) as folder:
            return cost | _test(training, training.model_file(directory), folder)

    names = {"scene": training.scene.name, "label": training.label, "seed": training.config.seed}
    return names | cached(runs / training.name, training.settings(), compute)


def _images(entries: tuple[str, ...], frame_size: tuple[int, int], *, central: bool = True) -> TrainingSet:
    """Images, read once for all runs on a scene in this process unless files change."""
    return _read_once(entries, frame_size, central, json.dumps(identities(entries)))


@lru_cache(maxsize=2)  # to train on and to test on
def _read_once(entries: tuple[str, ...], frame_size: tuple[int, int], central: bool, _: str) -> TrainingSet:
    return load_training_set(open_sequences(entries), frame_size, central=central)


def _train(training: TrainingRun, directory: Path) -> dict[str, float]:
    """Train; `seconds` and `images_seen`."""
    central = training.config.augment.crop == "central"
    images = _images(training.scene.train, training.config.network.frame_size, central=central)
    names, config = list(open_sequences(training.scene.train)), replace(training.config, landmarks=False)
    try:
        trained = train_on_images(images, names, training.model_file(directory), config)
    finally:
        images.unload()  # a process that seems to leak memory is replaced
    return {"seconds": trained.seconds, "images_seen": trained.images_seen}


def _test(training: TrainingRun, model: Path, folder: Path) -> dict[str, Any]:
    seed, scene = training.config.seed, training.scene
    checkpoint = load_checkpoint(model)
    network = checkpoint.build_network().to(resolve_device(training.config.device))
    images = _images(scene.test, training.config.network.frame_size)
    result = posterior_metrics(
        predict(network, images, training.num_samples, seed),
        images.poses,
        checkpoint.calibration,
        gamma=training.gamma,
        exact_log_density=exact_log_density(network, images),
    )
    if training.localize:
        config = RunConfig(seed, recording=False, num_samples=training.num_samples, device=training.config.device)
        result["filter"] = [
            run(parse_entry(entry)[0], str(model), folder / f"run-{k}", config).report
            for k, entry in enumerate(scene.test)
        ]
    return result
