"""`vapor-track evaluate`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from filtering.errors import VaporTrackError
from sequences.files import Rows
from sequences.outputs import MANIFEST, UNCHECKED, refuse_other, verify
from sequences.trajectories.pose_lines import require_columns
from sequences.trajectories.pose_tables import read_pose_table
from sequences.trajectories.tum import read_tum
from vapor.commands.console import OutputPath, Overwrite, command_line, parse, show, show_notices
from vapor.evaluation.trajectory import associate, evaluate_methods
from vapor.reporting.html.page import Page, findings_page, is_page, write_page
from vapor.reporting.html.run_page import filter_sentence
from vapor.reporting.report import format_table, is_report, write_report
from vapor.tracking.methods import FILES

_TRUTH = "ground_truth.tum"


def files_read(directory: Path, ground_truth: Path | None = None) -> list[Path]:
    """Files that `evaluate_directory` reads where they exist."""
    truth = directory / _TRUTH if ground_truth is None else ground_truth
    return [*(directory / name for name in (*FILES.values(), MANIFEST)), truth]


def evaluate_directory(
    directory: Path,
    ground_truth: Path | None = None,
    time_offset_s: float | Literal["auto"] = 0.0,
    columns: str | None = None,
) -> tuple[dict[str, Any], list[str]]:
    """Metrics of the trajectories that a run wrote, of which all but `trajectory.tum` may be missing.

    Args:
        directory: Of `vapor-track run`.
        ground_truth: True poses, see `read_pose_table`; None for `ground_truth.tum` in the directory.
        time_offset_s: Seconds to add to the stamps of true poses; auto finds them by the rotation of the filter's.
        columns: Of the true poses, see `read_pose_table`.

    Returns:
        `frames`, `frames_with_true_pose` and the metrics of each method found, as in `report.json`; and warnings and
        hints on the true poses and the clocks.

    Raises:
        VaporTrackError: a file is missing, malformed or not as its manifest lists it, or nothing overlaps.
    """
    if columns is not None and ground_truth is None:
        raise VaporTrackError("--columns without --ground-truth, expected a file that has them")
    require_columns("--columns", columns)
    if directory.is_file():
        meant = f", did you mean {directory.parent}?" if (directory.parent / FILES["filter"]).is_file() else ""
        raise VaporTrackError(f"{directory}: is a file, expected a directory that `vapor-track run` wrote{meant}")
    if not directory.is_dir():
        raise VaporTrackError(f"{directory}: no such directory, expected one that `vapor-track run` wrote")
    if not (directory / FILES["filter"]).is_file():
        raise VaporTrackError(
            f"{directory}: no {FILES['filter']} in it, expected a directory that `vapor-track run` wrote"
        )
    verify(directory, [*FILES.values(), *([_TRUTH] if ground_truth is None else [])])
    truth_path = directory / _TRUTH if ground_truth is None else ground_truth
    if not truth_path.is_file():
        raise VaporTrackError(f"{truth_path}: no such file, expected true poses; --ground-truth names their file")
    rows = Rows("true poses")
    truth = read_pose_table(truth_path, rows=rows, columns=columns)
    methods = {name: read_tum(directory / file) for name, file in FILES.items() if (directory / file).is_file()}
    from sequences.trajectories.time_offset import offset_of_clocks  # loads SciPy's signals, which takes a while

    offset_s, notices = offset_of_clocks(time_offset_s, methods["filter"], truth, str(truth_path))
    truth = replace(truth, times_ns=truth.times_ns + round(offset_s * 1e9))
    try:
        metrics = evaluate_methods(methods, truth)
    except VaporTrackError as error:
        raise VaporTrackError(f"{directory} against {truth_path}: {error}") from error
    found, _ = associate(methods["filter"].times_ns, truth)
    report = {"frames": len(found), "frames_with_true_pose": int(found.sum()), **metrics}
    return report, [*rows.notices, *notices]


@dataclass(frozen=True)
class Options:
    """Measure the trajectories that `vapor-track run` wrote against true poses, without alignment."""

    directory: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DIRECTORY")]
    """Folder that `vapor-track run` wrote."""
    ground_truth: Path | None = None
    """True poses: TUM text, EuRoC's data.csv, or KITTI's with times.txt beside it. Default:
    ground_truth.tum in the directory."""
    columns: str | None = None
    """Columns of true poses in another format, in quotation marks: "time tx ty tz qw qx qy qz _". `name` stands for
    frames that are named by their stamps, _ for columns to ignore."""
    time_offset_s: float | Literal["auto"] = 0.0
    """Seconds to add to the stamps of true poses; auto finds them by comparing rotations."""
    output: OutputPath | None = None
    """JSON file for the figures, new or of an earlier evaluation. A page (.html) of the same name goes beside it."""
    overwrite: Overwrite = False


def main(arguments: Sequence[str]) -> None:
    """Run the command."""
    options = parse("evaluate", Options, arguments)
    if options.output is not None:
        kind, reads = "report of vapor-track", files_read(options.directory, options.ground_truth)
        is_evaluation = partial(is_report, keys=("frames", "frames_with_true_pose"))
        refuse_other(options.output, kind, is_evaluation, reads=reads, overwrite=options.overwrite)
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
    return findings_page(o.directory.name, asked, filter_sentence(report), [("Errors", [table])], command=command)
