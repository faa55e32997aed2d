"""Scenes, rendered where they are synthetic, and training runs on them, each done once and cached."""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

from sequences.atomic import atomic_output, workspace
from sequences.datasets.listing import is_list
from sequences.files import read_json
from sequences.synthesize import SYNTHESIS, synthesize, write_synthetic
from vapor.cache import digest
from vapor.checkpoints.file_format import load_checkpoint
from vapor.engines.engine import resolve_device
from vapor.evaluation.posterior import posterior_metrics
from vapor.evaluation.validation import exact_log_density, predict
from vapor.parallel.jobs import Workers, in_parallel
from vapor.pipeline.config import RunConfig
from vapor.pipeline.run import run
from vapor.storage import absent, fetched, is_url, published, url_of, withdrawn
from vapor.threads import limited_threads
from vapor.training.config import TrainConfig
from vapor.training.state import state_path
from vapor.training.train import train_on_images
from vapor.training_data.entries import open_sequences, parse_entry
from vapor.training_data.load import load_training_set
from vapor.training_data.training_set import TrainingError, TrainingSet

_LEAST_HEIGHT, _SPARE = 96, 1.4  # of rendered images: pixels, and times what covers a frame


@dataclass(frozen=True)
class Scene:
    """What networks are trained on and tested on.

    Attributes:
        name: For people, and for names of files.
        train: Files and folders, as `vapor-track train` takes them.
        test: Likewise; no image of them is trained on.
    """

    name: str
    train: tuple[str, ...]
    test: tuple[str, ...]

    @property
    def anywhere(self) -> Scene:
        """The same scene for processes elsewhere: by absolute paths, and by URLs where these are copies of some."""
        return Scene(self.name, *(tuple(map(_anywhere, entries)) for entries in (self.train, self.test)))


def _anywhere(entry: str) -> str:
    path = Path(entry).absolute()
    return entry if is_url(entry) else url_of(path) or str(path)


def identities(entries: Sequence[str]) -> list[list[str | int]]:
    """The identity of each of some files and folders, another one after a change."""
    return [identity(entry) for entry in entries]


def identity(entry: str) -> list[str | int]:
    """Where an entry lies, and sizes and times of change of its files: of a folder or a split, all of the folder."""
    place = _anywhere(entry)
    path, _ = parse_entry(place)
    folder = path.parent if is_list(path) else path
    walked = (Path(at, name) for at, _, names in os.walk(folder, followlinks=True) for name in names)
    about: list[list[str | int]] = []
    for file in sorted(walked if folder.is_dir() else [path]):
        with suppress(FileNotFoundError):
            stat = file.stat()
            about.append([os.path.relpath(file, folder), stat.st_size, stat.st_mtime_ns])
    content = hashlib.sha256(json.dumps(about).encode()).hexdigest()
    return [place if is_url(place) else str(Path(entry).resolve()), len(about), content]


def render_scenes(
    names: Sequence[str],
    directory: Path,
    *,
    train_walks: int,
    train_frames: int,
    test_walks: int,
    test_frames: int,
    height: int,
    workers: Workers,
) -> Iterator[tuple[int, int, list[Scene]]]:
    """Render missing walks of synthetic scenes; yields the number of walks done, of all, and the scenes they make.

    Args:
        names: Of synthetic scenes.
        directory: Sequences lie in its `images`.
        train_walks: Sequences to train on, of `train_frames` images each, seeds from 0.
        test_walks: Sequences to test on, of `test_frames` images each.
        height: Of the images, pixels; they are 4:3.
    """
    size = round(height * 4 / 3), height
    folder = directory / "images"
    folder.mkdir(parents=True, exist_ok=True)
    walks = {
        name: {
            split: [
                (
                    folder / f"{name}-{split}-{seed}-{frames}-{size[0]}x{size[1]}-{SYNTHESIS}.mcap",
                    name,
                    split,
                    seed,
                    frames,
                )
                for seed in range(number)
            ]
            for split, number, frames in (("train", train_walks, train_frames), ("test", test_walks, test_frames))
        }
        for name in names
    }
    scenes = [Scene(n, *(tuple(str(w[0]) for w in w[split]) for split in ("train", "test"))) for n, w in walks.items()]
    every = [walk for splits in walks.values() for some in splits.values() for walk in some]
    lacking = absent([walk[0] for walk in every], folder)
    missing = [(*walk, size) for walk in every if walk[0] in lacking]
    yield len(every) - len(missing), len(every), scenes
    for done, _ in enumerate(in_parallel(_render, missing, workers), len(every) - len(missing) + 1):
        yield done, len(every), scenes


def rendered_height(frame_size: tuple[int, int]) -> int:
    """Height of 4:3 images that cover a frame (width, height) when they are scaled down, pixels."""
    return max(_LEAST_HEIGHT, math.ceil(_SPARE * max(frame_size[1], frame_size[0] * 3 / 4)))


def _render(
    file: Path, scene: str, split: Literal["train", "test"], seed: int, frames: int, size: tuple[int, int]
) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)  # a worker may have no copy of the folder yet
    write_synthetic(synthesize(scene, seed=seed, num_frames=frames, split=split, width=size[0], height=size[1]), file)
    published(file)


_RESULTS = 2  # counts up when the same training gives other results than before


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

    def model_file(self, directory: Path) -> Path:
        """Where the model lies, named after all that training depends on: another test takes no other training."""
        return directory / "runs" / f"{self._name}-{digest(trained_from(self.scene, self.config))}.safetensors"

    def result_file(self, directory: Path) -> Path:
        """Where its result lies, named after all that it depends on."""
        tested = {
            "test": identities(self.scene.test),
            "gamma": self.gamma,
            "num_samples": self.num_samples,
            "localize": self.localize,
        }
        return directory / "runs" / f"{self._name}-{digest(trained_from(self.scene, self.config) | tested)}.json"

    @property
    def _name(self) -> str:
        return f"{self.scene.name}-{self.label}-{self.config.seed}"


def trained_from(scene: Scene, config: TrainConfig) -> dict[str, Any]:
    """All that a training depends on, as JSON."""
    settings = {k: identity(str(v)) if isinstance(v, Path) else v for k, v in config.settings().items()}
    return {**settings, "data": identities(scene.train), "results": _RESULTS}


def carry_out(runs: Sequence[TrainingRun], directory: Path, workers: Workers) -> Iterator[dict[str, Any]]:
    """The result of every training run, in no order; finished ones are kept.

    A training whose worker dies goes on from its last epoch, on whichever worker is next to take it up: its state lies
    beside where its model will, until it is done.

    JSON: `scene`, `label`, `seed`; `seconds` of training and `images_seen`, all of `posterior_metrics`, and with
    `localize` `filter`, the report of every test sequence; or `error`, why it could not be trained.
    """
    (directory / "runs").mkdir(parents=True, exist_ok=True)
    yield from in_parallel(_result, [(replace(run, scene=run.scene.anywhere), directory) for run in runs], workers)


def _result(training: TrainingRun, directory: Path) -> dict[str, Any]:
    file = fetched(training.result_file(directory))
    if file.is_file():
        return read_json(file)
    file.parent.mkdir(parents=True, exist_ok=True)
    seed, scene, model = training.config.seed, training.scene, training.model_file(directory)
    result: dict[str, Any] = {"scene": scene.name, "label": training.label, "seed": seed}
    with limited_threads(1), workspace(file.parent, file.name) as folder:
        try:
            result |= _train(training, model)
        except TrainingError as error:
            result["error"] = str(error)
        else:
            result |= _test(training, model, folder)
    with atomic_output(file) as partial:
        partial.write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")
    published(file)
    withdrawn(state_path(model))
    return result


def _images(entries: tuple[str, ...], frame_size: tuple[int, int], *, central: bool = True) -> TrainingSet:
    """Images, read once for all runs on a scene in this process unless files change."""
    return _read_once(entries, frame_size, central, json.dumps(identities(entries)))


@lru_cache(maxsize=2)  # to train on and to test on
def _read_once(entries: tuple[str, ...], frame_size: tuple[int, int], central: bool, _: str) -> TrainingSet:
    return load_training_set(open_sequences(entries), frame_size, central=central)


def _train(training: TrainingRun, model: Path) -> dict[str, float]:
    """Train, unless that is done; `seconds` and `images_seen`."""
    about = model.with_suffix(".json")
    if fetched(model).is_file() and fetched(about).is_file():
        return read_json(about)
    fetched(state_path(model))
    crop = training.config.augment.crop
    images = _images(training.scene.train, training.config.network.frame_size, central=crop == "central")
    try:
        config = replace(training.config, landmarks=False)  # networks are compared
        trained = train_on_images(images, list(open_sequences(training.scene.train)), model, config)
    finally:
        images.unload()  # a worker that seems to leak memory is replaced
    cost = {"seconds": trained.seconds, "images_seen": trained.images_seen}
    with atomic_output(about) as partial:
        partial.write_text(json.dumps(cost) + "\n", encoding="utf-8")
    for made in (model, about):
        published(made)
    return cost


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
