"""`vapor-track benchmark real`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from sequences.outputs.claims import claim_folder
from vapor.benchmark.real.benchmark import RealConfig, choose, measure
from vapor.benchmark.real.row import RowContext
from vapor.benchmark.real.summary import summarise
from vapor.commands.benchmark.real_tables import tables
from vapor.commands.console import OutputPath, Overwrite, parse, progress_of, show
from vapor.reporting.report import write_report
from vapor.stored_names import with_stored_names


@dataclass(frozen=True)
class Options:
    """Localize recordings made by others: images, stored posteriors, and published estimates; some trained on first."""

    data: Path
    """Folder with the recordings; what is missing there is left out."""
    output: OutputPath
    """Directory for models, sequences, recordings, results and summary.json; an interrupted benchmark continues, and
    what was made with the same settings and code is not made again."""
    overwrite: Overwrite = False
    only: tuple[str, ...] = ()
    """Rows or groups of rows, such as tum_fr1 or stairs; all by default."""
    config: Annotated[RealConfig, tyro.conf.arg(name="")] = field(default_factory=RealConfig)


def main(arguments: Sequence[str]) -> None:
    """Run the command."""
    o = parse("benchmark real", Options, arguments)
    rows, missing = choose(o.data, o.only)
    claim_folder(o.output, "benchmark real", reads=[o.data], overwrite=o.overwrite)
    for name, needs in missing.items():
        show(f"left out: {name}, for want of {', '.join(needs)}")
    results = []
    for row in rows:
        with progress_of(row.name) as advance:
            context = RowContext(o.data, o.output, o.config.num_samples, o.config.network, advance)
            for of_draw in measure([row], context, o.config):
                results += of_draw
    summary = summarise(results)
    settings = with_stored_names(asdict(o.config) | {"data": o.data.name, "left_out": missing})
    write_report(o.output / "summary.json", {"settings": settings, "summary": summary, "draws": results})
    for table in tables(summary):
        show("")
        show(table)
