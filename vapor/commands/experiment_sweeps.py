"""`vapor-track experiment alpha` and `decay`: sweeps of one setting of training on the table scenes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
import tyro
from rich.box import SIMPLE_HEAD
from rich.table import Table
from tyro.extras import literal_type_from_choices

from filtering.errors import VaporTrackError
from filtering.se3 import Poses
from vapor.commands.console import Overwrite, SharedOutputPath, command_line, parse, show
from vapor.commands.experiment_progress import settings_of, trained
from vapor.commands.workers import Scheduler, claim_shared, publish_results, workers_for
from vapor.evaluation.trajectory import RIGHT, THRESHOLDS
from vapor.experiments.alpha import AlphaConfig
from vapor.experiments.decay import DecayConfig
from vapor.experiments.sweep import MODES, Sweep, by_value, in_order
from vapor.reporting.html.findings_page import findings_page
from vapor.reporting.html.page import write_page
from vapor.reporting.report import write_report

if TYPE_CHECKING:
    _Table = str
else:  # choices are known when this runs
    _Table = literal_type_from_choices(MODES)

_Tables = Annotated[tyro.conf.Positional[tuple[_Table, ...]], tyro.conf.arg(metavar="SCENE ...")]
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
    output: SharedOutputPath
    """Directory for images, results, report.html, alpha.json and pictures, or its URL; an interrupted experiment goes
    on."""
    overwrite: Overwrite = False
    scheduler: Scheduler = None
    threshold: _Threshold = "0.1m/10deg"
    """Limits of what is near the true pose, of the table and the pictures; alpha.json has all."""
    config: Annotated[AlphaConfig, tyro.conf.arg(name="")] = field(default_factory=AlphaConfig)

    def __post_init__(self) -> None:
        _require_once(self.scenes)


@dataclass(frozen=True)
class DecayOptions:
    """Train with many weight decays of the encoder, and measure modes, recall and densities."""

    output: SharedOutputPath
    """Directory for images, results, report.html, decay.json and pictures, or its URL; an interrupted experiment goes
    on."""
    overwrite: Overwrite = False
    scheduler: Scheduler = None
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


def run_alpha(arguments: Sequence[str]) -> None:
    """Run `experiment alpha`."""
    from vapor.experiments.sweep_pictures import draw_positions, draw_recall

    o = parse("experiment alpha", AlphaOptions, arguments)
    with workers_for("experiment alpha", o.config.workers, o.scheduler) as workers:
        reads = o.config.train.files_read
        claim_shared(o.output, "experiment alpha", workers, reads=reads, overwrite=o.overwrite)
        experiment = Sweep(o.scenes, o.output, o.config, workers)
        results = _swept(experiment, o.scenes)
    recalls = {threshold: by_value(results, "alpha", _recall(threshold)) for threshold in THRESHOLDS}
    medians = {threshold: _medians(table) for threshold, table in recalls.items()}
    report = {"settings": settings_of(o.config, o.scenes), "median_recall": medians, "runs": results}
    write_report(o.output / "alpha.json", report)
    shown = recalls[o.threshold]
    title = f"Fraction of images with at least {o.config.gamma:.0%} of the samples within {o.threshold}"
    papers = (o.threshold, o.config.gamma) == _PAPERS_RECALL
    pictures: list[Path] = []
    if shown:
        pictures.append(o.output / "recall.png")
        draw_recall(pictures[-1], shown, title=f"{title}, {o.config.runs} runs", paper=papers)
    some = [alpha for alpha in _HEAT_MAPS if alpha in o.config.alphas] or [o.config.alphas[0]]
    for scene in o.scenes:
        if posteriors := _posteriors(experiment, results, scene, some, "α"):
            pictures.append(o.output / f"positions-{scene}.png")
            draw_positions(pictures[-1], posteriors, scene)
    tables = [
        _alpha_table(f"{scene}, {MODES[scene]} modes: {title[0].lower()}{title[1:]}", by_alpha)
        for scene, by_alpha in shown.items()
    ]
    found = _Found("α", tables, _failed(results, "alpha", "α"), pictures)
    best = [f"{scene}: the recall is highest at α = {_best(by_alpha):g}." for scene, by_alpha in shown.items()]
    _tell(o.output, found, best, report["settings"], command_line("experiment", ["alpha", *arguments]))


def run_decay(arguments: Sequence[str]) -> None:
    """Run `experiment decay`."""
    from vapor.experiments.sweep_pictures import draw_decay, draw_positions

    o = parse("experiment decay", DecayOptions, arguments)
    with workers_for("experiment decay", o.config.workers, o.scheduler) as workers:
        reads = o.config.train.files_read
        claim_shared(o.output, "experiment decay", workers, reads=reads, overwrite=o.overwrite)
        experiment = Sweep(o.scenes, o.output, o.config, workers)
        results = _swept(experiment, o.scenes)
    medians = {
        images: {name: _medians(by_value(results, "decay", figure)) for name, figure in figures.items()}
        for images, figures in _decay_figures().items()
    }
    report = {"settings": settings_of(o.config, o.scenes), "medians": medians, "runs": results}
    write_report(o.output / "decay.json", report)
    pictures: list[Path] = []
    if medians["test"]["modes"]:
        pictures.append(o.output / "decay.png")
        draw_decay(pictures[-1], results, o.threshold)
    for scene in o.scenes:
        if posteriors := _posteriors(experiment, results, scene, o.config.decays, "weight decay"):
            images = [image for image in _IMAGES if image < o.config.test_frames]
            pictures.append(o.output / f"positions-{scene}.png")
            draw_positions(pictures[-1], posteriors, scene, images=images)
    tables = [_decay_table(scene, medians) for scene in medians["test"]["modes"]]
    found = _Found("weight decay", tables, _failed(results, "decay", "weight decay"), pictures)
    recall = medians["test"][f"recall {o.threshold}"]
    best = [
        f"{scene}: the recall of test images is highest at weight decay {max(by, key=lambda v: by[v])}."
        for scene, by in recall.items()
    ]
    _tell(o.output, found, best, report["settings"], command_line("experiment", ["decay", *arguments]))


@dataclass(frozen=True)
class _Found:
    """What a sweep shows: tables, what could not be trained, files of pictures."""

    symbol: str
    tables: list[Table]
    failed: list[str]
    pictures: list[Path]


def _tell(output: Path, found: _Found, best: Sequence[str], settings: Mapping[str, Any], command: str) -> None:
    """Write the page, publish all, and print what the page has."""
    parts: list[tuple[str, list[Table | str | Path]]] = [
        ("Figures", [*found.tables]),
        ("What could not be trained", [*found.failed]),
        ("Pictures", [*found.pictures]),
    ]
    asked = f"Many networks that differ in {found.symbol}, synthetic images"
    said = " ".join(best) or "No network could be trained."
    page = findings_page(f"A sweep of {found.symbol}", asked, said, parts, settings=settings, command=command)
    write_page(output / "report.html", page)
    publish_results(output)
    for shown in [*found.tables, *found.failed]:
        show(shown)


def _swept(experiment: Sweep, scenes: Sequence[str]) -> list[Mapping[str, Any]]:
    c = experiment.config
    results = trained(experiment, len(scenes) * len(c.values) * c.runs)
    return in_order(list(results), c.parameter)


def _posteriors(
    experiment: Sweep, results: Sequence[Mapping[str, Any]], scene: str, values: Sequence[float], symbol: str
) -> dict[str, tuple[Poses, list[Poses]]]:
    """Cached samples by the value, of the first runs; without those that could not be trained."""
    c = experiment.config
    done = {(r["scene"], r[c.parameter], r["seed"]) for r in results if "error" not in r}
    some = [value for value in sorted(values) if (scene, float(f"{value:g}"), c.first_seed) in done]
    return {f"{symbol} = {value:g}": experiment.samples(scene, value) for value in some}


def _recall(threshold: str) -> _Figure:
    return lambda result: result["recall"][threshold]


def _decay_figures() -> dict[str, dict[str, _Figure]]:
    """Figures of test images and of training images, by the name in decay.json."""
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


def _failed(results: Sequence[Mapping[str, Any]], parameter: str, symbol: str) -> list[str]:
    return [
        f"{r['scene']}, {symbol} = {r[parameter]:g}, seed {r['seed']}: {r['error']}" for r in results if "error" in r
    ]


def _best(by_value: Mapping[float, Sequence[float]]) -> float:
    return max(by_value, key=lambda value: float(np.median(by_value[value])))


def _alpha_table(title: str, by_alpha: dict[float, list[float]]) -> Table:
    table = Table("α", "median recall", "least", "most", title=title, title_justify="left", box=SIMPLE_HEAD)
    best = _best(by_alpha)
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
