"""`vapor-track experiment`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import tyro
from rich.box import SIMPLE_HEAD
from rich.table import Table

from filtering.errors import VaporTrackError
from sequences.atomic import atomic_output
from vapor.commands.console import bar, parse, show, usage_error
from vapor.evaluate import THRESHOLDS
from vapor.experiments.alpha import MODES, AlphaConfig, AlphaExperiment, recalls_by_alpha
from vapor.experiments.table import TableConfig, TableExperiment, markdown, parse_scene
from vapor.report import write_report

_HEAT_MAPS = (0.01, 0.2, 1.0)  # α of the paper's figure
_PAPERS_RECALL = ("0.1m/10deg", 0.1)  # threshold and γ of the paper's figure


@dataclass(frozen=True)
class AlphaOptions:
    """Train on the table scenes for many values of α, and measure recall."""

    scenes: Annotated[
        tyro.conf.Positional[tuple[Literal["round-table", "dinner-table"], ...]], tyro.conf.arg(metavar="SCENE ...")
    ]
    """What the camera moves about."""
    output: Path
    """Directory for images, results, alpha.json and pictures; an interrupted experiment goes on."""
    threshold: Literal["0.1m/10deg", "0.2m/15deg", "0.3m/20deg"] = "0.1m/10deg"
    """Limits of what is near the true pose, of the table and the pictures; alpha.json has all."""
    config: Annotated[AlphaConfig, tyro.conf.arg(name="")] = field(default_factory=AlphaConfig)

    def __post_init__(self) -> None:
        if not self.scenes or len(set(self.scenes)) < len(self.scenes):
            raise VaporTrackError(f"scenes are {', '.join(self.scenes) or 'none'}, expected each at most once, and one")


@dataclass(frozen=True)
class TableOptions:
    """Train every method on every scene, and measure recall, errors and densities."""

    scenes: Annotated[tyro.conf.Positional[tuple[str, ...]], tyro.conf.arg(metavar="SCENE ...")]
    """Synthetic scenes by name, or your own data: NAME=TRAIN,...=TEST,... with whatever `train` reads."""
    output: Path
    """Directory for images, results, table.json and table.md; an interrupted experiment goes on."""
    config: Annotated[TableConfig, tyro.conf.arg(name="")] = field(default_factory=TableConfig)


_OPTIONS = {"alpha": AlphaOptions, "table": TableOptions}


def main(arguments: Sequence[str]) -> None:
    """Run the command."""
    kinds = {"alpha": _alpha, "table": _table}
    if arguments[:1] in (["-h"], ["--help"]):
        show("usage: vapor-track experiment alpha|table ...\n\nMany trainings; each of the two has its own --help.\n")
        show("\n".join(f"  {kind:<6} {options.__doc__}" for kind, options in _OPTIONS.items()))
        return
    if not arguments or arguments[0] not in kinds:
        usage_error("experiment", f"expected one of {', '.join(kinds)} first")
    kinds[arguments[0]](arguments[1:])


def _table(arguments: Sequence[str]) -> None:
    o = parse("experiment table", TableOptions, arguments)
    experiment = TableExperiment([parse_scene(text) for text in o.scenes], o.output, o.config)
    order = {method: k for k, method in enumerate(o.config.methods)}
    settings = _settings(o.config, o.scenes)
    results: list[dict[str, Any]] = []
    for result in _trained(experiment, o.output, len(o.scenes) * len(o.config.methods) * o.config.seeds):
        results.append(result)
        results.sort(key=lambda r: (r["scene"], order[r["label"]], r["seed"]))
        write_report(o.output / "table.json", {"settings": settings, "runs": results})
        with atomic_output(o.output / "table.md") as partial:
            partial.write_text(markdown(results, o.config.gamma), encoding="utf-8")
    show(markdown(results, o.config.gamma))


def _alpha(arguments: Sequence[str]) -> None:
    from vapor.experiments.alpha_pictures import draw_positions, draw_recall

    o = parse("experiment alpha", AlphaOptions, arguments)
    experiment = AlphaExperiment(o.scenes, o.output, o.config)
    results = list(_trained(experiment, o.output, len(o.scenes) * len(o.config.alphas) * o.config.runs))
    results.sort(key=lambda r: (r["scene"], r["alpha"], r["seed"]))
    failed = [result for result in results if "error" in result]
    recalls = {threshold: recalls_by_alpha(results, threshold) for threshold in THRESHOLDS}
    medians = {
        threshold: {scene: {f"{a:g}": float(np.median(r)) for a, r in by.items()} for scene, by in table.items()}
        for threshold, table in recalls.items()
    }
    report = {"settings": _settings(o.config, o.scenes), "median_recall": medians, "runs": results}
    write_report(o.output / "alpha.json", report)
    shown = recalls[o.threshold]
    title = f"Share of images with at least {o.config.gamma:.0%} of the samples within {o.threshold}"
    papers = (o.threshold, o.config.gamma) == _PAPERS_RECALL
    draw_recall(o.output / "recall.png", shown, title=f"{title}, {o.config.runs} runs", paper=papers)
    for scene in o.scenes:
        some = [alpha for alpha in _HEAT_MAPS if alpha in o.config.alphas] or [o.config.alphas[0]]
        some = [alpha for alpha in some if not any((r["scene"], r["alpha"]) == (scene, alpha) for r in failed)]
        if some:
            posteriors = {alpha: experiment.samples(scene, alpha) for alpha in some}
            draw_positions(o.output / f"positions-{scene}.png", posteriors, scene, image=0)
    for scene, by_alpha in shown.items():
        show(_alpha_table(f"{scene}, {MODES[scene]} modes: {title[0].lower()}{title[1:]}", by_alpha))
    for result in failed:
        show(f"{result['scene']}, α = {result['alpha']:g}, seed {result['seed']}: {result['error']}")


def _trained(experiment: AlphaExperiment | TableExperiment, output: Path, total: int) -> Iterator[dict[str, Any]]:
    """Render and train with progress; the result of every training as it is done."""
    output.mkdir(parents=True, exist_ok=True)
    with bar("rendering") as advance:
        for done, number in experiment.render():
            advance(done, number)
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


def _settings(config: AlphaConfig | TableConfig, scenes: Sequence[str]) -> dict[str, Any]:
    train = {key: str(value) if isinstance(value, Path) else value for key, value in asdict(config.train).items()}
    return asdict(config) | {"train": train, "scenes": list(scenes)}
