"""Every method on every scene with the same encoder, data and budget: the paper's two tables."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from filtering.errors import VaporTrackError, require_within
from sequences.reader import SequenceReader
from sequences.scenes import is_scene, scene_names
from vapor.benchmark.regressors.training_runs import Scene, TrainingRun, carry_out, render_scenes, rendered_height
from vapor.evaluation.trajectory import RIGHT, THRESHOLDS
from vapor.parallel.jobs import Workers
from vapor.training.config import TrainConfig
from vapor.training.presets import METHODS
from vapor.training_data.entries import parse_entry, require_no_leakage
from vapor.training_data.training_set import TrainingError


@dataclass(frozen=True)
class TableConfig:
    """Settings of the table."""

    methods: tuple[str, ...] = tuple(name for name in METHODS if name != "retrieval")
    """Methods, as of `vapor-track train --method`."""
    seeds: int = 3
    """Training runs of each method on each scene."""
    first_seed: int = 0
    """Seed of the first of them."""
    gamma: float = 0.1
    """Fraction of an image's samples that must be near its true pose for it to count as right."""
    sequences: int = 10
    """Synthetic scenes: sequences that are trained on."""
    frames: int = 500
    """Images of each."""
    test_sequences: int = 2
    """Synthetic scenes: sequences that are tested on."""
    test_frames: int = 300
    """Images of each."""
    num_samples: int = 1000
    """Posterior samples per test image."""
    localize: bool = False
    """Run the particle filter over the test sequences with every trained model, too; they need odometry."""
    workers: int = 2
    """Training runs at a time, each with one thread."""
    train: TrainConfig = field(default_factory=TrainConfig)
    """How each network is trained; method and seed are the table's."""

    def __post_init__(self) -> None:
        counts = ("seeds", "sequences", "frames", "test_sequences", "test_frames", "num_samples", "workers")
        require_within(self, gamma=(1e-6, 1.0), first_seed=(0, 10**9), **dict.fromkeys(counts, (1, 10**6)))
        if not self.methods or len(set(self.methods)) < len(self.methods):
            raise VaporTrackError(
                f"methods are {', '.join(self.methods) or 'none'}, expected each at most once, and one"
            )
        for method in self.methods:
            if method not in METHODS:
                raise VaporTrackError(f"unknown method {method!r}, expected one of {', '.join(METHODS)}")


def parse_scene(text: str) -> Scene:
    """A scene from the command line: the name of a synthetic one, or `NAME=TRAIN,...=TEST,...`.

    Raises:
        TrainingError: neither.
    """
    if is_scene(text):
        return Scene(text, (), ())
    name, *data = text.split("=")
    train, test = (tuple(part.split(",")) for part in data) if len(data) == 2 else ((), ())
    if not re.fullmatch(r"[\w.-]+", name) or not train or not all([*train, *test]):
        expected = "or NAME=TRAIN,...=TEST,... with your own data"
        raise TrainingError(f"{text}: expected one of {', '.join(scene_names())}, {expected}")
    return Scene(name, train, test)


class TableExperiment:
    """One training run for each scene, method and seed; finished ones are kept.

    Args:
        scenes: From `parse_scene`.
        directory: For images and results.

    Raises:
        TrainingError: a scene is tested on images that it is trained on.
        VaporTrackError: no scene, one twice, or test data that cannot be read.
    """

    def __init__(
        self, scenes: Sequence[Scene], directory: Path, config: TableConfig, workers: Workers | None = None
    ) -> None:
        self.directory, self.config = directory, config
        self._workers = workers or Workers(config.workers)
        self._scenes = {scene.name: scene for scene in scenes}
        if not scenes or len(self._scenes) < len(scenes):
            names = ", ".join(scene.name for scene in scenes)
            raise VaporTrackError(f"scenes are {names or 'none'}, expected each at most once, and one")
        for scene in scenes:
            require_no_leakage(scene.train, scene.test)
            if config.train.validation_fraction > 0:
                require_no_leakage(scene.train)
        if config.localize:  # unreadable sequences are refused now, not after training
            for entry in (entry for scene in scenes for entry in scene.test):
                SequenceReader(parse_entry(entry)[0])

    def render(self) -> Iterator[tuple[int, int]]:
        """Render the synthetic images that are missing; yields the number of sequences done and of all."""
        c = self.config
        synthetic = [name for name, scene in self._scenes.items() if not scene.train]
        for done, total, scenes in render_scenes(
            synthetic,
            self.directory,
            train_walks=c.sequences,
            train_frames=c.frames,
            test_walks=c.test_sequences,
            test_frames=c.test_frames,
            height=rendered_height(c.train.network.frame_size),
            workers=self._workers,
        ):
            self._scenes |= {scene.name: scene for scene in scenes}
            yield done, total

    def train(self) -> Iterator[dict[str, Any]]:
        """The result of every training run, in no order: as `carry_out`; the label is the method."""
        c = self.config
        yield from carry_out(
            [
                TrainingRun(scene, method, self._train_config(method, seed), c.gamma, c.num_samples, c.localize)
                for seed in range(c.first_seed, c.first_seed + c.seeds)
                for scene in self._scenes.values()
                for method in c.methods
            ],
            self.directory,
            self._workers,
        )

    def _train_config(self, method: str, seed: int) -> TrainConfig:
        return replace(METHODS[method](self.config.train), seed=seed)


@dataclass(frozen=True)
class SceneTable:
    """Results of the methods on one scene: medians over the seeds, and for recall of several its least and most.

    Attributes:
        scene: Its name.
        measured: On what, in words.
        columns: Headings.
        rows: Cells, the first the method's name.
        best: The method with the highest median recall at the widest threshold.
        best_recall: That recall, in words.
    """

    scene: str
    measured: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    best: str
    best_recall: str


def scene_tables(results: Sequence[Mapping[str, Any]], gamma: float) -> list[SceneTable]:
    """The table of every scene."""
    return [
        _scene_table(scene, [result for result in results if "error" not in result and result["scene"] == scene], gamma)
        for scene in dict.fromkeys(result["scene"] for result in results if "error" not in result)
    ]


def _scene_table(scene: str, rows: Sequence[Mapping[str, Any]], gamma: float) -> SceneTable:
    seeds = len({row["seed"] for row in rows})
    counted = "1 seed" if seeds == 1 else f"{seeds} seeds"
    filtered = any("filter" in row for row in rows)
    columns = ["method", *(f"recall {t}" for t in THRESHOLDS), f"best mode {RIGHT}", f"any sample {RIGHT}"]
    columns += ["median error of the mean", "of the best mode", "−log p̂", "modes"]
    if filtered:
        columns += ["filter: success", "median error", "converged, of these wrong", "smoothed: success"]
    lines: list[tuple[str, ...]] = []
    methods = dict.fromkeys(row["label"] for row in rows)
    by_method = {method: [row for row in rows if row["label"] == method] for method in methods}
    for method, own in by_method.items():
        cells = [method, *(_spread([row["recall"][t] for row in own]) for t in THRESHOLDS)]
        cells += [_percent([row[kind][RIGHT] for row in own]) for kind in ("mode_recall", "oracle_recall")]
        cells += [_error([row[kind] for row in own]) for kind in ("mean", "mode")]
        exact = [row["exact_negative_log_density"] for row in own if row["exact_negative_log_density"] is not None]
        of_samples = f"{np.median([row['negative_log_density'] for row in own]):.2f}"
        cells.append(f"{of_samples} (exact {np.median(exact):.2f})" if exact else of_samples)
        cells.append(f"{np.median([row['modes'] for row in own]):.1f}")
        if filtered:
            cells += _filtered([report for row in own for report in row["filter"]])
        lines.append((*cells, f"{np.median([row['seconds'] for row in own]) / 60:.1f} min"))
    recalls = {method: [row["recall"][RIGHT] for row in own] for method, own in by_method.items()}
    best = max(recalls, key=lambda method: float(np.median(recalls[method])))
    measured = f"{rows[0]['images']} test images, {counted}, γ = {gamma:g}"
    return SceneTable(scene, measured, (*columns, "training"), tuple(lines), best, _percent(recalls[best]))


def failures(results: Sequence[Mapping[str, Any]]) -> list[str]:
    """A line for each network that could not be trained."""
    return [f"{r['scene']}, {r['label']}, seed {r['seed']}: {r['error']}" for r in results if "error" in r]


def markdown(results: Sequence[Mapping[str, Any]], gamma: float) -> str:
    """The tables as Markdown."""
    lines: list[str] = []
    for table in scene_tables(results, gamma):
        lines += [f"**{table.scene}**, {table.measured}", ""]
        lines += ["| " + " | ".join(table.columns) + " |", "|---" * len(table.columns) + "|"]
        lines += ["| " + " | ".join(cells) + " |" for cells in table.rows]
        lines.append("")
    return "\n".join([*lines, *failures(results)])


def _filtered(reports: Sequence[Mapping[str, Any]]) -> list[str]:
    """Of reports of runs: how many succeed, errors, and how far `converged` can be trusted."""
    runs = [report["filter"] for report in reports]
    converged = [report["consistency"]["images"] for report in reports]
    wrong = [report["consistency"]["wrong"] or 0.0 for report in reports]  # None where it never converged
    images = sum(report["frames_with_true_pose"] for report in reports)
    return [
        f"{sum(bool(run['success']) for run in runs)} of {len(runs)}",
        _error([{k: run[f"median_{k}"] for k in ("translation_m", "rotation_deg")} for run in runs]),
        f"{100 * sum(converged) / images:.0f} %, {_percentage(np.dot(converged, wrong), sum(converged))}",
        f"{sum(bool(report['smoothed']['success']) for report in reports)} of {len(runs)}",
    ]


def _percentage(part: float, whole: int) -> str:
    return f"{100 * part / whole:.0f} %" if whole else "–"


def _percent(values: Sequence[float]) -> str:
    return f"{100 * float(np.median(values)):.0f} %"


def _spread(values: Sequence[float]) -> str:
    spread = f" ({100 * min(values):.0f}-{100 * max(values):.0f})" if len(values) > 1 else ""
    return _percent(values) + spread


def _error(errors: Sequence[Mapping[str, float]]) -> str:
    metres, degrees = (np.median([error[name] for error in errors]) for name in ("translation_m", "rotation_deg"))
    return f"{metres:.2f} m, {degrees:.1f}°"
