"""Printing that works whatever standard output and error are: a full device, a terminal with another encoding."""

from __future__ import annotations

import contextlib
import io
import os
import sys
from typing import NoReturn, TextIO

from filtering.errors import shortened


def encode_anything() -> None:
    """From now on, print characters that standard output or error cannot encode as question marks."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")


def say(message: str) -> None:
    """Print one line on standard error, of at most `MAX_MESSAGE` characters; nothing if it cannot be written to."""
    if sys.stderr is None:  # closed by the shell
        return
    try:
        sys.stderr.write(shortened(" ".join(message.splitlines())) + "\n")
        sys.stderr.flush()
    except OSError:
        _abandon(sys.stderr)


def write(text: str) -> None:
    """Print text and a line end on standard output.

    Raises:
        OSError: It cannot be written to.
    """
    try:
        if sys.stdout is not None:
            sys.stdout.write(text + "\n")
    except OSError as error:
        raise_of_output(error)


def flush_output() -> None:
    """Print what is still buffered.

    Raises:
        OSError: Standard output cannot be written to. What was buffered is dropped, so that exit does not fail.
    """
    try:
        if sys.stdout is not None:
            sys.stdout.flush()
    except OSError as error:
        raise_of_output(error)


def raise_of_output(error: OSError) -> NoReturn:
    """Raise an error in writing to standard output as one that says so; what is still buffered is dropped."""
    _abandon(sys.stdout)
    error.filename = error.filename or "standard output"
    raise error


def _abandon(stream: TextIO) -> None:
    """Discard what is buffered in a stream, and all that follows."""
    with contextlib.suppress(OSError):  # a stream that is not a file
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
