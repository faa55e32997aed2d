"""One training of an experiment: from sequences to figures on other ones, done once and kept."""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

import numpy as np

from filtering.se3 import Poses
from sequences.atomic import atomic_output, workspace
from sequences.synthesize import SYNTHESIS, synthesize, write_synthetic
from sequences.values import read_arrays, read_json
from vapor.benchmark.recordings import from_rows, to_rows
from vapor.cache import digest
from vapor.checkpoints.file_format import load_checkpoint
from vapor.checkpoints.thinning import spaced
from vapor.evaluation.posterior import posterior_metrics
from vapor.evaluation.validation import exact_log_density, predict
from vapor.observation import resolve_device
from vapor.parallel import in_parallel
from vapor.pipeline.run import RunConfig, run
from vapor.threads import limited_threads
from vapor.training.config import TrainConfig
from vapor.training.train import train_on_images
from vapor.training_data.entries import open_sequences, parse_entry
from vapor.training_data.load import load_training_set
from vapor.training_data.training_set import TrainingError, TrainingSet

_RESULTS = 2  # counts up when the same training gives other results than before
_LEAST_HEIGHT, _SPARE = 96, 1.4  # of rendered images: pixels, and times what covers a frame
_SHOWN = 25  # test images whose samples are kept for pictures, evenly spaced


@dataclass(frozen=True)
class Scene:
    """What networks are trained on and tested on.

    Attributes:
        name: Where a person reads.
        train: Files and folders, as `vapor-track train` takes them.
        test: Likewise; no image of them is trained on.
    """

    name: str
    train: tuple[str, ...]
    test: tuple[str, ...]


@dataclass(frozen=True)
class Training:
    """One training and how it is tested.

    Attributes:
        scene: Its data.
        label: What sets it apart from the other trainings of the experiment; part of a file name.
        config: How; its seed is that of the training.
        gamma: Share of an image's samples that must be near its true pose.
        num_samples: Posterior samples per test image.
        localize: Whether the particle filter runs over the test sequences, too.
        keep_model: Whether the model stays, so that another way to test it needs no other training.
        training_images: Images of those trained on that are judged as well, evenly spaced.
    """

    scene: Scene
    label: str
    config: TrainConfig
    gamma: float
    num_samples: int
    localize: bool = False
    keep_model: bool = False
    training_images: int = 0

    def model_file(self, directory: Path) -> Path:
        """Where the model lies, named after all that the training depends on."""
        return directory / "runs" / f"{self._name}-{digest(trained_from(self.scene, self.config))}.safetensors"

    def file(self, directory: Path, suffix: str) -> Path:
        """Where its result lies, named after all that it depends on."""
        tested = {
            "test": identities(self.scene.test),
            "gamma": self.gamma,
            "num_samples": self.num_samples,
            "localize": self.localize,
            "training_images": self.training_images,
        }
        return directory / "runs" / f"{self._name}-{digest(trained_from(self.scene, self.config) | tested)}{suffix}"

    @property
    def _name(self) -> str:
        return f"{self.scene.name}-{self.label}-{self.config.seed}"


def trained_from(scene: Scene, config: TrainConfig) -> dict[str, Any]:
    """All that a training depends on, as JSON."""
    settings = {k: _identity(str(v)) if isinstance(v, Path) else v for k, v in config.settings().items()}
    return {**settings, "data": identities(scene.train), "results": _RESULTS}


def identities(entries: Sequence[str]) -> list[list[str | int]]:
    """What tells each of some files and folders from others and from itself after a change."""
    return [_identity(entry) for entry in entries]


def _identity(entry: str) -> list[str | int]:
    """Where it lies, and sizes and times of change of its files: of a folder, or the folder of a split, all in it."""
    path, _ = parse_entry(entry)
    folder = path.parent if path.suffix == ".txt" else path
    walked = (Path(at, name) for at, _, names in os.walk(folder, followlinks=True) for name in names)
    about: list[list[str | int]] = []
    for file in sorted(walked if folder.is_dir() else [path]):
        with suppress(FileNotFoundError):
            stat = file.stat()
            about.append([os.path.relpath(file, folder), stat.st_size, stat.st_mtime_ns])
    content = hashlib.sha256(json.dumps(about).encode()).hexdigest()
    return [str(Path(entry).resolve()), len(about), content]


def render_scenes(
    names: Sequence[str],
    directory: Path,
    *,
    train_walks: int,
    train_frames: int,
    test_walks: int,
    test_frames: int,
    height: int,
    workers: int,
) -> Iterator[tuple[int, int, list[Scene]]]:
    """Render what is missing of synthetic scenes; yields the number of walks done, of all, and the scenes they make.

    Args:
        names: Of synthetic scenes.
        directory: Sequences lie in its `images`.
        train_walks: Sequences to train on, of `train_frames` images each, seeds from 0.
        train_frames: See there.
        test_walks: Sequences to test on, of `test_frames` images each.
        test_frames: See there.
        height: Of the images, pixels; they are 4:3.
        workers: Processes at a time.
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
    missing = [(*walk, size) for walk in every if not walk[0].is_file()]
    yield len(every) - len(missing), len(every), scenes
    for done, _ in enumerate(in_parallel(_render, missing, workers), len(every) - len(missing) + 1):
        yield done, len(every), scenes


def rendered_height(frame_size: tuple[int, int]) -> int:
    """Height of 4:3 images that cover a frame (width, height) when they are scaled down, pixels."""
    return max(_LEAST_HEIGHT, math.ceil(_SPARE * max(frame_size[1], frame_size[0] * 3 / 4)))


def run_trainings(trainings: Sequence[Training], directory: Path, workers: int) -> Iterator[dict[str, Any]]:
    """The result of every training, in no order; what is done is not done again.

    JSON: `scene`, `label`, `seed`; `seconds` of training and `images_seen`, all of `posterior_metrics`, with
    `training_images` the same of these as `training`, and with `localize` `filter`, the report of every test sequence;
    or `error`, why it could not be trained.
    """
    (directory / "runs").mkdir(parents=True, exist_ok=True)
    yield from in_parallel(_run, [(training, directory) for training in trainings], workers)


def kept_samples(training: Training, directory: Path) -> tuple[Poses, list[Poses]]:
    """True poses of some test images, and the posterior samples of each, of a training that is done."""
    stored = read_arrays(training.file(directory, ".npz"))
    rows = {name: stored[name].astype(np.float64) for name in ("truth", "samples")}
    return from_rows(rows["truth"]), [from_rows(image) for image in rows["samples"]]


def _render(
    file: Path, scene: str, split: Literal["train", "test"], seed: int, frames: int, size: tuple[int, int]
) -> None:
    write_synthetic(synthesize(scene, seed=seed, num_frames=frames, split=split, width=size[0], height=size[1]), file)


def _run(training: Training, directory: Path) -> dict[str, Any]:
    file = training.file(directory, ".json")
    if file.is_file():
        return read_json(file)
    seed, scene = training.config.seed, training.scene
    result: dict[str, Any] = {"scene": scene.name, "label": training.label, "seed": seed}
    with limited_threads(1), workspace(file.parent, file.name) as folder:
        model = training.model_file(directory) if training.keep_model else folder / "model.safetensors"
        try:
            result |= _train(training, model)
        except TrainingError as error:
            result["error"] = str(error)
        else:
            result |= _test(training, directory, model, folder)
    with atomic_output(file) as partial:
        partial.write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")
    return result


def _images(entries: tuple[str, ...], frame_size: tuple[int, int], *, central: bool = True) -> TrainingSet:
    """Images, read once for all trainings of a scene in this process unless files change."""
    return _read_once(entries, frame_size, central, json.dumps(identities(entries)))


@lru_cache(maxsize=2)  # to train on and to test on
def _read_once(entries: tuple[str, ...], frame_size: tuple[int, int], central: bool, _: str) -> TrainingSet:
    return load_training_set(open_sequences(entries), frame_size, central=central)


def _train(training: Training, model: Path) -> dict[str, float]:
    """Train, unless that is done; `seconds` and `images_seen`."""
    about = model.with_suffix(".json")
    if model.is_file() and about.is_file():
        return read_json(about)
    crop = training.config.augment.crop
    images = _images(training.scene.train, training.config.network.frame_size, central=crop == "central")
    try:
        trained = train_on_images(images, list(open_sequences(training.scene.train)), model, training.config)
    finally:
        images.unload()  # a worker that seems to leak memory is replaced
    cost = {"seconds": trained.seconds, "images_seen": trained.images_seen}
    with atomic_output(about) as partial:
        partial.write_text(json.dumps(cost) + "\n", encoding="utf-8")
    return cost


def _test(training: Training, directory: Path, model: Path, folder: Path) -> dict[str, Any]:
    seed, scene = training.config.seed, training.scene
    checkpoint = load_checkpoint(model)
    network = checkpoint.build_network().to(resolve_device(training.config.device))

    def judge(images: TrainingSet, kept: dict[int, Poses]) -> dict[str, Any]:
        def posteriors() -> Iterator[Poses]:
            for index, posterior in enumerate(predict(network, images, training.num_samples, seed)):
                if index in kept:
                    kept[index] = posterior
                yield posterior

        return posterior_metrics(
            posteriors(),
            images.poses,
            checkpoint.calibration,
            gamma=training.gamma,
            exact_log_density=exact_log_density(network, images),
        )

    size = training.config.network.frame_size
    test = _images(scene.test, size)
    shown = spaced(len(test), _SHOWN)
    kept = dict.fromkeys(shown.tolist(), Poses.identity())
    result = judge(test, kept)
    if training.training_images:
        seen = _images(scene.train, size)
        result["training"] = judge(seen.select(spaced(len(seen), training.training_images)), {})
    if training.localize:
        config = RunConfig(seed, recording=False, num_samples=training.num_samples, device=training.config.device)
        result["filter"] = [
            run(Path(entry), str(model), folder / f"run-{k}", config).report for k, entry in enumerate(scene.test)
        ]
    with atomic_output(training.file(directory, ".npz")) as partial, partial.open("wb") as out:
        rows = np.stack([to_rows(kept[i]) for i in shown.tolist()])
        np.savez(out, truth=to_rows(test.poses[shown]), samples=rows.astype(np.float32))
    return result
