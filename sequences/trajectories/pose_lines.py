"""Lines of files of poses: fields, headers, columns by name, usable poses, and stamps that increase."""

from __future__ import annotations

import re
from bisect import bisect_left
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import islice
from math import hypot, isnan
from pathlib import Path

import numpy as np
from jaxtyping import Float64, Int64

from filtering.errors import quoted
from sequences.errors import SequenceError
from sequences.files import Rows, read_rows
from sequences.values import LARGEST, is_number, parse_numbers, parse_time_ns

_LEAST_FIELDS = 8  # of a row of a pose with its time or name
_SHORTEST = 1e-6  # of a quaternion that determines a rotation
_POSE = ("tx", "ty", "tz", "qx", "qy", "qz", "qw")
_IGNORED = "_"
_EXPECTED = f"name or time, {' '.join(_POSE)}, and perhaps weight, each once; {_IGNORED} for what is ignored"


def fields_of(line: str) -> list[str]:
    """Fields between spaces, commas or semicolons."""
    return line.replace(",", " ").replace(";", " ").split()


def pose_rows(path: Path) -> Iterator[tuple[int, str]]:
    """Lines of a file of poses with their numbers, without comments and without a first line that is a header.

    Raises SequenceError as `read_lines`.
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
    """Stamps that increase, and rows `tx ty tz qx qy qz qw`, of numbered lines.

    `read` gives the stamp, ns, and the row of a line; it takes the line and the beginning of errors. Of stamps that do
    not increase those are unusable that most others disagree with. Raises SequenceError as `Rows`.
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


@dataclass(frozen=True)
class Columns:
    """Which column holds what: `time` or `name`, the seven of a pose, perhaps `weight`; `_` for what is ignored.

    A time is in seconds, or in nanoseconds where it has 18 or 19 digits and no dot. Names, as fields, are separated by
    spaces, commas or semicolons. Raises SequenceError where a name is another, is there twice, or is missing.
    """

    text: str

    def __post_init__(self) -> None:
        stated = [name for name in self._names if name != _IGNORED]
        for name in stated:
            if name not in ("name", "time", *_POSE, "weight"):
                raise SequenceError(f"columns: {quoted(name)} in {quoted(self.text)}, expected {_EXPECTED}")
        missing = [name for name in _POSE if name not in stated]
        if missing or len(set(stated)) < len(stated) or ("name" in stated) == ("time" in stated):
            raise SequenceError(f"columns are {quoted(self.text)}, expected {_EXPECTED}")

    @cached_property
    def _names(self) -> list[str]:
        return fields_of(self.text)

    @property
    def timed(self) -> bool:
        """Whether frames go by their time, not by a name."""
        return "time" in self._names

    @property
    def weighted(self) -> bool:
        """Whether poses have weights."""
        return "weight" in self._names

    @property
    def frame(self) -> int:
        """Which column holds the name or the time."""
        return self._names.index("time" if self.timed else "name")

    def read(self, line: str, where: str) -> dict[str, str]:
        """Fields of a line by their names. Raises SequenceError where it has too few; `where` begins the message."""
        fields = fields_of(line)
        if len(fields) < len(self._names):
            raise SequenceError(f"{where}: {len(fields)} columns, expected the {len(self._names)} of `{self.text}`")
        return dict(zip(self._names, fields, strict=False))

    def pose(self, fields: dict[str, str], where: str) -> list[float]:
        """`tx ty tz qx qy qz qw` of a line, the quaternion of any length.

        Raises SequenceError where one is no number or not finite or beyond what a pose has, or the quaternion has no
        length.
        """
        row = parse_numbers([fields[name] for name in _POSE], where, f"those of `{self.text}`")
        return usable_pose(row, where, self.text)


def require_columns(option: str, columns: str | None) -> None:
    """Raise SequenceError, which names the option, where it states columns that are none."""
    try:
        if columns is not None:
            Columns(columns)
    except SequenceError as error:
        raise SequenceError(f"{option}: {error}") from error


def stamp_of(name: str) -> str | None:
    """Seconds that a name states, as EuRoC's images are named, or TUM's; None where it states none."""
    file = name.rpartition("/")[2]
    if match := re.fullmatch(r"(\d{9,10})(\d{9})(\.[A-Za-z]\w*)?", file, flags=re.ASCII):
        return f"{match[1]}.{match[2]}"
    match = re.fullmatch(r"(\d{9,10}\.\d{1,9})(\.[A-Za-z]\w*)?", file, flags=re.ASCII)
    return match[1] if match else None


def stamp_ns(name: str, where: str) -> int:
    """Nanoseconds of a name that is a stamp, or of a time. Raises SequenceError where it is none."""
    return parse_time_ns(stamp_of(name) or name, where)
