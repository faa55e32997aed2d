"""Sweeps of one setting of training: a training run for each scene, value and seed."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, ClassVar

from filtering.errors import VaporTrackError, require_within
from filtering.se3 import Poses
from sequences.scenes import SCENES, find_scene
from vapor.experiments.scenes import Scene, render_scenes, rendered_height
from vapor.experiments.training_runs import TrainingRun, cached_samples, carry_out
from vapor.parallel.jobs import Workers
from vapor.training.config import TrainConfig

MODES: Mapping[str, int] = MappingProxyType(
    {name: modes for name in SCENES if (modes := find_scene(name).modes) is not None}
)
"""Scenes of the sweeps, and how many poses look alike in each, by construction."""


@dataclass(frozen=True, kw_only=True)
class SweepConfig(ABC):
    """Settings of a sweep; subclasses say which number varies."""

    parameter: ClassVar[str]
    """Name of the number."""
    runs: int = 10
    """Training runs for each value; they differ in initial weights, order, augmentation and latent noise."""
    first_seed: int = 0
    """Seed of the first of them."""
    gamma: float = 0.1
    """Fraction of an image's samples that must be near its true pose for it to count as right."""
    sequences: int = 40
    """Walks about the table that are trained on."""
    frames: int = 500
    """Images of each."""
    test_frames: int = 300
    """Images of the walk that is tested on."""
    num_samples: int = 1000
    """Posterior samples per image that is evaluated."""
    workers: int = 2
    """Training runs at a time, each with one thread."""
    train: TrainConfig
    """How each network is trained; the number that varies and the seed are the experiment's."""

    def __post_init__(self) -> None:
        require_within(
            self,
            gamma=(1e-6, 1.0),
            first_seed=(0, 10**9),
            **dict.fromkeys(("runs", "sequences", "frames", "test_frames", "num_samples", "workers"), (1, 10**6)),
        )
        if not self.values or len({f"{value:g}" for value in self.values}) < len(self.values):
            raise VaporTrackError(f"{self.parameter}s are {self.values}, expected each at most once, and one")
        for value in self.values:
            self.varied(value)  # refuses what cannot be

    @property
    @abstractmethod
    def values(self) -> tuple[float, ...]:
        """Of the number."""

    @property
    def also_evaluated(self) -> int:
        """Images of those trained on that are evaluated as well, evenly spaced."""
        return 0

    @abstractmethod
    def varied(self, value: float) -> TrainConfig:
        """The training with this value.

        Raises:
            VaporTrackError: it cannot have that.
        """


class Sweep:
    """Training runs on the table scenes, one for each scene, value and seed; what is done is not done again.

    Args:
        scenes: Names among `MODES`.
        directory: For images and results.
        config: Settings.
        workers: Where jobs are done; None for as many processes here as configured.
    """

    def __init__(
        self, scenes: Sequence[str], directory: Path, config: SweepConfig, workers: Workers | None = None
    ) -> None:
        self.directory, self.config = directory, config
        self._workers = workers or Workers(config.workers)
        self._names = tuple(scenes)
        self._scenes: list[Scene] = []

    def render(self) -> Iterator[tuple[int, int]]:
        """Render the images that are missing; yields the number of walks done and of all."""
        c = self.config
        for done, total, scenes in render_scenes(
            self._names,
            self.directory,
            train_walks=c.sequences,
            train_frames=c.frames,
            test_walks=1,
            test_frames=c.test_frames,
            height=rendered_height(c.train.network.frame_size),
            workers=self._workers,
        ):
            self._scenes = scenes
            yield done, total

    def train(self) -> Iterator[dict[str, Any]]:
        """The result of every training run, in no order: as `carry_out`, and the value by the number's name."""
        c = self.config
        runs = [
            self._run(scene, value, seed)
            for seed in range(c.first_seed, c.first_seed + c.runs)  # interrupted, it has fewer runs of all
            for scene in self._scenes
            for value in c.values
        ]
        for result in carry_out(runs, self.directory, self._workers):
            yield result | {c.parameter: float(result["label"])}

    def samples(self, scene: str, value: float) -> tuple[Poses, list[Poses]]:
        """True poses of some test images and the posterior samples of each, of the first run with this value."""
        (found,) = (s for s in self._scenes if s.name == scene)
        return cached_samples(self._run(found, value, self.config.first_seed), self.directory)

    def _run(self, scene: Scene, value: float, seed: int) -> TrainingRun:
        c = self.config
        config = replace(c.varied(value), seed=seed)
        return TrainingRun(scene, f"{value:g}", config, c.gamma, c.num_samples, training_images=c.also_evaluated)


def in_order(results: Sequence[Mapping[str, Any]], parameter: str) -> list[Mapping[str, Any]]:
    """Results by scene, value and seed."""
    return sorted(results, key=lambda r: (r["scene"], r[parameter], r["seed"]))


def by_value(
    results: Sequence[Mapping[str, Any]], parameter: str, figure: Callable[[Mapping[str, Any]], float]
) -> dict[str, dict[float, list[float]]]:
    """A figure of results by scene and value, one for each run that could be trained."""
    table: dict[str, dict[float, list[float]]] = {}
    for result in in_order([result for result in results if "error" not in result], parameter):
        table.setdefault(result["scene"], {}).setdefault(result[parameter], []).append(figure(result))
    return table
