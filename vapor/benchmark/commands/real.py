"""`vapor-benchmark real`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Any

import tyro

from filtering.errors import require_within
from vapor.benchmark import PROGRAM
from vapor.benchmark.commands.outputs import SharedOutputPath, claim_shared, publish_results
from vapor.benchmark.commands.real_tables import tables
from vapor.benchmark.real.benchmark import RealConfig, choose, measure, measure_rows
from vapor.benchmark.real.row import Row, RowContext
from vapor.benchmark.real.summary import summarise
from vapor.commands.console import Overwrite, parse, show
from vapor.commands.progress import progress
from vapor.commands.workers import Scheduler, workers_for
from vapor.parallel.jobs import Workers
from vapor.reporting.report import write_report


@dataclass(frozen=True)
class Options:
    """Localize recordings made by others: images, stored posteriors, and published estimates; some trained on first."""

    data: Path
    """Folder with the recordings; what is missing there is left out."""
    output: SharedOutputPath
    """Directory for models, sequences, recordings, results and summary.json, or its URL; an interrupted benchmark
    continues, and what was made with the same settings and code is not made again."""
    overwrite: Overwrite = False
    only: tuple[str, ...] = ()
    """Rows or groups of rows, such as tum_fr1 or stairs; all by default."""
    workers: int = 1
    """Rows at a time, each in a process of its own."""
    scheduler: Scheduler = None
    config: Annotated[RealConfig, tyro.conf.arg(name="")] = field(default_factory=RealConfig)

    def __post_init__(self) -> None:
        require_within(self, workers=(1, 10**6))


def main(arguments: Sequence[str]) -> None:
    """Run the command."""
    o = parse("real", Options, arguments, program=PROGRAM)
    rows, missing = choose(o.data, o.only)
    with workers_for("real", o.workers, o.scheduler, PROGRAM) as workers:
        claim_shared(o.output, "real", workers, reads=[o.data], overwrite=o.overwrite)
        for name, needs in missing.items():
            show(f"left out: {name}, for want of {', '.join(needs)}")
        results = _one_by_one(o, rows) if workers.are_this_process else _in_parallel(o, rows, workers)
    summary = summarise(results)
    settings = asdict(o.config) | {"data": o.data.name, "left_out": missing}
    write_report(o.output / "summary.json", {"settings": settings, "summary": summary, "draws": results})
    publish_results(o.output)
    for table in tables(summary):
        show("")
        show(table)


def _one_by_one(o: Options, rows: Sequence[Row]) -> list[dict[str, Any]]:
    results = []
    for row in rows:
        with progress(row.name, "") as told:
            context = RowContext(o.data, o.output, o.config.num_samples, o.config.network, told.at)
            for of_draw in measure([row], context, o.config):
                results += of_draw
    return results


def _in_parallel(o: Options, rows: Sequence[Row], workers: Workers) -> list[dict[str, Any]]:
    """As they would come one by one."""
    order = {row.name: number for number, row in enumerate(rows)}
    results = []
    with progress("measuring", "rows") as advance:
        for done, of_row in enumerate(measure_rows(rows, o.data, o.output, o.config, workers), start=1):
            results += of_row
            advance(done, len(rows))
    return sorted(results, key=lambda result: order[result["row"]])
