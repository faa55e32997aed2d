"""How recall depends on α, the share of the samples that learn: the ablation of Zangeneh et al. (ICRA 2023)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

from filtering.errors import VaporTrackError, require_within
from filtering.se3 import Poses
from vapor.experiments.trainings import Scene, Training, height_to_cover, kept_samples, render_scenes, run_trainings
from vapor.network import NetworkConfig
from vapor.train_config import TrainConfig

MODES: Mapping[str, int] = MappingProxyType({"round-table": 4, "dinner-table": 2})
"""Scenes of the ablation, and how many poses look alike in each, by construction."""

PAPER_ALPHAS = (0.01, *(round(0.05 * k, 2) for k in range(1, 21)))
"""α of the paper's figure."""

_HEIGHT = 96  # pixels of the images as they are rendered, at least


@dataclass(frozen=True)
class AlphaConfig:
    """Settings of the experiment."""

    alphas: tuple[float, ...] = PAPER_ALPHAS
    """Shares of the samples that learn."""
    runs: int = 10
    """Trainings for each α; they differ in initial weights, order, augmentation and latent noise."""
    first_seed: int = 0
    """Seed of the first of them."""
    gamma: float = 0.1
    """Share of an image's samples that must be near its true pose for it to count as right."""
    sequences: int = 4
    """Walks about the table that are trained on."""
    frames: int = 500
    """Images of each."""
    test_frames: int = 300
    """Images of the walk that is tested on."""
    num_samples: int = 1000
    """Posterior samples per test image."""
    workers: int = 2
    """Trainings at a time, each with one thread."""
    train: TrainConfig = field(
        default_factory=lambda: TrainConfig(
            network=NetworkConfig(image_width=64, image_height=48, shortest_edge=52),
            epochs=30,
            calibrate=False,
            validation_share=0.0,
        )
    )
    """How each network is trained; α and seed are the experiment's."""

    def __post_init__(self) -> None:
        require_within(
            self,
            gamma=(1e-6, 1.0),
            first_seed=(0, 10**9),
            **dict.fromkeys(("runs", "sequences", "frames", "test_frames", "num_samples", "workers"), (1, 10**6)),
        )
        if not self.alphas or len(set(self.alphas)) < len(self.alphas):
            raise VaporTrackError(f"alphas are {self.alphas}, expected each at most once, and one")
        for alpha in self.alphas:
            replace(self.train.loss, alpha=alpha)  # refuses what is no share
            if alpha * self.train.loss.num_samples < 1.0 - 1e-9:
                raise VaporTrackError(
                    f"alpha {alpha} of {self.train.loss.num_samples} samples leaves none to learn,"
                    f" expected at least {1 / self.train.loss.num_samples:.3g}"
                )


class AlphaExperiment:
    """Trainings on the table scenes, one for each scene, α and run; what is done is not done again.

    Args:
        scenes: Names among `MODES`.
        directory: For images and results.
        config: Settings.
    """

    def __init__(self, scenes: Sequence[str], directory: Path, config: AlphaConfig) -> None:
        self.directory, self.config = directory, config
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
            height=height_to_cover(c.train.network.frame_size, _HEIGHT),
            workers=c.workers,
        ):
            self._scenes = scenes
            yield done, total

    def train(self) -> Iterator[dict[str, Any]]:
        """The result of every training, in no order: as `run_trainings`, and `alpha`."""
        c = self.config
        trainings = [
            self._training(scene, alpha, seed)
            for seed in range(c.first_seed, c.first_seed + c.runs)  # interrupted, it has fewer runs of all
            for scene in self._scenes
            for alpha in c.alphas
        ]
        for result in run_trainings(trainings, self.directory, c.workers):
            yield result | {"alpha": float(result["label"])}

    def samples(self, scene: str, alpha: float) -> tuple[Poses, list[Poses]]:
        """True poses of some test images and the posterior samples of each, of the first run with this α."""
        (found,) = (s for s in self._scenes if s.name == scene)
        return kept_samples(self._training(found, alpha, self.config.first_seed), self.directory)

    def _training(self, scene: Scene, alpha: float, seed: int) -> Training:
        c = self.config
        config = replace(c.train, loss=replace(c.train.loss, alpha=alpha), seed=seed, resume=False)
        return Training(scene, f"{alpha:g}", config, c.gamma, c.num_samples)


def recalls_by_alpha(results: Sequence[Mapping[str, Any]], threshold: str) -> dict[str, dict[float, list[float]]]:
    """Recalls within a threshold by scene and α, one for each run that could be trained."""
    table: dict[str, dict[float, list[float]]] = {}
    done = [result for result in results if "error" not in result]
    for result in sorted(done, key=lambda r: (r["scene"], r["alpha"], r["seed"])):
        table.setdefault(result["scene"], {}).setdefault(result["alpha"], []).append(result["recall"][threshold])
    return table
