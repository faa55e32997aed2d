"""Trajectories of true poses as others write them -> `Trajectory`."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from filtering.errors import quoted
from filtering.se3 import Poses, nearest_rotation
from sequences.errors import SequenceError
from sequences.files.rows import Rows
from sequences.files.text import read_rows
from sequences.frame import Trajectory
from sequences.trajectories.tum import read_tum
from sequences.values import LARGEST, MAX_TIME_NS, parse_numbers, parse_time_ns, parse_whole

_EUROC = "time_ns,px,py,pz,qw,qx,qy,qz"
_KITTI = "twelve numbers, the upper three rows of a matrix"
_MAX_ERROR = 0.01  # of a unit quaternion's length, and of a rotation's elements; beyond, these are other numbers


def read_pose_table(path: Path, times: Path | None = None, rows: Rows | None = None) -> Trajectory:
    """Read poses of a body over time, in whichever of three formats the first line is.

    TUM: `time tx ty tz qx qy qz qw`, seconds. EuRoC: with commas, nanoseconds, position, quaternion with w first,
    further columns ignored. KITTI: the upper three rows of a matrix in one line; their times, in seconds, are lines of
    a file of its own. Lines that start with # are comments.

    Args:
        path: The file.
        times: Times of KITTI's poses; None for `times.txt` in the same folder.
        rows: Counts the lines of TUM text or EuRoC's that cannot be used, which are left out; None where one of them is
            an error.

    Raises:
        SequenceError: a file is missing, empty or in none of these formats, a value is not finite or no rotation, times
            do not increase, or there are not as many times as poses.
    """
    path = Path(path)
    lines = list(read_rows(path))
    if not lines:
        raise SequenceError(f"{path}: no poses, expected TUM text, EuRoC's data.csv or KITTI's poses")
    number, line = lines[0]
    columns = len(line.split())
    if times is not None and ("," in line or columns != 12):
        raise SequenceError(f"{path}:{number}: not KITTI's poses, expected {_KITTI}, or no --poses-times with them")
    if "," in line:
        return _read_euroc(path, lines, rows or Rows(tolerant=False))
    if columns == 12:
        return _read_kitti(path, lines, Path(times) if times is not None else times_beside(path))
    if columns == 8:
        return read_tum(path, rows)
    raise SequenceError(
        f"{path}:{number}: {columns} columns, expected TUM text (8), EuRoC's data.csv (with commas) or KITTI's poses"
        " (12)"
    )


def times_beside(poses: Path) -> Path:
    """Where the times of KITTI's poses lie where nothing is said."""
    return poses.parent / "times.txt"


def _read_euroc(path: Path, lines: list[tuple[int, str]], rows: Rows) -> Trajectory:
    times_ns: list[int] = []
    values: list[list[float]] = []
    for number, line in rows.each(lines):
        row = rows.use(_read_euroc_row, line, f"{path}:{number}", times_ns[-1] if times_ns else None)
        if not isinstance(row, str):
            times_ns.append(row[0])
            values.append(row[1])
    table = np.array(values)
    poses = Poses.from_quat_xyzw(table[:, :3], table[:, [4, 5, 6, 3]])
    return Trajectory(np.array(times_ns, np.int64), poses)


def _read_euroc_row(line: str, where: str, before_ns: int | None) -> tuple[int, list[float]]:
    """Stamp and pose of a line."""
    fields = line.split(",")
    if len(fields) < 8:
        raise SequenceError(f"{where}: {len(fields)} columns, expected at least the eight of `{_EUROC}`")
    time_ns = parse_whole(fields[0].strip(), f"{where}: nanoseconds", -MAX_TIME_NS, MAX_TIME_NS)
    row = parse_numbers(fields[1:8], where, f"those of `{_EUROC}`")
    if not (np.abs(row) <= LARGEST).all() or abs(np.hypot.reduce(row[3:]) - 1) > _MAX_ERROR:
        raise SequenceError(f"{where}: {quoted(row)} is no finite position and unit quaternion, expected `{_EUROC}`")
    if before_ns is not None and time_ns <= before_ns:
        raise SequenceError(f"{where}: time {time_ns} ns is not after the line before, expected increasing times")
    return time_ns, row


def _read_kitti(path: Path, rows: list[tuple[int, str]], times: Path) -> Trajectory:
    matrices = np.empty((len(rows), 3, 4))
    for i, (number, line) in enumerate(rows):
        row = parse_numbers(line.split(), f"{path}:{number}", _KITTI)
        if len(row) != 12:
            raise SequenceError(f"{path}:{number}: {len(row)} columns, expected {_KITTI}")
        matrices[i] = np.reshape(row, (3, 4))
        turn = matrices[i, :, :3]
        if not (np.abs(matrices[i]) <= LARGEST).all() or np.abs(turn @ turn.T - np.eye(3)).max() > _MAX_ERROR:
            raise SequenceError(f"{path}:{number}: no finite rotation and translation, expected {_KITTI}")
        if np.linalg.det(turn) < 0:
            raise SequenceError(f"{path}:{number}: a mirroring, no rotation, expected {_KITTI}")
    if not times.is_file():
        raise SequenceError(
            f"{times}: no such file, expected the times of {path.name}, or --poses-times that names them"
        )
    stamped = list(read_rows(times))
    if len(stamped) != len(rows):
        raise SequenceError(f"{times}: {len(stamped)} times, expected {len(rows)} as there are poses in {path.name}")
    times_ns = [parse_time_ns(line, f"{times}:{number}") for number, line in stamped]
    _require_increasing(times, stamped, times_ns)
    poses = Poses(nearest_rotation(matrices[:, :, :3].copy()), matrices[:, :, 3].copy())
    return Trajectory(np.array(times_ns, np.int64), poses)


def _require_increasing(path: Path, rows: list[tuple[int, str]], times_ns: list[int]) -> None:
    (stalled,) = np.nonzero(np.diff(np.array(times_ns, np.int64)) <= 0)
    if len(stalled):
        raise SequenceError(
            f"{path}:{rows[stalled[0] + 1][0]}: time {times_ns[stalled[0] + 1]} ns is not after the line before,"
            " expected increasing times"
        )
