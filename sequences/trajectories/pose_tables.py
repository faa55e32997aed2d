"""Trajectories of true poses as others write them -> `Trajectory`."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from filtering.errors import counted, quoted
from filtering.se3 import Poses
from filtering.so3 import nearest_rotation
from sequences.errors import SequenceError
from sequences.files import Rows, read_rows
from sequences.frame import Trajectory
from sequences.trajectories.pose_lines import Columns, fields_of, pose_rows, read_increasing, stamp_ns, typical
from sequences.trajectories.tum import read_tum
from sequences.values import LARGEST, MAX_TIME_NS, parse_numbers, parse_time_ns, parse_whole

_EUROC = "time_ns,px,py,pz,qw,qx,qy,qz"
_KITTI = "twelve numbers, the upper three rows of a matrix"
COLUMNS_OPTIONS = "--columns; --poses-columns of a recording; --odometry-columns, --ground-truth-columns of fuse"
_MAX_ERROR = 0.01  # of a unit quaternion's length, and of a rotation's elements; beyond, these are other numbers


def read_pose_table(path: Path, rows: Rows | None = None, columns: str | None = None) -> Trajectory:
    """Read poses of a body over time, in one of three formats, found by the first line, or by the names of its columns.

    TUM: `time tx ty tz qx qy qz qw`, seconds. EuRoC: with commas, nanoseconds, position, quaternion with w first,
    further columns ignored. KITTI: the upper three rows of a matrix in one line; their times, in seconds, are the lines
    of `times.txt` in the same folder. Others: as `Columns` states them, frames by time or by names that are stamps.
    Lines that start with # are comments.

    Args:
        path: The file.
        rows: Counts the lines that cannot be used, which are left out; None where one of them is an error.
        columns: Names of the columns; None for one of the three formats.

    Raises:
        SequenceError: a file is missing, empty or in none of these formats, a value is not finite or no rotation, times
            do not increase, or there are not as many times as poses.
    """
    path, rows = Path(path), rows or Rows(tolerant=False)
    lines = list(pose_rows(path))
    usual = typical(lines)
    if usual is None:
        raise SequenceError(f"{path}: no poses, expected TUM text, EuRoC's data.csv or KITTI's poses")
    number, line = usual
    found = len(fields_of(line))
    if columns is not None:
        return _trajectory(path, lines, rows, partial(_read_columns_row, Columns(columns)))
    if "," in line:
        return _trajectory(path, lines, rows, _read_euroc_row)
    if found == 12:
        return _read_kitti(path, lines, rows)
    if found == 8 and ";" not in line:
        return read_tum(path, rows)
    raise SequenceError(
        f"{path}:{number}: {found} columns, expected TUM text (8), EuRoC's data.csv (with commas), KITTI's poses (12),"
        f" or the names of its columns ({COLUMNS_OPTIONS})"
    )


def times_beside(poses: Path) -> Path:
    """Default file of the times of KITTI's poses."""
    return poses.parent / "times.txt"


def _trajectory(
    path: Path, lines: list[tuple[int, str]], rows: Rows, read: Callable[[str, str], tuple[int, list[float]]]
) -> Trajectory:
    times_ns, table = read_increasing(path, lines, rows, read)
    return Trajectory(times_ns, Poses.from_quat_xyzw(table[:, :3], table[:, 3:]))


def _read_euroc_row(line: str, where: str) -> tuple[int, list[float]]:
    fields = line.split(",")
    if len(fields) < 8:
        raise SequenceError(f"{where}: {len(fields)} columns, expected at least the eight of `{_EUROC}`")
    try:
        time_ns = parse_whole(fields[0].strip(), f"{where}: nanoseconds", -MAX_TIME_NS, MAX_TIME_NS)
    except SequenceError as error:
        raise SequenceError(f"{error}; of seconds the names of the columns are needed ({COLUMNS_OPTIONS})") from None
    row = parse_numbers(fields[1:8], where, f"those of `{_EUROC}`")
    if not (np.abs(row) <= LARGEST).all() or abs(np.hypot.reduce(row[3:]) - 1) > _MAX_ERROR:
        raise SequenceError(f"{where}: {quoted(row)} is no finite position and unit quaternion, expected `{_EUROC}`")
    return time_ns, [*row[:3], *row[4:], row[3]]


def _read_columns_row(columns: Columns, line: str, where: str) -> tuple[int, list[float]]:
    fields = columns.read(line, where)
    return stamp_ns(fields["time" if columns.timed else "name"], where), columns.pose(fields, where)


def _read_kitti(path: Path, lines: list[tuple[int, str]], rows: Rows) -> Trajectory:
    times = times_beside(path)
    matrices = [rows.use(_read_kitti_row, line, f"{path}:{number}") for number, line in rows.each(lines)]
    if not times.is_file():
        raise SequenceError(f"{times}: no such file, expected the times of {path.name}")
    stamped = list(read_rows(times))
    if len(stamped) != len(lines):
        raise SequenceError(
            f"{times}: {counted(len(stamped), 'time')}, expected {len(lines)} as there are poses in {path.name}"
        )
    times_ns = [parse_time_ns(line, f"{times}:{number}") for number, line in stamped]
    for (number, _), before, after in zip(stamped[1:], times_ns, times_ns[1:], strict=False):
        if after <= before:
            raise SequenceError(
                f"{times}:{number}: time {after} ns is not after the line before, expected increasing times"
            )
    kept = [(time_ns, row) for time_ns, row in zip(times_ns, matrices, strict=True) if not isinstance(row, str)]
    table = np.array([row for _, row in kept])
    poses = Poses(nearest_rotation(table[:, :, :3].copy()), table[:, :, 3].copy())
    return Trajectory(np.array([time_ns for time_ns, _ in kept], np.int64), poses)


def _read_kitti_row(line: str, where: str) -> Float64[np.ndarray, "3 4"]:
    row = parse_numbers(line.split(), where, _KITTI)
    if len(row) != 12:
        raise SequenceError(f"{where}: {len(row)} columns, expected {_KITTI}")
    matrix = np.reshape(row, (3, 4))
    turn = matrix[:, :3]
    if not (np.abs(matrix) <= LARGEST).all() or np.abs(turn @ turn.T - np.eye(3)).max() > _MAX_ERROR:
        raise SequenceError(f"{where}: no finite rotation and translation, expected {_KITTI}")
    if np.linalg.det(turn) < 0:
        raise SequenceError(f"{where}: a mirroring, no rotation, expected {_KITTI}")
    return matrix
