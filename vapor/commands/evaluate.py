"""`vapor-track evaluate`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from sequences.outputs import MANIFEST, UNCHECKED, refuse_other
from vapor.commands.console import OutputPath, Overwrite, command_line, parse, show, show_notices
from vapor.evaluation.run_directory import evaluate_directory, files_read
from vapor.reporting.html.findings_page import findings_page
from vapor.reporting.html.page import Page, is_page, write_page
from vapor.reporting.html.run_page import said_of_filter
from vapor.reporting.report import format_table, is_report, write_report


@dataclass(frozen=True)
class Options:
    """Measure the trajectories that `vapor-track run` wrote against true poses, without alignment."""

    directory: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DIRECTORY")]
    """What `vapor-track run` wrote."""
    ground_truth: Path | None = None
    """True poses: TUM text, EuRoC's data.csv, or KITTI's with times.txt beside it. Default:
    ground_truth.tum in the directory."""
    columns: str | None = None
    """Names of the columns of true poses in another format, as one word in quotation marks, such as "time tx ty tz qw
    qx qy qz _": name in place of time for frames named by their stamps, _ for what is ignored."""
    time_offset_s: float | Literal["auto"] = 0.0
    """Seconds to add to the stamps of true poses; auto finds them by comparing rotations."""
    output: OutputPath | None = None
    """JSON file to write the figures to, new or of an earlier evaluation; a page of the same name, .html, goes beside
    it."""
    overwrite: Overwrite = False


def main(arguments: Sequence[str]) -> None:
    """Run the command."""
    options = parse("evaluate", Options, arguments)
    if options.output is not None:
        kind, reads = "report of vapor-track", files_read(options.directory, options.ground_truth)
        refuse_other(options.output, kind, _is_evaluation, reads=reads, overwrite=options.overwrite)
        page = options.output.with_suffix(".html")
        refuse_other(page, "page of vapor-track", is_page, reads=reads, overwrite=options.overwrite)
    report, notices = evaluate_directory(
        options.directory, options.ground_truth, options.time_offset_s, options.columns
    )
    if options.output is not None:
        write_report(options.output, report)
        write_page(options.output.with_suffix(".html"), _page(options, report, command_line("evaluate", arguments)))
    show(format_table(report, title=str(options.directory)))
    show_notices([*notices, *([UNCHECKED] if not (options.directory / MANIFEST).exists() else [])])


def _page(o: Options, report: Mapping[str, Any], command: str) -> Page:
    truth = "the true poses beside them" if o.ground_truth is None else o.ground_truth.name
    asked = f"{report['frames']} images, {report['frames_with_true_pose']} with a true pose, against {truth}"
    table = format_table(report, title="Errors, without any alignment")
    return findings_page(o.directory.name, asked, said_of_filter(report), [("How good", [table])], command=command)


def _is_evaluation(path: Path) -> bool:
    return is_report(path, "frames", "frames_with_true_pose")
