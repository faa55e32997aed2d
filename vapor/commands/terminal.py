"""Printing that works whatever standard output and error are: a full device, a terminal with another encoding."""

from __future__ import annotations

import contextlib
import io
import os
import re
import shutil
import sys
import textwrap
from collections.abc import Mapping
from typing import Literal, NoReturn, TextIO

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


def width() -> int:
    """How many characters a line of standard output has: `COLUMNS`, those of the terminal, or 80."""
    return shutil.get_terminal_size((80, 24)).columns


def color_system() -> Literal["auto"] | None:
    """Which colours Rich may use: those of the terminal if there is one, and none, nor bold, where NO_COLOR is set."""
    return None if os.environ.get("NO_COLOR") else "auto"


def wrapped(text: str) -> str:
    """A line as lines that a terminal need not break, further ones indented as what follows a label, or by two more.

    A word that is longer than a line, such as a path, stays whole, so that it can be copied.
    """
    label = re.match(r"\s*\w+ {2,}", text)
    indent = " " * (label.end() if label else len(text) - len(text.lstrip()) + 2)
    options = {"break_long_words": False, "break_on_hyphens": False, "subsequent_indent": indent}
    return textwrap.fill(text, max(width(), 1), **options)


def overview(command: str, said: str, meanings: Mapping[str, str]) -> str:
    """Help of a command that has others: its usage, a sentence, and what each of the others does.

    Args:
        command: As it is typed, with a word for the others.
        said: The sentence.
        meanings: What each of the others does, by name.
    """
    longest = max(map(len, meanings))
    options = {"break_on_hyphens": False, "subsequent_indent": " " * (longest + 4)}
    lines = (
        textwrap.fill(meaning, max(width(), longest + 20), initial_indent=f"  {name:<{longest}}  ", **options)
        for name, meaning in meanings.items()
    )
    return "\n".join([f"usage: {command} ...", "", wrapped(said), "", *lines])


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
