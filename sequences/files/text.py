"""Text files, whole or line by line: none is too large for the memory."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

from sequences.errors import SequenceError

_MAX_TEXT = 256 << 20  # bytes
_MAX_LINE = 16 << 20


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
    """Text of a file, without a byte order mark.

    Raises:
        SequenceError: it cannot be read, is no text, or has more than so many bytes.
    """
    try:
        return read_bytes(path, most).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise SequenceError(f"{path}: byte {error.start} is no UTF-8 text, expected a text file") from error


def read_lines(path: Path, most: int | None = _MAX_TEXT) -> Iterator[tuple[int, str]]:
    """Lines of a text file with their numbers from 1 on, one at a time; a byte order mark before them is skipped.

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
