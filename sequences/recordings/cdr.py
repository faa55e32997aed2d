"""CDR, as ROS 2 serializes messages: the layouts of message types, bytes -> fields and fields -> bytes.

Numbers are aligned to their size, counted from behind the four bytes of the header. So numbers that follow each other,
of whatever message within the message, are one struct, which depends only on where within eight bytes it begins.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, make_dataclass
from functools import cache
from itertools import islice
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np

_HEADER = 4  # bytes; the last bit of the second says whether numbers are little-endian
_CODES = {
    "bool": "?",
    "byte": "B",
    "uint8": "B",
    "int32": "i",
    "uint32": "I",
    "uint64": "Q",
    "float32": "f",
    "float64": "d",
}


@dataclass(frozen=True)
class List:
    """A list of any length, of numbers of a code or of messages. Text is a list of characters."""

    of: Layout | str


class Field(NamedTuple):
    """A field: its name, the layout of a message or how many numbers of an array, else None; its values if left out."""

    name: str
    kind: Layout | int | None
    absent: list[Any]


@dataclass(frozen=True)
class Layout:
    """How the messages of a type are laid out.

    Attributes:
        made: Class of its messages as they are read; with slots, as paths have many poses.
        fields: Its fields.
        parts: What its bytes consist of: numbers in a row, by their codes, and lists.
    """

    made: type[SimpleNamespace]
    fields: tuple[Field, ...]
    parts: tuple[str | List, ...]


_TEXT = List("text")


def layout_of(message_type: str, definitions: Mapping[str, str]) -> Layout:
    """The layout of a type such as `std_msgs/Header`, by its definition and those of the types within it."""
    fields: list[Field] = []
    parts: list[str | List] = []
    for line in definitions[message_type].splitlines():
        kind, name = line.split()
        match = re.fullmatch(r"([\w/]+)(\[(\d*)\])?", kind)
        assert match is not None
        base, is_list, length = match.group(1, 2, 3)
        of = layout_of(base, definitions) if "/" in base else _CODES.get(base)
        added: tuple[str | List, ...]
        if is_list and not length:
            assert of is not None
            field, added = Field(name, None, [()]), (List(of),)
        elif isinstance(of, Layout):
            field, added = Field(name, of, [value for each in of.fields for value in each.absent]), of.parts
        elif of is not None:
            number = int(length or 1)
            field, added = Field(name, number if is_list else None, [0] * number), (of * number,)
        else:
            field, added = Field(name, None, [""]), (_TEXT,)
        fields.append(field)
        for part in added:
            if isinstance(part, str) and parts and isinstance(parts[-1], str):
                parts[-1] += part
            else:
                parts.append(part)
    names = [field.name for field in fields]
    made = make_dataclass(message_type.rpartition("/")[2], names, bases=(SimpleNamespace,), slots=True)
    return Layout(made, tuple(fields), tuple(parts))


@cache
def _struct(codes: str, order: str, begin: int) -> struct.Struct:
    """Of numbers in a row, the first of which lies so far behind a multiple of eight bytes, gaps before it."""
    form, at = order, begin
    for code in codes:
        size = struct.calcsize(f"<{code}")
        form += "x" * (-at % size) + code
        at += -at % size + size
    return struct.Struct(form)


# --- reading --------------------------------------------------------------------------------------


def read(layout: Layout, data: bytes) -> SimpleNamespace:
    """Fields of a message. What lies behind it is left, and a list of bytes at its end may be shorter than it says.

    Raises:
        ValueError, struct.error: the bytes end early, or text is not UTF-8.
    """
    if len(data) < _HEADER:
        raise ValueError(f"{len(data)} bytes, expected a header of {_HEADER} at least")
    return _read(layout, data, _HEADER, "<" if data[1] & 1 else ">")[0]


def _read(layout: Layout, data: bytes, at: int, order: str) -> tuple[SimpleNamespace, int]:
    """The message that begins at some byte, and where it ends."""
    values: list[Any] = []
    for part in layout.parts:
        if isinstance(part, str):
            numbers = _struct(part, order, (at - _HEADER) % 8)
            values += numbers.unpack_from(data, at)
            at += numbers.size
            continue
        prefix = _struct("I", order, (at - _HEADER) % 8)
        (count,) = prefix.unpack_from(data, at)
        at += prefix.size
        if part is _TEXT:
            values.append(data[at : at + count - 1].decode() if count else "")
            at += count
        elif part.of == "B":
            values.append(data[at : at + count])
            at += count
        elif isinstance(part.of, str):
            at += -(at - _HEADER) % struct.calcsize(part.of) if count else 0
            values.append(list(struct.unpack_from(f"{order}{count}{part.of}", data, at)))
            at += count * struct.calcsize(part.of)
        else:
            messages = []
            for _ in range(count):
                message, at = _read(part.of, data, at, order)
                messages.append(message)
            values.append(messages)
    return _named(layout, iter(values)), at


def _named(layout: Layout, values: Iterator[Any]) -> SimpleNamespace:
    fields = [
        next(values)
        if kind is None
        else _named(kind, values)
        if isinstance(kind, Layout)
        else list(islice(values, kind))
        for _, kind, _ in layout.fields
    ]
    return layout.made(*fields)


# --- writing --------------------------------------------------------------------------------------


def write(layout: Layout, message: Mapping[str, Any]) -> bytes:
    """Little-endian bytes of a message.

    Args:
        layout: Of its type.
        message: Its fields by name; those that are left out are zero or empty. A message within it that consists of
            numbers may be an array of them in their order; a list of n messages that consist of k float64, one (n, k).

    Raises:
        ValueError, struct.error: a field has more or fewer numbers than its type, or others.
    """
    out = bytearray(b"\x00\x01\x00\x00")
    _write(layout, message, out)
    return bytes(out)


def _write(layout: Layout, message: Mapping[str, Any], out: bytearray) -> None:
    values = iter(_values(layout, message))
    for part in layout.parts:
        if isinstance(part, str):
            out += _struct(part, "<", (len(out) - _HEADER) % 8).pack(*islice(values, len(part)))
            continue
        value = next(values)
        if part is _TEXT:
            value = value.encode() + b"\0"
        out += _struct("I", "<", (len(out) - _HEADER) % 8).pack(len(value))
        if isinstance(value, bytes):
            out += value
        elif isinstance(part.of, Layout) and not isinstance(value, np.ndarray):
            for each in value:
                _write(part.of, each, out)
        elif len(value):
            row = part.of.parts if isinstance(part.of, Layout) else (part.of,)
            numbers = np.asarray(value, "<f8").reshape(len(value), -1)
            if row != ("d" * numbers.shape[1],):
                raise ValueError(f"a list of {numbers.shape[1]} float64 each, expected {row}")
            out += bytes(-(len(out) - _HEADER) % 8) + numbers.tobytes()


def _values(layout: Layout, message: Mapping[str, Any]) -> list[Any]:
    """The numbers of a message one by one, and its lists."""
    values: list[Any] = []
    for name, kind, absent in layout.fields:
        value = message.get(name)
        if value is None:
            values += absent
        elif kind is None:
            values.append(value)
        else:
            if isinstance(value, np.ndarray):
                value = value.ravel().tolist()
            added = _values(kind, value) if isinstance(value, Mapping) and isinstance(kind, Layout) else value
            if len(added) != len(absent):
                raise ValueError(f"{name} has {len(added)} numbers, expected {len(absent)}")
            values += added
    return values
