"""What the command prints, whatever standard output and error are: a full device, a terminal of another encoding."""

from __future__ import annotations

import contextlib
import io
import os
import sys
from typing import NoReturn, TextIO

from filtering.errors import shortened


def encode_anything() -> None:
    """From now on, characters that standard output or error cannot encode are printed as question marks."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")


def say(message: str) -> None:
    """One line on standard error, of at most `MAX_MESSAGE` characters; nothing where it cannot be written to."""
    if sys.stderr is None:  # closed by the shell
        return
    try:
        sys.stderr.write(shortened(" ".join(message.splitlines())) + "\n")
        sys.stderr.flush()
    except OSError:
        _abandon(sys.stderr)


def write(text: str) -> None:
    """Text and the end of its line on standard output.

    Raises:
        OSError: It cannot be written to.
    """
    try:
        if sys.stdout is not None:
            sys.stdout.write(text + "\n")
    except OSError as error:
        raise_of_output(error)


def flush_output() -> None:
    """Print what still waits to be.

    Raises:
        OSError: Standard output cannot be written to. What waited is dropped, so that nothing fails again at the end.
    """
    try:
        if sys.stdout is not None:
            sys.stdout.flush()
    except OSError as error:
        raise_of_output(error)


def raise_of_output(error: OSError) -> NoReturn:
    """Raise an error in writing to standard output as one that says so; what waits to be printed is dropped."""
    _abandon(sys.stdout)
    error.filename = error.filename or "standard output"
    raise error


def _abandon(stream: TextIO) -> None:
    """Let all that waits in a stream, and all that follows, go nowhere."""
    with contextlib.suppress(OSError):  # of a stream that is no file
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
