"""Files read within limits: text, rows, JSON, YAML, arrays, and the names of other files.

Files come from others, are cut off, or were made to do harm. So sizes are checked before memory is asked for, no name
in a file leads out of its folder, and nothing is unpickled or evaluated.
"""

from __future__ import annotations

import json
import os
import zipfile
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import numpy as np
import yaml

from filtering.errors import quoted
from sequences.errors import SequenceError
from sequences.values import MAX_DIGITS

_MAX_TEXT = 256 << 20  # bytes
_MAX_LINE = 16 << 20


def read_bytes(path: Path, most: int = _MAX_TEXT) -> bytes:
    """Content of a file. Raises SequenceError where it cannot be read, or has more than so many bytes."""
    try:
        with open(path, "rb") as stream:
            data = stream.read(most + 1)
    except OSError as error:
        raise SequenceError(f"{path}: cannot read: {error.strerror or error}") from error
    if len(data) > most:
        raise SequenceError(f"{path}: more than {most:,} bytes, expected a smaller file")
    return data


def read_text(path: Path, most: int = _MAX_TEXT) -> str:
    """Text of a file, without a byte order mark.

    Raises SequenceError where it cannot be read, is no text, or has more than so many bytes.
    """
    try:
        return read_bytes(path, most).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise SequenceError(f"{path}: byte {error.start} is no UTF-8 text, expected a text file") from error


def read_lines(path: Path, most: int | None = _MAX_TEXT) -> Iterator[tuple[int, str]]:
    """Lines of a text file with their numbers from 1 on, one at a time; a byte order mark before them is skipped.

    `most` is None for a file of any size, where the reader keeps little of it. Raises SequenceError where the file
    cannot be read, is no text, or is too large, or a line of it is.
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
                yield number, line.decode("utf-8-sig" if number == 1 else "utf-8").rstrip("\r\n")
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


try:
    from yaml import CSafeLoader as SafeLoader  # ten times as fast
except ImportError:
    from yaml import SafeLoader

_MAX_JSON = 64 << 20  # a list of lists takes twenty times that in memory
_MAX_YAML = 2 << 20  # a list takes some hundred times that in memory
_MAX_ARRAYS = 4 << 30
_MAX_DEPTH = 64


def read_json(path: Path) -> Any:
    """Content of a JSON file. Raises SequenceError as `read_text` and `parse_json`."""
    return parse_json(read_bytes(path, _MAX_JSON), str(path))


def parse_json(text: str | bytes, where: str) -> Any:
    """Content of JSON text; NaN and infinity are numbers, as in Python's dialect.

    Raises SequenceError where it is no JSON, too long or too deeply nested, or has an integer of more than 40 digits.
    `where` begins the message.
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
    if len(text) > MAX_DIGITS:
        raise ValueError(f"an integer of {len(text)} digits")
    return int(text)


class _YamlLoader(SafeLoader):  # pyright: ignore[reportGeneralTypeIssues]
    """YAML of plain values, and of OpenCV's matrices."""


_YamlLoader.add_constructor("tag:yaml.org,2002:opencv-matrix", yaml.SafeLoader.construct_yaml_map)


def read_yaml(path: Path, most: int = _MAX_YAML) -> dict[Any, Any]:
    """Names and values of a YAML file; of OpenCV's, too.

    Raises SequenceError where it is none, has more than so many bytes or more than 64 levels, or values that refer to
    others, by which few lines become millions.
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


UNUSABLE = "unusable row"
"""Why a row is left out that is not as its format has it."""
_MOST_UNUSABLE = 0.5  # fraction of the rows beyond which the file is another one than it seems

Row = TypeVar("Row")
Read = TypeVar("Read")
Arguments = ParamSpec("Arguments")


def _unusable(_: SequenceError) -> str:
    return UNUSABLE


class Rows:
    """Counts the rows left out: lines of a table, files of one pose each, images.

    Attributes:
        num_rows: How many were read so far.
        num_unusable: How many of them could not be used.
        tolerant: Whether any may be left out; otherwise the first that cannot be used is an error.
    """

    def __init__(
        self, what: str = "rows", reason: Callable[[SequenceError], str] = _unusable, *, tolerant: bool = True
    ) -> None:
        """Begin to count; `what` names the rows in the plural, `reason` is counted for an error."""
        self.num_rows = self.num_unusable = 0
        self._what, self._reason, self._first = what, reason, ""
        self.tolerant = tolerant

    def each(self, rows: Iterable[Row]) -> Iterator[Row]:
        """The rows, one after the other.

        Raises SequenceError after the last one where more than half could not be used; the first one is quoted.
        """
        for row in rows:
            self.num_rows += 1
            yield row
        self.require_few()

    def require_few(self) -> None:
        """Raise SequenceError where more than half of the rows could not be used."""
        if self.num_unusable > _MOST_UNUSABLE * self.num_rows:
            raise SequenceError(
                f"{self._first}; {self.num_unusable} of {self.num_rows} {self._what} cannot be used,"
                " expected at most one in two"
            )

    def use(
        self, read: Callable[Arguments, Read], *arguments: Arguments.args, **keywords: Arguments.kwargs
    ) -> Read | str:
        """A row as a function reads it; the reason to leave it out where that raises SequenceError."""
        try:
            return read(*arguments, **keywords)
        except SequenceError as error:
            if not self.tolerant:
                raise
            self.leave_out(str(error))
            return self._reason(error)

    def leave_out(self, problem: str) -> None:
        """Count one of the rows as unusable."""
        self.num_unusable += 1
        self._first = self._first or problem

    @property
    def notices(self) -> list[str]:
        """How many could not be used, and why the first could not; nothing where all could."""
        if not self.num_unusable:
            return []
        return [f"{self.num_unusable} of {self.num_rows} {self._what} left out, the first: {self._first}"]


def require_inside(folder: Path, files: Iterable[object]) -> None:
    """Raise SequenceError where a path that a data set names, or a link in it, leads out of its folder, or is no path.

    The folder may be a link itself. Anything but paths, such as an image in an archive, is ignored.
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


def unused_part(path: Path) -> str:
    """Of a path that does not exist: which commands take the part that it names by an @; empty where it names none."""
    before, _, part = str(path).rpartition("@")
    if not (before and os.path.exists(before)):  # Path.exists raises for names that are too long
        return ""
    return (
        f"; only `train`, `inspect`, `calibrate`, and of images `run`, take a part by @{part}: `run` has --start-s and"
        " --duration-s, `convert` has --frames"
    )
