"""`vapor-track experiment landmarks`: which parts landmarks are best made of."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Any

import tyro
from rich.box import SIMPLE_HEAD
from rich.table import Table

from sequences.atomic import atomic_output
from vapor.commands.console import Overwrite, SharedOutputPath, command_line, parse, show
from vapor.commands.progress import progress
from vapor.commands.workers import Scheduler, claim_shared, publish_results, workers_for
from vapor.experiments.landmark_tables import in_order, markdown, tables, verdict
from vapor.experiments.landmarks import PartsConfig, features_left_out, measured, walks_of
from vapor.reporting.html import page as html
from vapor.reporting.html.findings_page import findings_page
from vapor.reporting.html.page import write_page
from vapor.reporting.report import write_report


@dataclass(frozen=True)
class LandmarksOptions:
    """Localize real images by landmarks made of other local features, and with other solvers of poses."""

    data: Path
    """Folder with the recordings of `benchmark real`; what is missing there is left out."""
    output: SharedOutputPath
    """Directory for results, report.html, landmarks.json and landmarks.md, or its URL; an interrupted experiment goes
    on."""
    overwrite: Overwrite = False
    scheduler: Scheduler = None
    config: Annotated[PartsConfig, tyro.conf.arg(name="")] = field(default_factory=PartsConfig)


def run_landmarks(arguments: Sequence[str]) -> None:
    """Run `experiment landmarks`."""
    o = parse("experiment landmarks", LandmarksOptions, arguments)
    walks, missing = walks_of(o.data, o.config.recordings)
    left_out = [*missing, *features_left_out(o.config.features)]
    cells: list[Mapping[str, Any]] = []
    with workers_for("experiment landmarks", o.config.workers, o.scheduler) as workers:
        claim_shared(o.output, "experiment landmarks", workers, reads=[o.data], overwrite=o.overwrite)
        for line in left_out:
            show(line)
        settings = asdict(o.config) | {"data": o.data.name, "left_out": left_out}
        with progress("localizing", "maps") as advance:
            for done, of_map in enumerate(measured(walks, o.output, o.config, workers), start=1):
                cells = in_order([*cells, *of_map], o.config)
                write_report(o.output / "landmarks.json", {"settings": settings, "cells": cells})
                with atomic_output(o.output / "landmarks.md") as partial:
                    partial.write_text(markdown(cells, left_out), encoding="utf-8")
                advance(done, len(walks) * len(o.config.features) - len(left_out) + len(missing))
    parts = [(each.recording, [html.Table(each.columns, each.rows, each.measured)]) for each in tables(cells)]
    command = command_line("experiment", ["landmarks", *arguments])
    asked = "Real images, as they are and disturbed: landmarks of several kinds, no network"
    page = findings_page(
        "Parts of landmarks",
        asked,
        verdict(cells) or "No kind of features could be measured.",
        [*parts, ("Left out", left_out)],
        settings=settings,
        command=command,
    )
    write_page(o.output / "report.html", page)
    publish_results(o.output)
    for each in tables(cells):
        table = Table(*each.columns, title=f"{each.recording}, {each.measured}", title_justify="left", box=SIMPLE_HEAD)
        for row in each.rows:
            table.add_row(*row)
        show(table)
    show(verdict(cells))
