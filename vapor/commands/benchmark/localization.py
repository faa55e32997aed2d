"""`vapor-track benchmark localization`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated

import tyro

from vapor.benchmark.localization.benchmark import LocalizationBenchmark, LocalizationConfig
from vapor.benchmark.localization.summary import summarise
from vapor.benchmark.trials.kinds import KINDS
from vapor.commands.benchmark.localization_tables import failures, tables
from vapor.commands.benchmark.scenes import SceneOptions, listed, with_help, write_summary
from vapor.commands.console import bar, parse, show
from vapor.commands.workers import claim_shared, publish_results, workers_for
from vapor.parallel.jobs import Workers
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
    o = parse("benchmark localization", Options, arguments)
    with workers_for("benchmark localization", o.config.workers, o.scheduler) as workers:
        _measure(o, workers)


def _measure(o: Options, workers: Workers) -> None:
    benchmark = LocalizationBenchmark(o.model_of, o.output, o.config, o.replaced, workers)
    claim_shared(o.output, "benchmark localization", workers, reads=o.files_read, overwrite=o.overwrite)
    with bar("choosing runs") as advance:
        trials = benchmark.choose(advance)
    with bar("recording") as advance:
        for done, total in benchmark.record(trials):
            advance(done, total)
    results = []
    with bar("localizing") as advance:
        for result in benchmark.localize(trials):
            results.append(result)
            advance(len(results), len(trials) * len(o.config.ablations))
    results.sort(key=lambda result: (result["variant"], result["name"]))
    summary = summarise(results)
    write_summary(o, o.config.settings(), summary, results)
    publish_results(o.output)
    for table in tables(summary):
        show(table)
    for line in failures(summary):
        show(line)
