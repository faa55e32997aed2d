"""The trajectories in a run's directory, evaluated anew."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

from filtering.errors import VaporTrackError
from sequences.files import Rows
from sequences.outputs import MANIFEST, verify
from sequences.trajectories.pose_lines import require_columns
from sequences.trajectories.pose_tables import read_pose_table
from sequences.trajectories.tum import read_tum
from vapor.evaluation.trajectory import associate, evaluate_methods
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
    """Recompute the metrics of a run from the trajectories that it wrote.

    Args:
        directory: What `vapor-track run` wrote; `trajectory.tum` must be there, other files of `FILES` may be missing.
        ground_truth: True poses as TUM text, EuRoC's data.csv or KITTI's; None for
            `ground_truth.tum` in the directory.
        time_offset_s: Seconds to add to the stamps of true poses; auto finds them by the rotation of the filter's.
        columns: Names of the columns of the true poses, as `read_pose_table` takes them.

    Returns:
        `frames`, `frames_with_true_pose`, and for each method found its metrics, as in `report.json`; and what
        a person should know of the true poses and of the clocks.

    Raises:
        VaporTrackError: a file is missing, malformed or not as its manifest lists it, or nothing overlaps.
    """
    if columns is not None and ground_truth is None:
        raise VaporTrackError("--columns without --ground-truth, expected a file that has them")
    require_columns("--columns", columns)
    if not directory.is_dir():
        raise VaporTrackError(f"{directory}: no such directory, expected one that `vapor-track run` wrote")
    if not (directory / FILES["filter"]).is_file():
        raise VaporTrackError(
            f"{directory}: no {FILES['filter']} in it, expected a directory that `vapor-track run` wrote"
        )
    verify(directory, [*FILES.values(), *([_TRUTH] if ground_truth is None else [])])
    truth_path = directory / _TRUTH if ground_truth is None else ground_truth
    if not truth_path.is_file():
        hint = "; give the true poses with --ground-truth FILE" if ground_truth is None else ""
        raise VaporTrackError(f"{truth_path}: no such file, expected true poses as TUM text{hint}")
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
