"""`vapor-benchmark regressors`: methods side by side."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from itertools import chain
from pathlib import Path
from typing import Annotated

import tyro

from filtering.errors import require_within
from sequences.outputs import claim_folder
from sequences.reader import SequenceReader
from sequences.scenes import is_scene, scene_names
from vapor.benchmark import PROGRAM
from vapor.benchmark.commands.options import require_each_once
from vapor.benchmark.jobs import completed
from vapor.benchmark.regressors.table import best_methods, failures, scene_tables
from vapor.benchmark.regressors.training_runs import Scene, TrainingRun, carry_out, rendered_height
from vapor.benchmark.rendered import RenderedWalk
from vapor.commands.console import OutputPath, Overwrite, command_line, show
from vapor.commands.train import Preset, parse_named
from vapor.reporting.html.page import findings_page, write_page
from vapor.reporting.report import write_report
from vapor.training.config import TrainConfig
from vapor.training.presets import METHODS, PRESETS
from vapor.training_data.entries import files_read, parse_entry, require_no_leakage
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
        require_each_once("methods", self.methods, METHODS)

    def synthetic_walks(self, scene: str) -> list[RenderedWalk]:
        """The walks of a synthetic scene, first those that are trained on."""
        height = rendered_height(self.train.network.frame_size)
        train = [RenderedWalk(scene, "train", seed, self.frames, height) for seed in range(self.sequences)]
        test = [RenderedWalk(scene, "test", seed, self.test_frames, height) for seed in range(self.test_sequences)]
        return [*train, *test]

    def runs(self, scenes: Sequence[Scene]) -> list[TrainingRun]:
        """A training run for each scene, method and seed; the label is the method."""
        return [
            TrainingRun(
                scene,
                method,
                replace(METHODS[method](self.train), seed=seed),
                self.gamma,
                self.num_samples,
                self.localize,
            )
            for seed in range(self.first_seed, self.first_seed + self.seeds)
            for scene in scenes
            for method in self.methods
        ]


@dataclass(frozen=True)
class Options:
    """Train every method on every scene, and measure recall, errors and densities."""

    scenes: Annotated[tyro.conf.Positional[tuple[str, ...]], tyro.conf.arg(metavar="SCENE ...")]
    """Synthetic scenes by name, or your own data: NAME=TRAIN,...=TEST,... with whatever `train` reads."""
    output: OutputPath
    """Directory for images, results, report.html and table.json; an interrupted call goes on."""
    overwrite: Overwrite = False
    preset: Preset = "demo"
    """Named settings of training, of which the options below change single ones; tables: small and fast, for the scenes
    of that name; paper-...: the paper's."""
    config: Annotated[TableConfig, tyro.conf.arg(name="")] = field(default_factory=TableConfig)


def main(arguments: Sequence[str]) -> None:
    """Run the command."""
    o = parse_named("regressors", Options, arguments, ("preset",), _config, PROGRAM)
    c = o.config
    asked = [parse_scene(text) for text in o.scenes]
    reads = chain(c.train.files_read, files_read([entry for s in asked for entry in (*s.train, *s.test)]))
    claim_folder(o.output, f"{PROGRAM} regressors", reads=reads, overwrite=o.overwrite)
    check_scenes(asked, c)
    walks = [(walk, o.output) for scene in asked if not scene.train for walk in c.synthetic_walks(scene.name)]
    completed("rendering", "walks", RenderedWalk.render, walks, c.workers)
    runs = c.runs([with_files(scene, c, o.output) for scene in asked])
    results = completed("training", "networks", carry_out, [(run, o.output) for run in runs], c.workers)
    results.sort(key=lambda result: (result["scene"], c.methods.index(result["label"]), result["seed"]))
    train = {key: str(value) if isinstance(value, Path) else value for key, value in asdict(c.train).items()}
    settings = asdict(c) | {"train": train, "scenes": list(o.scenes)}
    write_report(o.output / "table.json", {"settings": settings, "runs": results})
    tables, failed = scene_tables(results, c.gamma), failures(results)
    page = findings_page(
        "Regressors side by side",
        f"{len(results)} networks: every method on every scene, the same budget",
        " ".join(best_methods(results)) or "No network could be trained.",
        [*((scene, [table]) for scene, table in tables.items()), ("What could not be trained", failed)],
        settings=settings,
        command=command_line("regressors", arguments, PROGRAM),
    )
    write_page(o.output / "report.html", page)
    for shown in [*tables.values(), *failed]:
        show(shown)


def _config(preset: str) -> TableConfig:
    return TableConfig(train=PRESETS[preset])


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


def check_scenes(scenes: Sequence[Scene], config: TableConfig) -> None:
    """Check scenes from `parse_scene` before anything is rendered or trained.

    Raises:
        TrainingError: a scene is tested on images that it is trained on.
        VaporTrackError: no scene, one twice, or test data that cannot be read.
    """
    require_each_once("scenes", [scene.name for scene in scenes])
    for scene in scenes:
        require_no_leakage(scene.train, scene.test)
        if config.train.validation_fraction > 0:
            require_no_leakage(scene.train)
        for entry in scene.test if config.localize else ():
            SequenceReader(parse_entry(entry)[0])


def with_files(scene: Scene, config: TableConfig, directory: Path) -> Scene:
    """The scene with its files, which are rendered ones of a synthetic scene."""
    if scene.train:
        return scene
    files = [str(walk.file(directory)) for walk in config.synthetic_walks(scene.name)]
    return Scene(scene.name, tuple(files[: config.sequences]), tuple(files[config.sequences :]))
