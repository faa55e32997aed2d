"""Trajectories as text, one pose a line: `time tx ty tz qx qy qz qw`, in seconds and metres (the TUM format)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from filtering.moments import require_sound
from filtering.se3 import Poses
from sequences.atomic import atomic_output
from sequences.errors import SequenceError
from sequences.files import Rows, read_rows
from sequences.frame import Trajectory
from sequences.trajectories.pose_lines import read_increasing, usable_pose
from sequences.values import parse_numbers, parse_time_ns

_COLUMNS = "time tx ty tz qx qy qz qw"


def read_tum(path: Path | str, rows: Rows | None = None) -> Trajectory:
    """Read a trajectory; lines that start with # are comments.

    Args:
        path: The file.
        rows: Counts the lines that cannot be used, which are left out; None where one of them is an error.

    Raises:
        SequenceError: the file is missing or empty, a line has other than eight numbers, a value is not finite or
            beyond what a pose has, a quaternion has no length, or times do not increase.

    Example:
        >>> import vapor
        >>> trajectory = vapor.read_tum("truth.tum")
        >>> trajectory.times_ns.dtype, trajectory.poses.translation.shape
        (dtype('int64'), (25, 3))
    """
    path = Path(path)
    rows = rows or Rows(tolerant=False)
    times_ns, table = read_increasing(path, read_rows(path), rows, _read_row)
    if not len(times_ns):
        raise SequenceError(f"{path}: no poses, expected lines of `{_COLUMNS}`")
    return Trajectory(times_ns, Poses.from_quat_xyzw(table[:, :3], table[:, 3:]))


def _read_row(line: str, where: str) -> tuple[int, list[float]]:
    fields = line.split()
    if len(fields) != 8:
        raise SequenceError(f"{where}: {len(fields)} columns, expected the eight of `{_COLUMNS}`")
    values = parse_numbers(fields[1:], where, f"those of `{_COLUMNS}`")
    return parse_time_ns(fields[0], where), usable_pose(values, where, _COLUMNS)


def write_tum(path: Path | str, trajectory: Trajectory) -> None:
    """Write a trajectory, whole or not at all; times to the nanosecond, poses to nine decimals.

    Raises VaporTrackError where a pose is not finite.

    Example:
        >>> import vapor
        >>> trajectory = vapor.read_tum("truth.tum")
        >>> vapor.write_tum("mine.tum", trajectory)  # then `evo_ape tum truth.tum mine.tum`
        >>> len(vapor.read_tum("mine.tum"))
        25
    """
    require_sound(trajectory.poses)
    table = np.concatenate([trajectory.poses.translation, trajectory.poses.as_quat_xyzw()], axis=1)
    table += 0.0  # −0 becomes 0
    with atomic_output(Path(path)) as partial, open(partial, "w", encoding="ascii") as file:
        for time_ns, row in zip(trajectory.times_ns, table, strict=True):
            file.write(f"{format_time(int(time_ns))} {' '.join(f'{value:.9f}' for value in row)}\n")


def format_time(time_ns: int) -> str:
    """Integer nanoseconds -> seconds with nine decimals."""
    seconds, rest = divmod(abs(time_ns), 1_000_000_000)
    return f"{'-' if time_ns < 0 else ''}{seconds}.{rest:09d}"
