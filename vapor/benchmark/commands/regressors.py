"""`vapor-benchmark regressors`: methods side by side."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from itertools import chain
from pathlib import Path
from typing import Annotated, Any

import tyro
from rich.box import SIMPLE_HEAD
from rich.table import Table

from sequences.atomic import atomic_output
from vapor.benchmark import PROGRAM
from vapor.benchmark.commands.options import SharedOutputPath, claim_shared, publish_results
from vapor.benchmark.regressors.table import TableConfig, TableExperiment, failures, markdown, parse_scene, scene_tables
from vapor.commands.console import Overwrite, command_line, show
from vapor.commands.progress import progress
from vapor.commands.train import Preset, parse_named
from vapor.commands.workers import Scheduler, workers_for
from vapor.evaluation.trajectory import RIGHT
from vapor.parallel.jobs import Workers
from vapor.reporting.html import page as html
from vapor.reporting.html.page import Page, findings_page, write_page
from vapor.reporting.report import write_report
from vapor.training.config import TrainConfig
from vapor.training.presets import PRESETS
from vapor.training_data.entries import files_read


@dataclass(frozen=True)
class Options:
    """Train every method on every scene, and measure recall, errors and densities."""

    scenes: Annotated[tyro.conf.Positional[tuple[str, ...]], tyro.conf.arg(metavar="SCENE ...")]
    """Synthetic scenes by name, or your own data: NAME=TRAIN,...=TEST,... with whatever `train` reads."""
    output: SharedOutputPath
    """Directory for images, results, report.html, table.json and table.md, or its URL; an interrupted call goes
    on."""
    overwrite: Overwrite = False
    scheduler: Scheduler = None
    preset: Preset = "demo"
    """Named settings of training, of which the options below change single ones; tables: small and fast, for the scenes
    of that name; paper-...: the paper's."""
    config: Annotated[TableConfig, tyro.conf.arg(name="")] = field(default_factory=TableConfig)


def main(arguments: Sequence[str]) -> None:
    """Run the command."""
    o = parse_named("regressors", Options, arguments, ("preset",), _config, PROGRAM)
    with workers_for("regressors", o.config.workers, o.scheduler, PROGRAM) as workers:
        _fill_table(o, workers, command_line("regressors", arguments, PROGRAM))


def _fill_table(o: Options, workers: Workers, command: str) -> None:
    scenes = [parse_scene(text) for text in o.scenes]
    reads = chain(o.config.train.files_read, files_read([entry for s in scenes for entry in (*s.train, *s.test)]))
    claim_shared(o.output, "regressors", workers, reads=reads, overwrite=o.overwrite)
    experiment = TableExperiment(scenes, o.output, o.config, workers)
    order = {method: k for k, method in enumerate(o.config.methods)}
    settings = asdict(o.config) | {"train": _stored(o.config.train), "scenes": list(o.scenes)}
    results: list[dict[str, Any]] = []
    with progress("rendering", "walks") as advance:
        for done, total in experiment.render():
            advance(done, total)
    with progress("training", "networks") as advance:
        for result in experiment.train():
            results.append(result)
            results.sort(key=lambda r: (r["scene"], order[r["label"]], r["seed"]))
            write_report(o.output / "table.json", {"settings": settings, "runs": results})
            with atomic_output(o.output / "table.md") as partial:
                partial.write_text(markdown(results, o.config.gamma), encoding="utf-8")
            advance(len(results), len(o.scenes) * len(o.config.methods) * o.config.seeds)
    write_page(o.output / "report.html", _table_page(results, o.config.gamma, settings, command))
    publish_results(o.output)
    for each in scene_tables(results, o.config.gamma):
        table = Table(*each.columns, title=f"{each.scene}, {each.measured}", title_justify="left", box=SIMPLE_HEAD)
        for cells in each.rows:
            table.add_row(*cells)
        show(table)
    for line in failures(results):
        show(line)


def _table_page(results: Sequence[Mapping[str, Any]], gamma: float, settings: Mapping[str, Any], command: str) -> Page:
    tables = scene_tables(results, gamma)
    parts = [(each.scene, [html.table(each.columns, each.rows, each.measured)]) for each in tables]
    best = [f"{each.scene}: {each.best} has the highest recall within {RIGHT}, {each.best_recall}." for each in tables]
    headline = " ".join(best) or "No network could be trained."
    asked = f"{len(results)} networks: every method on every scene, the same budget"
    failed = ("What could not be trained", failures(results))
    return findings_page(
        "Regressors side by side", asked, headline, [*parts, failed], settings=settings, command=command
    )


def _stored(config: TrainConfig) -> dict[str, Any]:
    return {key: str(value) if isinstance(value, Path) else value for key, value in asdict(config).items()}


def _config(preset: str) -> TableConfig:
    return TableConfig(train=PRESETS[preset])
