"""What files say, read within limits: text, JSON, YAML, arrays, numbers, times, and the names of other files.

Every reader takes them from here, so that a file that is damaged, or made to do harm, gets an error that names it: none
is too large or too deep for the memory, no number is one that arithmetic cannot go on with, and no name leads to where
nobody pointed.
"""

from __future__ import annotations

import json
import math
import os
import re
import zipfile
from collections.abc import Iterable, Iterator
from decimal import Decimal, DecimalException
from pathlib import Path
from typing import Any

import numpy as np
import yaml

try:
    from yaml import CSafeLoader as SafeLoader  # ten times as fast
except ImportError:
    from yaml import SafeLoader

from filtering.errors import quoted
from sequences.errors import SequenceError

LARGEST = 1e12
"""Of any number in a file: in metres beyond the planets, and squares of it are exact enough."""
MAX_TIME_NS = 1 << 62
"""Of a stamp, on either side of zero: differences of two of them fit into 64 bits. It is the year 2116."""
_MAX_TIME_S = Decimal(MAX_TIME_NS).scaleb(-9)
_MAX_TEXT = 256 << 20  # bytes
_MAX_LINE = 16 << 20
_MAX_JSON = 64 << 20  # a list of lists takes twenty times that in memory
_MAX_YAML = 2 << 20  # a list takes some hundred times that in memory
_MAX_ARRAYS = 4 << 30
_MAX_DEPTH = 64
_MAX_DIGITS = 40
_MAX_FRAME = 10**9  # beyond, it counts nanoseconds rather than frames
_UNITS = (("milliseconds", 3), ("microseconds", 6), ("nanoseconds", 9))


def read_bytes(path: Path, most: int = _MAX_TEXT) -> bytes:
    """What a file holds. Raises SequenceError where it cannot be read, or has more than so many bytes."""
    try:
        with open(path, "rb") as stream:
            data = stream.read(most + 1)
    except OSError as error:
        raise SequenceError(f"{path}: cannot read: {error.strerror or error}") from error
    if len(data) > most:
        raise SequenceError(f"{path}: more than {most:,} bytes, expected a smaller file")
    return data


def read_text(path: Path, most: int = _MAX_TEXT) -> str:
    """Text of a file. Raises SequenceError where it cannot be read, is no text, or has more than so many bytes."""
    try:
        return read_bytes(path, most).decode("utf-8")
    except UnicodeDecodeError as error:
        raise SequenceError(f"{path}: byte {error.start} is no UTF-8 text, expected a text file") from error


def read_lines(path: Path, most: int | None = _MAX_TEXT) -> Iterator[tuple[int, str]]:
    """Lines of a text file with their numbers from 1 on, one at a time.

    Args:
        path: The file.
        most: How many bytes it may have; None for any number, where the reader keeps little of it.

    Raises:
        SequenceError: it cannot be read, is no text, or is too large, or a line of it is.
    """
    try:
        with open(path, "rb") as stream:
            if most is not None and os.fstat(stream.fileno()).st_size > most:
                raise SequenceError(f"{path}: more than {most:,} bytes, expected a smaller file")
            number = 0
            while line := stream.readline(_MAX_LINE):
                number += 1
                if len(line) == _MAX_LINE:
                    raise SequenceError(f"{path}:{number}: more than {_MAX_LINE:,} bytes, expected a shorter line")
                yield number, line.decode("utf-8").rstrip("\r\n")
    except OSError as error:
        raise SequenceError(f"{path}: cannot read: {error.strerror or error}") from error
    except UnicodeDecodeError as error:
        raise SequenceError(
            f"{path}:{number}: byte {error.start} is no UTF-8 text, expected a text file"  # pyright: ignore[reportPossiblyUnboundVariable]
        ) from error


def read_rows(path: Path) -> Iterator[tuple[int, str]]:
    """Lines that hold something and do not start with #, with their numbers. Raises SequenceError as `read_lines`."""
    for number, line in read_lines(path):
        text = line.strip()
        if text and not text.startswith("#"):
            yield number, text


def read_json(path: Path) -> Any:
    """What a JSON file says. Raises SequenceError as `read_text` and `parse_json`."""
    return parse_json(read_bytes(path, _MAX_JSON), str(path))


def parse_json(text: str | bytes, where: str) -> Any:
    """What JSON says; NaN and infinity are numbers of it, as Python has it.

    Raises:
        SequenceError: it is no JSON, too long or too deeply nested, or has an integer of more than 40 digits. `where`
            begins the message.
    """
    if len(text) > _MAX_JSON:
        raise SequenceError(f"{where}: more than {_MAX_JSON:,} bytes, expected JSON of fewer")
    try:
        value = json.loads(text, parse_int=_integer)
    except RecursionError as error:
        raise SequenceError(f"{where}: nested too deeply, expected JSON of at most {_MAX_DEPTH} levels") from error
    except ValueError as error:  # no JSON, no UTF-8, or too many digits
        raise SequenceError(f"{where}: {error}; expected JSON") from error
    level = [value]
    for _ in range(_MAX_DEPTH):
        inside = [each.values() if isinstance(each, dict) else each for each in level if isinstance(each, dict | list)]
        level = [each for some in inside for each in some if isinstance(each, dict | list)]
        if not level:
            return value
    raise SequenceError(f"{where}: nested too deeply, expected JSON of at most {_MAX_DEPTH} levels")


def _integer(text: str) -> int:
    if len(text) > _MAX_DIGITS:
        raise ValueError(f"an integer of {len(text)} digits")
    return int(text)


class _YamlLoader(SafeLoader):  # pyright: ignore[reportGeneralTypeIssues]
    """YAML of plain values, and of OpenCV's matrices."""


_YamlLoader.add_constructor("tag:yaml.org,2002:opencv-matrix", yaml.SafeLoader.construct_yaml_map)


def read_yaml(path: Path, most: int = _MAX_YAML) -> dict[Any, Any]:
    """Names and values of a YAML file; of OpenCV's, too.

    Raises:
        SequenceError: it is none, has more than so many bytes or more than 64 levels, or values that refer to others,
            by which few lines become millions.
    """
    lines = [line for line in read_text(path, most).splitlines() if not line.startswith("%")]  # OpenCV's %YAML:1.0
    text, depth = "\n".join(lines), 0
    try:
        for event in yaml.parse(text, _YamlLoader):
            depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
            if depth > _MAX_DEPTH:
                raise yaml.YAMLError(f"nested deeper than {_MAX_DEPTH} levels")
            if isinstance(event, yaml.AliasEvent):
                raise yaml.YAMLError("it refers to values by names")
        content = yaml.load(text, _YamlLoader)
    except Exception as error:  # the library lets value and recursion errors of dates, numbers and truth values through
        raise SequenceError(f"{path}: {' '.join(str(error).split())}; expected YAML") from error
    if not isinstance(content, dict):
        raise SequenceError(f"{path}: holds {type(content).__name__}, expected names and values")
    return content


def read_arrays(path: Path) -> dict[str, np.ndarray]:
    """The arrays of an .npz file by their names. Raises SequenceError where it cannot be read, or is too large."""
    try:
        with zipfile.ZipFile(path) as archive:
            size = sum(member.file_size for member in archive.infolist())
        if size <= _MAX_ARRAYS:
            with np.load(path, allow_pickle=False) as stored:
                return dict(stored)
    except Exception as error:  # the libraries let zlib, struct, key and syntax errors of damaged files through
        raise SequenceError(f"{path}: cannot be read ({error}), expected arrays as .npz") from error
    raise SequenceError(f"{path}: arrays of {size:,} bytes, expected at most {_MAX_ARRAYS:,}")


def parse_number(value: object, where: str, low: int | float = -LARGEST, high: int | float = LARGEST) -> float:
    """A finite number.

    Args:
        value: A number, or text that is one.
        where: Which number it is; it begins the message of an error.
        low: The smallest that it may be.
        high: The largest.

    Raises:
        SequenceError: it is none, or lies outside.
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

    Raises:
        SequenceError: one is none. `where` begins the message, and `expected` ends it.
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
    if len(text) <= _MAX_DIGITS and re.fullmatch(r"[+-]?\d+", text, flags=re.ASCII) and low <= int(text) <= high:
        return int(text)
    raise SequenceError(f"{where}: {quoted(text)}, expected a whole number between {low} and {high}")


def parse_frame_number(text: str, where: str) -> int:
    """The number of a frame, from the digits of a name or row. Raises SequenceError where it counts no frames."""
    return parse_whole(text, f"{where}: number of a frame", 0, _MAX_FRAME)


def parse_time_ns(text: str, where: str) -> int:
    """Seconds as decimal text -> integer nanoseconds, without a float between.

    Raises:
        SequenceError: no number, or a time before 1824 or after 2116. `where` begins the message.
    """
    try:
        seconds = Decimal(text) if len(text) <= _MAX_DIGITS and _is_plain(text) else Decimal("NaN")
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


def require_inside(folder: Path, files: Iterable[object]) -> None:
    """Check that paths which a data set names, or links in it, lead to nowhere outside of its folder.

    Args:
        folder: Where the data set lies; it may be a link itself, as someone named it.
        files: Paths; what is no path, such as an image in an archive, is passed over.

    Raises:
        SequenceError: one leads out, or is no path.
    """
    root = os.path.join(os.path.realpath(folder), "")
    real: dict[str, str] = {}
    for file in files:
        if not isinstance(file, Path):
            continue
        parent, name = os.path.split(file)
        try:
            if parent not in real:
                real[parent] = os.path.realpath(parent)
            target = os.path.join(real[parent], name)
            if name == ".." or os.path.islink(target):
                target = os.path.realpath(target)
        except (OSError, ValueError) as error:
            raise SequenceError(
                f"{folder}: {quoted(str(file))} is no path ({error}), expected one of a file"
            ) from error
        if not target.startswith(root):
            raise SequenceError(f"{folder}: {quoted(str(file))} leads out of the folder, expected files that lie in it")
