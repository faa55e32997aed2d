"""`vapor-benchmark real`."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Any

import tyro
from rich.box import SIMPLE_HEAD
from rich.table import Table

from filtering.errors import require_within
from vapor.benchmark import PROGRAM
from vapor.benchmark.commands.options import SharedOutputPath, claim_shared, publish_results
from vapor.benchmark.evaluation import LAST, LOCALIZING, OURS, SUCCESS_M, label
from vapor.benchmark.real.benchmark import Figure, RealConfig, choose, measure, measure_rows, summarise
from vapor.benchmark.real.row import RowContext
from vapor.benchmark.real.rows import Row
from vapor.commands.console import Overwrite, parse, show
from vapor.commands.progress import progress
from vapor.commands.workers import Scheduler, workers_for
from vapor.evaluation.consistency import REGIONS
from vapor.parallel.jobs import Workers
from vapor.reporting.report import write_report

Summary = Mapping[str, Mapping[str, Any]]

_RANGE = "where odometry is simulated: median of the draws, and below it the lowest and the highest"


def tables(summary: Summary) -> Iterator[Table]:
    """Errors of every method, how many images are right, alone and in sequences; how consistent the filter is."""
    yield _errors(summary)
    yield _right(summary)
    if any(part["sequences"] for row in summary.values() for part in row["sequences"].values()):
        yield _sequences(summary)
    yield _consistency(summary)
    if copied := {name: row for name, row in summary.items() if not row["sequences"]}:
        yield _copied(copied)


def _errors(summary: Summary) -> Table:
    table = _table("median error", *map(label, LOCALIZING))
    table.caption = _RANGE
    for name, row in summary.items():
        cells = []
        for method in LOCALIZING:
            each = row["methods"][method]
            turned = each["median_rotation_deg"][0]
            cells.append(_cell(each["median_translation_m"], _metres, f" m {turned:4.1f}°"))
        table.add_row(_named(name, row), *cells)
    return table


def _right(summary: Summary) -> Table:
    table = _table("right, within 0.3 m and 20°, %", *map(label, LOCALIZING))
    table.caption = "in brackets: off by more than 0.25 m. Both lengths times 30 in rows that are 30 times as large"
    for name, row in summary.items():
        cells = []
        for method in LOCALIZING:
            each = row["methods"][method]
            cells.append(_cell(each["right"], _percent, f" ({_percent(each['worse_than_0.25m'][0])})"))
        table.add_row(_named(name, row), *cells)
    return table


def _sequences(summary: Summary) -> Table:
    """A column for each length and limit, with the single image's figure before the filter's."""
    lengths = list(next(iter(summary.values()))["sequences"])
    columns = [f"{length} images\n{limit.replace('m', ' m')}" for length in lengths for limit in SUCCESS_M]
    table = _table("sequences from a flat prior that succeed: single image → filter, %", *columns)
    table.caption = (
        f"right at all of the last {LAST} images; in brackets the number of sequences."
        " Lengths times 30 in rows that are 30 times as large"
    )
    for name, row in summary.items():
        cells = []
        for part in row["sequences"].values():
            number = f" ({part['sequences']})"
            for limit in SUCCESS_M:
                alone, ours = (part["success"].get(method, {}).get(limit) for method in ("single_image", OURS))
                before = "" if alone is None else f"{_percent(alone[0])} → "
                cells.append(f"{before}{_cell(ours, _percent, number)}")
        table.add_row(_named(name, row), *cells)
    return table


def _consistency(summary: Summary) -> Table:
    regions = [f"in {region.replace('%', ' %')}" for region in REGIONS]
    table = _table("confidence of the filter, %", "converged", "of these\nwrong", *regions, "median\nNEES (5.3)")
    table.caption = "regions: of all images evaluated, and in brackets of those called converged"
    for name, row in summary.items():
        figures = row["filter"]
        cells = []
        for region in REGIONS:
            once = figures["coverage_converged"][region]
            cells.append(
                _cell(figures["coverage"][region], _percent, f" ({'–' if once is None else _percent(once[0])})")
            )
        table.add_row(
            _named(name, row),
            _cell(figures["converged"], _percent),
            _cell(figures["wrong"], _percent),
            *cells,
            _cell(figures["median_nees"], lambda nees: f"{nees:.1f}"),
        )
    return table


def _copied(summary: Summary) -> Table:
    """Of each method in how many draws it is right throughout, before the part that is there once is seen and after."""
    columns = [*map(label, LOCALIZING), "converged\nthroughout", "never\nconverged"]
    table = _table("copied places: draws in which every image is right, %", *columns)
    table.caption = (
        "images are real, the places are copies; before what is there once is seen: chance;"
        " 2 s after: that image alone; after: from it on"
    )
    for name, row in summary.items():
        draws = row["whole_draws"]
        figures = [*(draws["right"][method] for method in LOCALIZING), draws["converged"], draws["never_converged"]]
        table.add_row(_named(name, row), *map(_percent, figures))
    return table


def _table(title: str, *columns: str) -> Table:
    table = Table(title=title, title_justify="left", caption_justify="left", box=SIMPLE_HEAD, collapse_padding=True)
    table.add_column("", no_wrap=True)
    for column in columns:
        table.add_column(column, justify="right")
    return table


def _named(name: str, row: Mapping[str, Any]) -> str:
    draws = f" × {row['draws']}" if row["draws"] > 1 else ""
    return f"{name}\n  {row['images']} images{draws}"


def _cell(figure: Figure, number: Callable[[float], str], after: str = "") -> str:
    if figure is None:
        return "–"
    median, low, high = (number(value) for value in figure)
    return f"{median}{after}" if figure[1] == figure[2] else f"{median}{after}\n{low}–{high}"


def _metres(metres: float) -> str:
    return f"{metres:.{3 if metres < 1.0 else 2}f}"


def _percent(fraction: float) -> str:
    percent = 100.0 * fraction
    return f"{percent:.1f}" if 0.0 < percent < 9.95 or 90.05 < percent < 100.0 else f"{percent:.0f}"


@dataclass(frozen=True)
class Options:
    """Localize recordings made by others: images, stored posteriors, and published estimates; some trained on first."""

    data: Path
    """Folder with the recordings; rows without data are left out."""
    output: SharedOutputPath
    """Directory for models, sequences, recordings, results and summary.json, or its URL; an interrupted benchmark
    continues, and results of the same settings and code are kept."""
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
        with progress(row.name, "") as reported:
            context = RowContext(o.data, o.output, o.config.num_samples, o.config.network, reported.at)
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
