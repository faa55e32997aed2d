"""`vapor-benchmark localization`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro
from rich.table import Table

from vapor.benchmark import PROGRAM
from vapor.benchmark.commands.localization_tables import Summary, failures, said, tables
from vapor.benchmark.commands.outputs import claim_shared, publish_results
from vapor.benchmark.commands.scenes import SceneOptions, listed, with_help, write_summary
from vapor.benchmark.localization.benchmark import LocalizationBenchmark, LocalizationConfig
from vapor.benchmark.localization.summary import summarise
from vapor.benchmark.trials.kinds import KINDS
from vapor.commands.console import command_line, parse, show
from vapor.commands.progress import progress
from vapor.commands.workers import workers_for
from vapor.parallel.jobs import Workers
from vapor.reporting.html.page import Page, findings_page, write_page
from vapor.tracking.ablations import ABLATIONS

_CONFIG = with_help(
    LocalizationConfig,
    kinds=f"What happens in the runs. {listed({name: kind.meaning for name, kind in KINDS.items()})}.",
    ablations=f"Filters to run. {listed({name: ablation.meaning for name, ablation in ABLATIONS.items()})}.",
)


@dataclass(frozen=True, kw_only=True)
class Options(SceneOptions):
    """Localize many synthetic sequences, and count successes."""

    config: Annotated[LocalizationConfig, tyro.conf.arg(name="", constructor=_CONFIG)] = field(default_factory=_CONFIG)


def main(arguments: Sequence[str]) -> None:
    """Run the command."""
    o = parse("localization", Options, arguments, program=PROGRAM)
    with workers_for("localization", o.config.workers, o.scheduler, PROGRAM) as workers:
        _measure(o, workers, command_line("localization", arguments, PROGRAM))


def _measure(o: Options, workers: Workers, command: str) -> None:
    benchmark = LocalizationBenchmark(o.model_of, o.output, o.config, workers)
    claim_shared(o.output, "localization", workers, reads=o.files_read, overwrite=o.overwrite)
    with progress("choosing", "runs") as advance:
        trials = benchmark.choose(advance)
    with progress("rendering", "walks") as advance:
        for done, total in benchmark.record(trials):
            advance(done, total)
    results = []
    with progress("localizing", "runs") as advance:
        for result in benchmark.localize(trials):
            results.append(result)
            advance(len(results), len(trials) * len(o.config.ablations))
    results.sort(key=lambda result: (result["variant"], result["name"]))
    summary = summarise(results)
    write_summary(o, o.config.settings(), summary, results)
    printed, failed = [*tables(summary)], [*failures(summary)]
    write_page(o.output / "report.html", _page(o, summary, printed, failed, command))
    publish_results(o.output)
    for shown in [*printed, *failed]:
        show(shown)


def _page(o: Options, summary: Summary, printed: Sequence[Table], failed: Sequence[str], command: str) -> Page:
    parts: list[tuple[str, list[Table | str | Path]]] = []
    for table in printed:  # those without a title belong to the one before
        if table.title is not None:
            parts.append((str(table.title), []))
        parts[-1][1].append(table)
    parts.append(("Runs to look at", [*failed]))
    asked = f"{o.config.runs} runs of each kind ({', '.join(o.config.kinds)}), synthetic images, simulated odometry"
    settings = o.config.settings() | {"models": o.model_of}
    return findings_page(", ".join(o.scenes), asked, said(summary), parts, settings=settings, command=command)
