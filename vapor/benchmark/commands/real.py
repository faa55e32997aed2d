"""`vapor-benchmark real`."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Any

import tyro
from rich.table import Table

from filtering.errors import require_within
from sequences.outputs import claim_folder
from vapor.benchmark import PROGRAM
from vapor.benchmark.evaluation import LAST, LOCALIZING, OURS, SUCCESS_M, label
from vapor.benchmark.figures import UNKNOWN, Aggregate, Figure, Number, above, table_of
from vapor.benchmark.jobs import completed
from vapor.benchmark.real.benchmark import choose, measure, summarise
from vapor.benchmark.real.row import RealConfig, RowContext
from vapor.commands.console import OutputPath, Overwrite, parse, show
from vapor.evaluation.consistency import REGIONS
from vapor.reporting.report import write_report

Summary = Mapping[str, Aggregate]

_RANGE = "where odometry is simulated: median of the draws, and below it the lowest and the highest"


@dataclass(frozen=True)
class Options:
    """Localize recordings made by others: images, stored posteriors, and published estimates; some trained on first."""

    data: Path
    """Folder with the recordings; rows without data are left out."""
    output: OutputPath
    """Directory for models, sequences, recordings, results and summary.json; an interrupted benchmark continues, and
    results of the same settings and code are kept."""
    overwrite: Overwrite = False
    only: tuple[str, ...] = ()
    """Rows or groups of rows, such as tum_fr1 or stairs; all by default."""
    workers: int = 1
    """Rows at a time, each in a process of its own."""
    config: Annotated[RealConfig, tyro.conf.arg(name="")] = field(default_factory=RealConfig)

    def __post_init__(self) -> None:
        require_within(self, workers=(1, 10**6))


def main(arguments: Sequence[str]) -> None:
    """Run the command."""
    o = parse("real", Options, arguments, program=PROGRAM)
    rows, missing = choose(o.data, o.only)
    claim_folder(o.output, f"{PROGRAM} real", reads=[o.data], overwrite=o.overwrite)
    for name, needs in missing.items():
        show(f"left out: {name}, for want of {', '.join(needs)}")
    context = RowContext(o.data, o.output, o.config)
    of_rows = completed("measuring", "rows", measure, [(row, context) for row in rows], o.workers)
    results: list[dict[str, Any]] = [result for of_row in of_rows for result in of_row]
    summary = summarise(results)
    settings = asdict(o.config) | {"data": o.data.name, "left_out": missing}
    write_report(o.output / "summary.json", {"settings": settings, "summary": summary, "draws": results})
    for table in tables(summary):
        show("")
        show(table)


def tables(summary: Summary) -> Iterator[Table]:
    """Errors of every method, how many images are right, alone and in sequences; how consistent the filter is."""
    yield _table("median error", _of_methods(_error), summary, _RANGE)
    yield _table(
        "right, within 0.3 m and 20°, %",
        _of_methods(_right),
        summary,
        "in brackets: off by more than 0.25 m. Both lengths times 30 in rows that are 30 times as large",
    )
    if any(part["sequences"] for row in summary.values() for part in row["sequences"].values()):
        yield _sequences(summary)
    for of, heading in (("filter", "the filter"), ("smoothed", "the smoothed poses")):
        confidence = {name: row[of] for name, row in summary.items()}
        yield _table(
            f"confidence of {heading}, %",
            {
                "converged": lambda row: _cell(row["converged"], _percent),
                "of these\nwrong": lambda row: _cell(row["wrong"], _percent),
                **{f"in {region.replace('%', ' %')}": _covered(region) for region in REGIONS},
                "median\nNEES (5.3)": lambda row: _cell(row["median_nees"], lambda nees: f"{nees:.1f}"),
            },
            summary,
            "regions: of all images evaluated, and in brackets of those called converged",
            confidence,
        )
    if copied := {name: row for name, row in summary.items() if not row["sequences"]}:
        yield _table(
            "copied places: draws in which every image is right, %",
            {
                **{label(method): _right_throughout(method) for method in LOCALIZING},
                "converged\nthroughout": lambda row: _percent(row["whole_draws"]["converged"]),
                "never\nconverged": lambda row: _percent(row["whole_draws"]["never_converged"]),
            },
            copied,
            "images are real, the places are copies; before what is there once is seen: chance;"
            " 2 s after: that image alone; after: from it on",
        )


def _table(
    title: str,
    columns: dict[str, Callable[[Aggregate], str]],
    summary: Summary,
    caption: str,
    values: Summary | None = None,
) -> Table:
    """A row of `values` for each row of the summary, or of the summary itself."""
    rows = {}
    for name, row in summary.items():
        draws = f" × {row['draws']}" if row["draws"] > 1 else ""
        rows[f"{name}\n  {row['images']} images{draws}"] = row if values is None else values[name]
    table = table_of(title, "", columns, rows)
    table.caption = caption
    return table


def _of_methods(cell: Callable[[Aggregate], str]) -> dict[str, Callable[[Aggregate], str]]:
    def of(method: str) -> Callable[[Aggregate], str]:
        return lambda row: cell(row["methods"][method])

    return {label(method): of(method) for method in LOCALIZING}


def _error(method: Aggregate) -> str:
    return _cell(method["median_translation_m"], _metres, f" m {method['median_rotation_deg'].value:4.1f}°")


def _right(method: Aggregate) -> str:
    return _cell(method["right"], _percent, f" ({_percent(method['worse_than_0.25m'].value)})")


def _covered(region: str) -> Callable[[Aggregate], str]:
    def of(row: Aggregate) -> str:
        sure = row["coverage_converged"][region].value
        return _cell(row["coverage"][region], _percent, f" ({'–' if sure is None else _percent(sure)})")

    return of


def _right_throughout(method: str) -> Callable[[Aggregate], str]:
    return lambda row: _percent(row["whole_draws"]["right"][method])


def _sequences(summary: Summary) -> Table:
    """A column for each length and limit, with the single image's figure before the filter's."""

    def of(length: str, limit: str) -> Callable[[Aggregate], str]:
        def cell(row: Aggregate) -> str:
            part = row["sequences"].get(length)
            if part is None:
                return ""
            alone, ours = (part["success"].get(method, {}).get(limit, UNKNOWN) for method in ("single_image", OURS))
            before = "" if alone.value is None else f"{_percent(alone.value)} → "
            number = f" ({part['sequences']})"
            return f"{before}{_cell(ours, _percent, number)}"

        return cell

    columns = {
        f"{length} images\n{limit.replace('m', ' m')}": of(length, limit)
        for length in next(row["sequences"] for row in summary.values() if row["sequences"])
        for limit in SUCCESS_M
    }
    title = "sequences from a flat prior that succeed: single image → filter, %"
    caption = (
        f"right at all of the last {LAST} images; in brackets the number of sequences."
        " Lengths times 30 in rows that are 30 times as large"
    )
    return _table(title, columns, summary, caption)


def _cell(figure: Figure, number: Callable[[Number], str], after: str = "") -> str:
    return "–" if figure.value is None else above(f"{number(figure.value)}{after}", figure, number)


def _metres(metres: Number) -> str:
    return f"{metres:.{3 if metres < 1.0 else 2}f}"


def _percent(fraction: Number) -> str:
    percent = 100.0 * fraction
    return f"{percent:.1f}" if 0.0 < percent < 9.95 or 90.05 < percent < 100.0 else f"{percent:.0f}"
