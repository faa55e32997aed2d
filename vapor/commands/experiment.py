"""`vapor-track experiment`: which one, and those of whole methods and schedules."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from itertools import chain
from typing import TYPE_CHECKING, Annotated, Any

import tyro
from rich.box import SIMPLE_HEAD
from rich.table import Table
from tyro.extras import literal_type_from_choices

from sequences.atomic import atomic_output
from sequences.outputs.claims import claim_folder
from sequences.scenes import SCENES
from vapor.commands.console import OutputPath, Overwrite, SharedOutputPath, command_line, show, usage_error
from vapor.commands.experiment_progress import render, settings_of, trained
from vapor.commands.experiment_sweeps import AlphaOptions, DecayOptions, run_alpha, run_decay
from vapor.commands.named_settings import Preset, parse_named
from vapor.commands.progress import progress
from vapor.commands.terminal import overview, write
from vapor.commands.workers import Scheduler, claim_shared, publish_results, workers_for
from vapor.evaluation.trajectory import RIGHT
from vapor.experiments.schedule import PAPER, SCHEDULES, Point, ScheduleConfig, ScheduleExperiment, summary
from vapor.experiments.table import TableConfig, TableExperiment, failures, markdown, parse_scene, scene_tables
from vapor.parallel.jobs import Workers
from vapor.reporting.html import page as html
from vapor.reporting.html.findings_page import findings_page
from vapor.reporting.html.page import Page, write_page
from vapor.reporting.report import write_report
from vapor.training.presets import PRESETS
from vapor.training_data.entries import files_read

if TYPE_CHECKING:
    _Scene = str
else:  # choices are known when this runs
    _Scene = literal_type_from_choices(SCENES)


@dataclass(frozen=True)
class TableOptions:
    """Train every method on every scene, and measure recall, errors and densities."""

    scenes: Annotated[tyro.conf.Positional[tuple[str, ...]], tyro.conf.arg(metavar="SCENE ...")]
    """Synthetic scenes by name, or your own data: NAME=TRAIN,...=TEST,... with whatever `train` reads."""
    output: SharedOutputPath
    """Directory for images, results, report.html, table.json and table.md, or its URL; an interrupted experiment goes
    on."""
    overwrite: Overwrite = False
    scheduler: Scheduler = None
    preset: Preset = "demo"
    """Named settings of training, of which the options below change single ones; tables: small and fast, for the scenes
    of that name; paper-...: the paper's."""
    config: Annotated[TableConfig, tyro.conf.arg(name="")] = field(default_factory=TableConfig)


@dataclass(frozen=True)
class ScheduleOptions:
    """Train by our schedule and by the paper's, and compare images and time to the same recall.

    Both train the same network from the same weights, with the same α and unit of positions. The paper's schedule
    differs in rate, batches, samples an image, crops and arithmetic, sees whole images only, and neither averages nor
    decays weights.
    """

    output: OutputPath
    """Directory for images, results, report.html, schedule.json and the picture; what is trained already is not trained
    again."""
    overwrite: Overwrite = False
    scene: _Scene = "staircase"
    """What the camera moves through."""
    preset: Preset = "demo"
    """Named settings of our training, of which the options below change single ones."""
    config: Annotated[ScheduleConfig, tyro.conf.arg(name="")] = field(default_factory=ScheduleConfig)


KINDS = {
    "alpha": AlphaOptions,
    "decay": DecayOptions,
    "schedule": ScheduleOptions,
    "table": TableOptions,
}
"""The kinds by name, with their options, whose docstring says what they do."""


def main(arguments: Sequence[str]) -> None:
    """Run the command."""
    kinds = {
        "alpha": run_alpha,
        "decay": run_decay,
        "schedule": _schedule,
        "table": _table,
    }
    if arguments[:1] in (["-h"], ["--help"]):
        meanings = {kind: (options.__doc__ or "").split("\n", 1)[0] for kind, options in KINDS.items()}
        write(overview("vapor-track experiment KIND", "Many training runs; each kind has its own --help.", meanings))
        return
    if not arguments or arguments[0] not in kinds:
        usage_error("experiment", f"expected one of {', '.join(kinds)} first")
    kinds[arguments[0]](arguments[1:])


def _table(arguments: Sequence[str]) -> None:
    o = parse_named("experiment table", TableOptions, arguments, ("preset",), _table_config)
    with workers_for("experiment table", o.config.workers, o.scheduler) as workers:
        _fill_table(o, workers, arguments)


def _fill_table(o: TableOptions, workers: Workers, arguments: Sequence[str]) -> None:
    scenes = [parse_scene(text) for text in o.scenes]
    reads = chain(o.config.train.files_read, files_read([entry for s in scenes for entry in (*s.train, *s.test)]))
    claim_shared(o.output, "experiment table", workers, reads=reads, overwrite=o.overwrite)
    experiment = TableExperiment(scenes, o.output, o.config, workers)
    order = {method: k for k, method in enumerate(o.config.methods)}
    settings = settings_of(o.config, o.scenes)
    results: list[dict[str, Any]] = []
    for result in trained(experiment, len(o.scenes) * len(o.config.methods) * o.config.seeds):
        results.append(result)
        results.sort(key=lambda r: (r["scene"], order[r["label"]], r["seed"]))
        write_report(o.output / "table.json", {"settings": settings, "runs": results})
        with atomic_output(o.output / "table.md") as partial:
            partial.write_text(markdown(results, o.config.gamma), encoding="utf-8")
    command = command_line("experiment", ["table", *arguments])
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
    parts = [(each.scene, [html.Table(each.columns, each.rows, each.measured)]) for each in tables]
    best = [f"{each.scene}: {each.best} has the highest recall within {RIGHT}, {each.best_recall}." for each in tables]
    said = " ".join(best) or "No network could be trained."
    asked = f"{len(results)} networks: every method on every scene, the same budget"
    failed = ("What could not be trained", failures(results))
    return findings_page("Regressors side by side", asked, said, [*parts, failed], settings=settings, command=command)


def _schedule(arguments: Sequence[str]) -> None:
    from vapor.experiments.schedule_pictures import draw_courses

    o = parse_named("experiment schedule", ScheduleOptions, arguments, ("preset",), _schedule_config)
    claim_folder(o.output, "experiment schedule", reads=o.config.train.files_read, overwrite=o.overwrite)
    experiment = ScheduleExperiment(o.scene, o.output, o.config)
    render(experiment)
    courses: dict[str, list[Point]] = {}
    for schedule in SCHEDULES:
        with progress(f"training, {schedule}", "steps") as advance:
            courses[schedule] = experiment.train(schedule, advance)
    figures = summary(courses)
    runs = {schedule: [asdict(point) for point in course] for schedule, course in courses.items()}
    write_report(o.output / "schedule.json", {"settings": settings_of(o.config, [o.scene]), **figures, "courses": runs})
    title = f"{o.scene}: fraction of the samples of held-out images within {RIGHT}"
    draw_courses(o.output / "schedule.png", courses, title=title)
    table = Table("schedule", "images seen", "time", "fraction", title=title, title_justify="left", box=SIMPLE_HEAD)
    for schedule in courses:
        own = figures[schedule]
        missed = "" if own["reached"] else f", {figures['recall']:.1%} not reached"
        table.add_row(schedule, f"{own['images']}", f"{own['seconds'] / 60:.1f} min", f"{own['recall']:.1%}{missed}")
    least = "" if figures[PAPER]["reached"] else "at least "
    ratios = f"{figures['times_images']:.1f} times the images and {figures['times_seconds']:.1f} times the time"
    said = f"the paper's schedule takes {least}{ratios}"
    parts = [("Time to the same recall", [table, o.output / "schedule.png"])]
    settings, command = settings_of(o.config, [o.scene]), command_line("experiment", ["schedule", *arguments])
    asked = f"{o.scene}: the same network, trained by our schedule and by the paper's"
    sentence = f"{said[0].upper()}{said[1:]}."
    page = findings_page("Two schedules", asked, sentence, parts, settings=settings, command=command)
    write_page(o.output / "report.html", page)
    show(table)
    show(said)


def _table_config(preset: str) -> TableConfig:
    return TableConfig(train=PRESETS[preset])


def _schedule_config(preset: str) -> ScheduleConfig:
    return ScheduleConfig(train=PRESETS[preset])
