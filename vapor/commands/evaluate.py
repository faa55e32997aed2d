"""`vapor-track evaluate`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from vapor.commands.console import parse, show
from vapor.evaluate import evaluate_directory
from vapor.report import format_table, write_report


@dataclass(frozen=True)
class Options:
    """Measure the trajectories that `vapor-track run` wrote against true poses, without alignment."""

    directory: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DIRECTORY")]
    """What `vapor-track run` wrote."""
    ground_truth: Path | None = None
    """True poses as a TUM file. Default: ground_truth.tum in the directory."""
    output: Path | None = None
    """JSON file to write the figures to."""


def main(arguments: Sequence[str]) -> None:
    """Run the command."""
    options = parse("evaluate", Options, arguments)
    report = evaluate_directory(options.directory, options.ground_truth)
    if options.output is not None:
        write_report(options.output, report)
    show(format_table(report, title=str(options.directory)))
