"""`vapor-track experiment`."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from itertools import chain
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import tyro
from rich.box import SIMPLE_HEAD
from rich.table import Table

from filtering.errors import VaporTrackError
from filtering.se3 import Poses
from sequences.atomic import atomic_output
from sequences.results import claim_folder
from vapor.commands.console import OutputPath, Overwrite, bar, parse, show, usage_error
from vapor.commands.named_settings import Preset, parse_named
from vapor.evaluation.trajectory import RIGHT, THRESHOLDS
from vapor.experiments.alpha import AlphaConfig
from vapor.experiments.decay import DecayConfig
from vapor.experiments.schedule import PAPER, SCHEDULES, Point, ScheduleConfig, ScheduleExperiment, summary
from vapor.experiments.sweep import MODES, Sweep, SweepConfig, by_value, in_order
from vapor.experiments.table import TableConfig, TableExperiment, markdown, parse_scene
from vapor.reporting.report import write_report
from vapor.training.presets import PRESETS
from vapor.training_data.entries import files_read

_Tables = Annotated[
    tyro.conf.Positional[tuple[Literal["round-table", "dinner-table"], ...]], tyro.conf.arg(metavar="SCENE ...")
]
_Threshold = Literal["0.1m/10deg", "0.2m/15deg", "0.3m/20deg"]

_Figure = Callable[[Mapping[str, Any]], float]

_HEAT_MAPS = (0.01, 0.2, 1.0)  # α of the paper's figure
_IMAGES = (0, 8, 16)  # of the test images that are kept, whose posteriors are drawn for every decay
_PAPERS_RECALL = ("0.1m/10deg", 0.1)  # threshold and γ of the paper's figure


@dataclass(frozen=True)
class AlphaOptions:
    """Train on the table scenes for many values of α, and measure recall."""

    scenes: _Tables
    """What the camera moves about."""
    output: OutputPath
    """Directory for images, results, alpha.json and pictures; an interrupted experiment goes on."""
    overwrite: Overwrite = False
    threshold: _Threshold = "0.1m/10deg"
    """Limits of what is near the true pose, of the table and the pictures; alpha.json has all."""
    config: Annotated[AlphaConfig, tyro.conf.arg(name="")] = field(default_factory=AlphaConfig)

    def __post_init__(self) -> None:
        _require_once(self.scenes)


@dataclass(frozen=True)
class DecayOptions:
    """Train with many weight decays of the encoder, and measure modes, recall and densities."""

    output: OutputPath
    """Directory for images, results, decay.json and pictures; an interrupted experiment goes on."""
    overwrite: Overwrite = False
    scenes: _Tables = ("round-table",)
    """What the camera moves about."""
    threshold: _Threshold = "0.3m/20deg"
    """Limits of what is near the true pose, of the picture; decay.json has all."""
    config: Annotated[DecayConfig, tyro.conf.arg(name="")] = field(default_factory=DecayConfig)

    def __post_init__(self) -> None:
        _require_once(self.scenes)


def _require_once(scenes: Sequence[str]) -> None:
    if not scenes or len(set(scenes)) < len(scenes):
        raise VaporTrackError(f"scenes are {', '.join(scenes) or 'none'}, expected each at most once, and one")


@dataclass(frozen=True)
class TableOptions:
    """Train every method on every scene, and measure recall, errors and densities."""

    scenes: Annotated[tyro.conf.Positional[tuple[str, ...]], tyro.conf.arg(metavar="SCENE ...")]
    """Synthetic scenes by name, or your own data: NAME=TRAIN,...=TEST,... with whatever `train` reads."""
    output: OutputPath
    """Directory for images, results, table.json and table.md; an interrupted experiment goes on."""
    overwrite: Overwrite = False
    preset: Preset = "demo"
    """Named settings of training, of which the options below change single ones; tables: small and fast, for the scenes
    of that name; paper-...: the paper's."""
    config: Annotated[TableConfig, tyro.conf.arg(name="")] = field(default_factory=TableConfig)


@dataclass(frozen=True)
class ScheduleOptions:
    """Train by our schedule and by the paper's, and compare images and time to the same recall.

    Both train the same network from the same weights, with the same α and unit of positions. The paper's schedule
    differs in rate, batches, samples an image, crops and arithmetic, and neither averages nor decays weights.
    """

    output: OutputPath
    """Directory for images, results, schedule.json and the picture; trainings that are done are not done again."""
    overwrite: Overwrite = False
    scene: Literal["staircase", "ceiling", "round-table", "dinner-table", "corridor"] = "staircase"
    """What the camera moves through."""
    preset: Preset = "demo"
    """Named settings of our training, of which the options below change single ones."""
    config: Annotated[ScheduleConfig, tyro.conf.arg(name="")] = field(default_factory=ScheduleConfig)


_OPTIONS = {"alpha": AlphaOptions, "decay": DecayOptions, "schedule": ScheduleOptions, "table": TableOptions}


def main(arguments: Sequence[str]) -> None:
    """Run the command."""
    kinds = {"alpha": _alpha, "decay": _decay, "schedule": _schedule, "table": _table}
    if arguments[:1] in (["-h"], ["--help"]):
        show(
            "usage: vapor-track experiment alpha|decay|schedule|table ...\n\nMany trainings; each has its own --help.\n"
        )
        show("\n".join(f"  {kind:<8} {options.__doc__}" for kind, options in _OPTIONS.items()))
        return
    if not arguments or arguments[0] not in kinds:
        usage_error("experiment", f"expected one of {', '.join(kinds)} first")
    kinds[arguments[0]](arguments[1:])


def _table(arguments: Sequence[str]) -> None:
    o = parse_named("experiment table", TableOptions, arguments, ("preset",), _table_config)
    scenes = [parse_scene(text) for text in o.scenes]
    reads = chain(o.config.train.files_read, files_read([entry for s in scenes for entry in (*s.train, *s.test)]))
    claim_folder(o.output, "experiment table", reads=reads, overwrite=o.overwrite)
    experiment = TableExperiment(scenes, o.output, o.config)
    order = {method: k for k, method in enumerate(o.config.methods)}
    settings = _settings(o.config, o.scenes)
    results: list[dict[str, Any]] = []
    for result in _trained(experiment, len(o.scenes) * len(o.config.methods) * o.config.seeds):
        results.append(result)
        results.sort(key=lambda r: (r["scene"], order[r["label"]], r["seed"]))
        write_report(o.output / "table.json", {"settings": settings, "runs": results})
        with atomic_output(o.output / "table.md") as partial:
            partial.write_text(markdown(results, o.config.gamma), encoding="utf-8")
    show(markdown(results, o.config.gamma))


def _alpha(arguments: Sequence[str]) -> None:
    from vapor.experiments.sweep_pictures import draw_positions, draw_recall

    o = parse("experiment alpha", AlphaOptions, arguments)
    claim_folder(o.output, "experiment alpha", reads=o.config.train.files_read, overwrite=o.overwrite)
    experiment = Sweep(o.scenes, o.output, o.config)
    results = _swept(experiment, o.scenes)
    recalls = {threshold: by_value(results, "alpha", _recall(threshold)) for threshold in THRESHOLDS}
    medians = {threshold: _medians(table) for threshold, table in recalls.items()}
    report = {"settings": _settings(o.config, o.scenes), "median_recall": medians, "runs": results}
    write_report(o.output / "alpha.json", report)
    shown = recalls[o.threshold]
    title = f"Share of images with at least {o.config.gamma:.0%} of the samples within {o.threshold}"
    papers = (o.threshold, o.config.gamma) == _PAPERS_RECALL
    if shown:
        draw_recall(o.output / "recall.png", shown, title=f"{title}, {o.config.runs} runs", paper=papers)
    some = [alpha for alpha in _HEAT_MAPS if alpha in o.config.alphas] or [o.config.alphas[0]]
    for scene in o.scenes:
        if posteriors := _posteriors(experiment, results, scene, some, "α"):
            draw_positions(o.output / f"positions-{scene}.png", posteriors, scene)
    for scene, by_alpha in shown.items():
        show(_alpha_table(f"{scene}, {MODES[scene]} modes: {title[0].lower()}{title[1:]}", by_alpha))
    _show_failed(results, "alpha", "α")


def _decay(arguments: Sequence[str]) -> None:
    from vapor.experiments.sweep_pictures import draw_decay, draw_positions

    o = parse("experiment decay", DecayOptions, arguments)
    claim_folder(o.output, "experiment decay", reads=o.config.train.files_read, overwrite=o.overwrite)
    experiment = Sweep(o.scenes, o.output, o.config)
    results = _swept(experiment, o.scenes)
    medians = {
        images: {name: _medians(by_value(results, "decay", figure)) for name, figure in figures.items()}
        for images, figures in _decay_figures().items()
    }
    report = {"settings": _settings(o.config, o.scenes), "medians": medians, "runs": results}
    write_report(o.output / "decay.json", report)
    if medians["test"]["modes"]:
        draw_decay(o.output / "decay.png", results, o.threshold)
    for scene in o.scenes:
        if posteriors := _posteriors(experiment, results, scene, o.config.decays, "weight decay"):
            images = [image for image in _IMAGES if image < o.config.test_frames]
            draw_positions(o.output / f"positions-{scene}.png", posteriors, scene, images=images)
    for scene in medians["test"]["modes"]:
        show(_decay_table(scene, medians))
    _show_failed(results, "decay", "weight decay")


def _schedule(arguments: Sequence[str]) -> None:
    from vapor.experiments.schedule_pictures import draw_courses

    o = parse_named("experiment schedule", ScheduleOptions, arguments, ("preset",), _schedule_config)
    claim_folder(o.output, "experiment schedule", reads=o.config.train.files_read, overwrite=o.overwrite)
    experiment = ScheduleExperiment(o.scene, o.output, o.config)
    _render(experiment)
    courses: dict[str, list[Point]] = {}
    with bar("training") as advance:
        for schedule in SCHEDULES:
            courses[schedule] = experiment.train(schedule, advance)
    figures = summary(courses)
    runs = {schedule: [asdict(point) for point in course] for schedule, course in courses.items()}
    write_report(o.output / "schedule.json", {"settings": _settings(o.config, [o.scene]), **figures, "courses": runs})
    title = f"{o.scene}: share of the samples of held-out images within {RIGHT}"
    draw_courses(o.output / "schedule.png", courses, title=title)
    table = Table("schedule", "images seen", "time", "share", title=title, title_justify="left", box=SIMPLE_HEAD)
    for schedule in courses:
        own = figures[schedule]
        missed = "" if own["reached"] else f", {figures['recall']:.1%} not reached"
        table.add_row(schedule, f"{own['images']}", f"{own['seconds'] / 60:.1f} min", f"{own['recall']:.1%}{missed}")
    show(table)
    least = "" if figures[PAPER]["reached"] else "at least "
    ratios = f"{figures['times_images']:.1f} times the images and {figures['times_seconds']:.1f} times the time"
    show(f"the paper's schedule takes {least}{ratios}")


def _table_config(preset: str) -> TableConfig:
    return TableConfig(train=PRESETS[preset])


def _schedule_config(preset: str) -> ScheduleConfig:
    return ScheduleConfig(train=PRESETS[preset])


def _swept(experiment: Sweep, scenes: Sequence[str]) -> list[Mapping[str, Any]]:
    c = experiment.config
    results = _trained(experiment, len(scenes) * len(c.values) * c.runs)
    return in_order(list(results), c.parameter)


def _posteriors(
    experiment: Sweep, results: Sequence[Mapping[str, Any]], scene: str, values: Sequence[float], symbol: str
) -> dict[str, tuple[Poses, list[Poses]]]:
    """Kept samples by the value, of the first runs; without those that could not be trained."""
    c = experiment.config
    done = {(r["scene"], r[c.parameter], r["seed"]) for r in results if "error" not in r}
    some = [value for value in sorted(values) if (scene, float(f"{value:g}"), c.first_seed) in done]
    return {f"{symbol} = {value:g}": experiment.samples(scene, value) for value in some}


def _recall(threshold: str) -> _Figure:
    return lambda result: result["recall"][threshold]


def _decay_figures() -> dict[str, dict[str, _Figure]]:
    """What is told of test images and of training images, by the name in decay.json."""
    figures: dict[str, _Figure] = {
        "modes": lambda r: r["modes"],
        **{f"recall {threshold}": _recall(threshold) for threshold in THRESHOLDS},
        f"mode_recall {RIGHT}": lambda r: r["mode_recall"][RIGHT],
        "negative_log_density": lambda r: r["negative_log_density"],
    }
    of_training: dict[str, _Figure] = {
        name: lambda r, figure=figure: figure(r["training"]) for name, figure in figures.items()
    }
    return {"test": figures, "training": of_training}


def _medians(table: Mapping[str, Mapping[float, Sequence[float]]]) -> dict[str, dict[str, float]]:
    return {scene: {f"{v:g}": float(np.median(runs)) for v, runs in by.items()} for scene, by in table.items()}


def _show_failed(results: Sequence[Mapping[str, Any]], parameter: str, symbol: str) -> None:
    for r in results:
        if "error" in r:
            show(f"{r['scene']}, {symbol} = {r[parameter]:g}, seed {r['seed']}: {r['error']}")


def _render(experiment: Sweep | ScheduleExperiment | TableExperiment) -> None:
    with bar("rendering") as advance:
        for done, total in experiment.render():
            advance(done, total)


def _trained(experiment: Sweep | TableExperiment, total: int) -> Iterator[dict[str, Any]]:
    """Render and train with progress; the result of every training as it is done."""
    _render(experiment)
    with bar("training") as advance:
        for done, result in enumerate(experiment.train(), start=1):
            yield result
            advance(done, total)


def _alpha_table(title: str, by_alpha: dict[float, list[float]]) -> Table:
    table = Table("α", "median recall", "least", "most", title=title, title_justify="left", box=SIMPLE_HEAD)
    best = max(by_alpha, key=lambda alpha: np.median(by_alpha[alpha]))
    for alpha, recalls in by_alpha.items():
        figures = [f"{value:.2f}" for value in (np.median(recalls), min(recalls), max(recalls))]
        table.add_row(f"{alpha:g}", *figures, style="bold" if alpha == best else None)
    return table


def _decay_table(scene: str, medians: Mapping[str, Mapping[str, Mapping[str, Mapping[str, float]]]]) -> Table:
    title = f"{scene}, {MODES[scene]} modes: medians of test images, and of training images"
    names = ["weight decay", "modes", *(f"recall {t}" for t in THRESHOLDS), f"best mode {RIGHT}", "−log p̂"]
    table = Table(*names, title=title, title_justify="left", box=SIMPLE_HEAD)
    for decay in medians["test"]["modes"][scene]:
        cells = [decay]
        for name in medians["test"]:
            pair = (medians[images][name][scene][decay] for images in ("test", "training"))
            cells.append(", ".join(f"{value:.2f}" for value in pair))
        table.add_row(*cells)
    return table


def _settings(config: SweepConfig | ScheduleConfig | TableConfig, scenes: Sequence[str]) -> dict[str, Any]:
    train = {key: str(value) if isinstance(value, Path) else value for key, value in asdict(config.train).items()}
    return asdict(config) | {"train": train, "scenes": list(scenes)}
