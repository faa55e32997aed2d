"""Numbers, times and names that files hold, parsed within limits.

Every reader uses these, so that all numbers are usable in arithmetic, and others raise an error that names the place.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from decimal import Decimal, DecimalException
from typing import Any

from filtering.errors import quoted
from sequences.errors import SequenceError

LARGEST = 1e12
"""Of any number in a file: in metres beyond the planets, and squares of it are exact enough."""
MAX_TIME_NS = 1 << 62
"""Of a stamp, on either side of zero: differences of two of them fit into 64 bits. It is the year 2116."""
_MAX_TIME_S = Decimal(MAX_TIME_NS).scaleb(-9)
MAX_DIGITS = 40
_MAX_FRAME = 10**9  # beyond, it counts nanoseconds rather than frames
_UNITS = (("milliseconds", 3), ("microseconds", 6), ("nanoseconds", 9))


def parse_number(value: object, where: str, low: int | float = -LARGEST, high: int | float = LARGEST) -> float:
    """A finite number within a range, from a number or text that is one.

    Raises SequenceError where it is none, or lies outside; `where` begins the message.
    """
    try:
        found = _float(value) if isinstance(value, str | int | float) and not isinstance(value, bool) else math.nan
    except (ValueError, OverflowError):
        found = math.nan
    if not low <= found <= high:  # NaN compares as false
        raise SequenceError(f"{where} is {quoted(value)}, expected a number between {low:g} and {high:g}")
    return found


def parse_numbers(values: Iterable[Any], where: str, expected: str = "numbers") -> list[float]:
    """Numbers of a row, whatever their size; NaN and infinity are numbers, which mean that something is not known.

    Raises SequenceError where one is none. `where` begins the message, and `expected` ends it.
    """
    values = list(values)
    try:
        return [_float(value) for value in values]
    except (ValueError, TypeError, OverflowError):
        wrong = next(value for value in values if not is_number(value))
        raise SequenceError(f"{where}: {quoted(wrong)} is no number, expected {expected}") from None


def is_number(value: object) -> bool:
    """Whether a field of a row is a number, NaN and infinity included."""
    try:
        _float(value)
    except (ValueError, TypeError, OverflowError):
        return False
    return True


def _float(value: Any) -> float:
    """A number. Raises ValueError, TypeError or OverflowError where it is none, or one to Python only."""
    if isinstance(value, str) and not _is_plain(value):
        raise ValueError
    return float(value)


def _is_plain(text: str) -> bool:
    """Whether text has nothing that Python alone reads as a part of a number: `1_0`, and digits of other scripts."""
    return text.isascii() and "_" not in text


def parse_whole(text: str, where: str, low: int, high: int) -> int:
    """A whole number from text. Raises SequenceError where it is none, or lies outside; `where` begins the message."""
    if len(text) <= MAX_DIGITS and re.fullmatch(r"[+-]?\d+", text, flags=re.ASCII) and low <= int(text) <= high:
        return int(text)
    raise SequenceError(f"{where}: {quoted(text)}, expected a whole number between {low} and {high}")


def parse_frame_number(text: str, where: str) -> int:
    """The number of a frame, from the digits of a name or row. Raises SequenceError where it counts no frames."""
    return parse_whole(text, f"{where}: number of a frame", 0, _MAX_FRAME)


def parse_time_ns(text: str, where: str) -> int:
    """Seconds as decimal text -> integer nanoseconds, without a float between.

    Raises SequenceError for no number, or a time before 1824 or after 2116. `where` begins the message.
    """
    try:
        seconds = Decimal(text) if len(text) <= MAX_DIGITS and _is_plain(text) else Decimal("NaN")
        if -_MAX_TIME_S <= seconds <= _MAX_TIME_S:
            return int(seconds.scaleb(9).to_integral_value())
    except DecimalException:  # NaN too, which cannot be compared
        raise SequenceError(f"{where}: time {quoted(text)}, expected a number of seconds") from None
    likely = next((unit for unit, digits in _UNITS if seconds.copy_abs() < _MAX_TIME_S.scaleb(digits)), None)
    hint = f": are these {likely}?" if likely else ""
    raise SequenceError(f"{where}: time {quoted(text)} s lies beyond the year 2116, expected seconds{hint}")


def natural(name: str) -> list[tuple[int, str]]:
    """Sort key by which `seq2/frame10` comes after `seq2/frame9` and before `seq10/frame1`."""
    parts = re.split(r"(\d+)", name, flags=re.ASCII)
    trimmed = [(part, part.lstrip("0")) for part in parts]
    return [(len(digits), digits) if part[:1].isdecimal() else (-1, part) for part, digits in trimmed]
