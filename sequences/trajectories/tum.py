"""Trajectories as text, one pose a line: `time tx ty tz qx qy qz qw`, in seconds and metres (the TUM format)."""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from filtering.errors import quoted
from filtering.se3 import Poses
from sequences.atomic import atomic_output
from sequences.errors import SequenceError
from sequences.files.text import read_rows
from sequences.frame import Trajectory
from sequences.values import LARGEST, parse_numbers, parse_time_ns

_COLUMNS = "time tx ty tz qx qy qz qw"
_SHORTEST = 1e-6  # of a quaternion that says how a pose is turned


def read_tum(path: Path) -> Trajectory:
    """Read a trajectory; lines that start with # are comments.

    Raises:
        SequenceError: the file is missing or empty, a line has other than eight numbers, a value is not finite or
            beyond what a pose has, a quaternion has no length, or times do not increase.
    """
    path = Path(path)
    lines: list[int] = []
    times_ns: list[int] = []
    values: array[float] = array("d")
    for number, line in read_rows(path):
        where, fields = f"{path}:{number}", line.split()
        if len(fields) != 8:
            raise SequenceError(f"{where}: {len(fields)} columns, expected the eight of `{_COLUMNS}`")
        found_ns = parse_time_ns(fields[0], where)
        if times_ns and found_ns <= times_ns[-1]:
            raise SequenceError(f"{where}: time {fields[0]} is not after the line before, expected increasing times")
        lines.append(number)
        times_ns.append(found_ns)
        values.extend(parse_numbers(fields[1:], where, f"those of `{_COLUMNS}`"))
    if not lines:
        raise SequenceError(f"{path}: no poses, expected lines of `{_COLUMNS}`")
    table = np.array(values).reshape(-1, 7)
    poses = poses_of_rows(path, lines, table[:, :3], table[:, 3:], _COLUMNS)
    return Trajectory(np.array(times_ns, np.int64), poses)


def poses_of_rows(
    path: Path,
    lines: Sequence[int],
    translation: Float64[np.ndarray, "n 3"],
    quat_xyzw: Float64[np.ndarray, "n 4"],
    columns: str,
) -> Poses:
    """Poses (n,) of the rows of a file, quaternions of any length.

    Raises:
        SequenceError: one is not finite or beyond what a pose has, or has no rotation; names the first such line.
    """
    rows = np.concatenate([translation, quat_xyzw], axis=1)
    usable = np.all(np.abs(rows) <= LARGEST, axis=1)
    turned = np.linalg.norm(np.where(usable[:, None], quat_xyzw, 1.0), axis=1) >= _SHORTEST
    if not (usable & turned).all():
        first = int(np.argmin(usable & turned))
        wrong = f"quaternion {quoted(rows[first, 3:].tolist())} has zero length"
        if not usable[first]:
            wrong = f"pose is not finite, or beyond {LARGEST:g}: {quoted(rows[first].tolist())}"
        raise SequenceError(f"{path}:{lines[first]}: {wrong}, expected numbers `{columns}`")
    return Poses.from_quat_xyzw(translation, quat_xyzw)


def write_tum(path: Path, trajectory: Trajectory) -> None:
    """Write a trajectory, whole or not at all; times to the nanosecond, poses to nine decimals."""
    table = np.concatenate([trajectory.poses.translation, trajectory.poses.as_quat_xyzw()], axis=1)
    table += 0.0  # −0 becomes 0
    with atomic_output(path) as partial, open(partial, "w", encoding="ascii") as file:
        for time_ns, row in zip(trajectory.times_ns, table, strict=True):
            file.write(f"{format_time(int(time_ns))} {' '.join(f'{value:.9f}' for value in row)}\n")


def format_time(time_ns: int) -> str:
    """Integer nanoseconds -> seconds with nine decimals."""
    seconds, rest = divmod(abs(time_ns), 1_000_000_000)
    return f"{'-' if time_ns < 0 else ''}{seconds}.{rest:09d}"
