"""JSON, YAML and arrays, none too large or too deep for the memory."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from sequences.errors import SequenceError
from sequences.files.text import read_bytes, read_text
from sequences.values import MAX_DIGITS

try:
    from yaml import CSafeLoader as SafeLoader  # ten times as fast
except ImportError:
    from yaml import SafeLoader

_MAX_JSON = 64 << 20  # a list of lists takes twenty times that in memory
_MAX_YAML = 2 << 20  # a list takes some hundred times that in memory
_MAX_ARRAYS = 4 << 30
_MAX_DEPTH = 64


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
    if len(text) > MAX_DIGITS:
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
