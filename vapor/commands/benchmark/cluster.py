"""`vapor-track benchmark cluster`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated

import tyro

from vapor.benchmark.cluster import ClusterConfig, measure
from vapor.commands.benchmark.cells import new_table
from vapor.commands.console import parse, show
from vapor.commands.progress import progress
from vapor.commands.workers import hush_dask

_MANY = 1000


@dataclass(frozen=True)
class Options:
    """Measure what more nodes gain, with delays in place of work, and how many one scheduler keeps busy."""

    config: Annotated[ClusterConfig, tyro.conf.arg(name="")] = field(default_factory=ClusterConfig)


def main(arguments: Sequence[str]) -> None:
    """Run the command."""
    config = parse("benchmark cluster", Options, arguments).config
    hush_dask()
    table = new_table(
        f"{config.jobs} jobs for each node, of {config.seconds:g} s on average",
        "nodes",
        *("time", "jobs at\na time", "effi-\nciency", "scheduler,\na job"),
    )
    scalings = []
    with progress("measuring", "sizes of clusters") as advance:
        for scaling in measure(config):
            scalings.append(scaling)
            advance(len(scalings), len(config.nodes))
            s = scaling
            cells = f"{s.wall_s:.1f} s", f"{s.speed_up:.2f}", f"{s.efficiency:.2f}", f"{1000 * s.scheduling_s:.2f} ms"
            table.add_row(str(s.nodes), *cells)
    show(table)
    last = scalings[-1]
    busy, least_s = config.seconds / last.scheduling_s, _MANY * last.scheduling_s
    show(f"one scheduler keeps at most {busy:.0f} nodes at work with such jobs")
    most = last.efficiency_of(_MANY, config.seconds)
    show(f"{_MANY} nodes: efficiency at most {most:.2f}; jobs of {least_s:.1f} s or more keep all of them at work")
