"""Trajectories as text, one pose a line: `time tx ty tz qx qy qz qw`, in seconds and metres (the TUM format)."""

from __future__ import annotations

from decimal import Decimal, InvalidOperation
from pathlib import Path

import numpy as np

from filtering.errors import VaporTrackError
from filtering.se3 import Poses
from sequences.atomic import atomic_output
from sequences.errors import SequenceError
from sequences.frame import Trajectory

_COLUMNS = "time tx ty tz qx qy qz qw"


def read_tum(path: Path) -> Trajectory:
    """Read a trajectory; lines that start with # are comments.

    Raises:
        SequenceError: the file is missing or empty, a line has other than eight numbers, a value is not finite, a
            quaternion has no length, or times do not increase.
    """
    path = Path(path)
    times_ns: list[int] = []
    rows: list[list[float]] = []
    for number, line in enumerate(read_lines(path), start=1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        where, fields = f"{path}:{number}", line.split()
        if len(fields) != 8:
            raise SequenceError(f"{where}: {len(fields)} columns, expected the eight of `{_COLUMNS}`")
        time_ns = parse_time_ns(fields[0], where)
        if times_ns and time_ns <= times_ns[-1]:
            raise SequenceError(f"{where}: time {fields[0]} is not after the line before, expected increasing times")
        try:
            row = [float(value) for value in fields[1:]]
            Poses.from_quat_xyzw(np.array(row[:3]), np.array(row[3:]))
        except (ValueError, VaporTrackError) as error:
            raise SequenceError(f"{where}: {error}; expected numbers `{_COLUMNS}`") from error
        times_ns.append(time_ns)
        rows.append(row)
    if not rows:
        raise SequenceError(f"{path}: no poses, expected lines of `{_COLUMNS}`")
    table = np.array(rows)
    return Trajectory(np.array(times_ns, np.int64), Poses.from_quat_xyzw(table[:, :3], table[:, 3:]))


def write_tum(path: Path, trajectory: Trajectory) -> None:
    """Write a trajectory, whole or not at all; times to the nanosecond, poses to nine decimals."""
    table = np.concatenate([trajectory.poses.translation, trajectory.poses.as_quat_xyzw()], axis=1)
    table += 0.0  # −0 becomes 0
    with atomic_output(path) as partial, open(partial, "w", encoding="ascii") as file:
        for time_ns, row in zip(trajectory.times_ns, table, strict=True):
            file.write(f"{format_time(int(time_ns))} {' '.join(f'{value:.9f}' for value in row)}\n")


def parse_time_ns(text: str, where: str) -> int:
    """Seconds as text -> integer nanoseconds, without a float between. `where` begins the message of an error."""
    try:
        time = Decimal(text)
        if time.is_finite():
            return int(time.scaleb(9).to_integral_value())
    except InvalidOperation:
        pass
    raise SequenceError(f"{where}: time {text!r}, expected a number of seconds")


def format_time(time_ns: int) -> str:
    """Integer nanoseconds -> seconds with nine decimals."""
    seconds, rest = divmod(abs(time_ns), 1_000_000_000)
    return f"{'-' if time_ns < 0 else ''}{seconds}.{rest:09d}"


def read_lines(path: Path) -> list[str]:
    """Lines of a text file. Raises SequenceError where it cannot be read, or is no text."""
    try:
        return Path(path).read_text(encoding="utf-8").splitlines()
    except OSError as error:
        raise SequenceError(f"{path}: cannot read: {error.strerror or error}") from error
    except UnicodeDecodeError as error:
        raise SequenceError(f"{path}: byte {error.start} is no UTF-8 text, expected a text file") from error


def is_number(text: str) -> bool:
    """Whether a field of a row is a number, NaN and infinity included."""
    try:
        float(text)
    except ValueError:
        return False
    return True
