"""Lines of files of poses: fields, headers, usable poses, and stamps that increase."""

from __future__ import annotations

from bisect import bisect_left
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import islice
from math import hypot, isnan
from pathlib import Path

import numpy as np
from jaxtyping import Float64, Int64

from filtering.errors import quoted
from sequences.errors import SequenceError
from sequences.files.rows import Rows
from sequences.files.text import read_rows
from sequences.values import LARGEST, is_number

_LEAST_FIELDS = 8  # of a row of a pose with its time or name
_SHORTEST = 1e-6  # of a quaternion that says how a pose is turned


def fields_of(line: str) -> list[str]:
    """What stands between spaces, commas or semicolons."""
    return line.replace(",", " ").replace(";", " ").split()


def pose_rows(path: Path) -> Iterator[tuple[int, str]]:
    """Lines of a file of poses with their numbers, without comments and without a first line that is a header.

    Raises:
        SequenceError: as `read_lines`.
    """
    for place, (number, line) in enumerate(read_rows(path)):
        fields = fields_of(line) if place == 0 else []
        if len(fields) < _LEAST_FIELDS or any(map(is_number, fields)):
            yield number, line


def typical(rows: Iterable[tuple[int, str]]) -> tuple[int, str] | None:
    """The first row that has as many fields as most of the first hundred have; None where there are none."""
    first = list(islice(rows, 100))
    counts = Counter(len(fields_of(line)) for _, line in first)
    most = max(counts, key=counts.__getitem__, default=0)
    return next((row for row in first if len(fields_of(row[1])) == most), None)


def read_increasing(
    path: Path,
    lines: Iterable[tuple[int, str]],
    rows: Rows,
    read: Callable[[str, str], tuple[int, list[float]]],
) -> tuple[Int64[np.ndarray, " n"], Float64[np.ndarray, "n 7"]]:
    """Stamps that increase, and rows `tx ty tz qx qy qz qw`.

    Args:
        path: The file.
        lines: Its lines, with their numbers.
        rows: Counts those that cannot be used; of stamps that do not increase those that most others disagree with.
        read: The stamp, ns, and the row of a line; it takes the line, and what messages of errors begin with.

    Raises:
        SequenceError: as `Rows`.
    """
    numbers: list[int] = []
    times_ns: list[int] = []
    values: list[list[float]] = []
    for number, line in rows.each(lines):
        row = rows.use(read, line, f"{path}:{number}")
        if not isinstance(row, str):
            numbers.append(number)
            times_ns.append(row[0])
            values.append(row[1])
    kept = _in_order(times_ns)
    if len(kept) < len(times_ns):
        odd = sorted({*range(len(times_ns))} - {*kept})
        if not rows.tolerant:  # the first is an error: that which is not after the one before it
            odd = [next(i for i in range(1, len(times_ns)) if times_ns[i] <= times_ns[i - 1])]
        for i in odd:
            rows.use(_refuse_time, times_ns[i], f"{path}:{numbers[i]}")
        for _ in rows.each(()):  # looks once more whether too many are left out
            pass
    return np.array([times_ns[i] for i in kept], np.int64), np.array([values[i] for i in kept]).reshape(-1, 7)


def _refuse_time(time_ns: int, where: str) -> None:
    raise SequenceError(f"{where}: time {time_ns} ns is not after the line before, expected increasing times")


def _in_order(times_ns: Sequence[int]) -> list[int]:
    """Which of the times make the longest series that increases."""
    ends: list[int] = []  # of the series of each length, the index where the last time is smallest
    before: list[int] = []
    for i, time_ns in enumerate(times_ns):
        at = bisect_left(ends, time_ns, key=lambda k: times_ns[k])
        before.append(ends[at - 1] if at else -1)
        ends[at : at + 1] = [i]
    found, i = [], ends[-1] if ends else -1
    while i >= 0:
        found.append(i)
        i = before[i]
    return found[::-1]


def usable_pose(row: list[float], where: str, columns: str) -> list[float]:
    """The same row `tx ty tz qx qy qz qw`. Raises SequenceError where it is no pose; `where` begins the message."""
    if not max(map(abs, row)) <= LARGEST or isnan(sum(row)):
        raise SequenceError(
            f"{where}: pose is not finite, or beyond {LARGEST:g}: {quoted(row)}, expected numbers `{columns}`"
        )
    if hypot(*row[3:]) < _SHORTEST:
        raise SequenceError(
            f"{where}: quaternion {quoted(row[3:])} has zero length, expected one that turns in `{columns}`"
        )
    return row
