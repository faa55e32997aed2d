"""Names of the columns of a file of poses, and what a line of it says by them."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cached_property

from filtering.errors import quoted
from sequences.errors import SequenceError
from sequences.trajectories.pose_lines import fields_of, usable_pose
from sequences.values import parse_numbers, parse_time_ns

_POSE = ("tx", "ty", "tz", "qx", "qy", "qz", "qw")
_IGNORED = "_"
_EXPECTED = f"name or time, {' '.join(_POSE)}, and perhaps weight, each once; {_IGNORED} for what is ignored"


@dataclass(frozen=True)
class Columns:
    """Which column holds what: `time` or `name`, the seven of a pose, perhaps `weight`; `_` for what is ignored.

    A time is in seconds, or in nanoseconds where it has 18 or 19 digits and no dot. Names, as fields, are separated by
    spaces, commas or semicolons.

    Raises:
        SequenceError: a name is another, is there twice, or is missing.
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

        Raises:
            SequenceError: one is no number or not finite or beyond what a pose has, or the quaternion has no length.
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
