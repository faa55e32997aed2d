"""Printing that works whatever standard output and error are, and signals that end a command."""

from __future__ import annotations

import _thread
import contextlib
import io
import os
import re
import shutil
import signal
import sys
import textwrap
import threading
import time
from collections.abc import Mapping
from types import FrameType
from typing import Any, Literal, NoReturn, TextIO

from filtering.errors import shortened


def encode_anything() -> None:
    """Print characters that standard output or error cannot encode as question marks from now on."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")


def write_error(message: str) -> None:
    """Print one line on standard error, of at most `MAX_MESSAGE` characters; nothing if it cannot be written to."""
    if sys.stderr is None:  # closed by the shell
        return
    try:
        sys.stderr.write(shortened(" ".join(message.splitlines())) + "\n")
        sys.stderr.flush()
    except OSError:
        _abandon(sys.stderr)


def write(text: str) -> None:
    """Print text and a line end on standard output; OSError if it cannot be written to."""
    try:
        if sys.stdout is not None:
            sys.stdout.write(text + "\n")
    except OSError as error:
        raise_of_output(error)


def width() -> int:
    """Characters in a line of standard output: `COLUMNS`, those of the terminal, or 80."""
    return shutil.get_terminal_size((80, 24)).columns


def color_system() -> Literal["auto"] | None:
    """Colours that Rich may use: those of a terminal; none, nor bold, where NO_COLOR is set."""
    return None if os.environ.get("NO_COLOR") else "auto"


def wrapped(text: str) -> str:
    """A line wrapped to the terminal, indented behind its label, or by two more.

    A word that is longer than a line, such as a path, stays whole, so that it can be copied.
    """
    label = re.match(r"\s*\w+ {2,}", text)
    indent = " " * (label.end() if label else len(text) - len(text.lstrip()) + 2)
    options = {"break_long_words": False, "break_on_hyphens": False, "subsequent_indent": indent}
    return textwrap.fill(text, max(width(), 1), **options)


def overview(usage: str, about: str, meanings: Mapping[str, str]) -> str:
    """Help of a program: its usage, a sentence, and the meanings of its commands."""
    longest = max(map(len, meanings))
    options = {"break_on_hyphens": False, "subsequent_indent": " " * (longest + 4)}
    lines = (
        textwrap.fill(meaning, max(width(), longest + 20), initial_indent=f"  {name:<{longest}}  ", **options)
        for name, meaning in meanings.items()
    )
    return "\n".join([f"usage: {usage} ...", "", wrapped(about), "", *lines])


def flush_output() -> None:
    """Flush standard output; OSError if it cannot be written to, and the buffer is dropped so that exit succeeds."""
    try:
        if sys.stdout is not None:
            sys.stdout.flush()
    except OSError as error:
        raise_of_output(error)


def raise_of_output(error: OSError) -> NoReturn:
    """Raise an error in writing to standard output under that name; the buffer is dropped."""
    _abandon(sys.stdout)
    error.filename = error.filename or "standard output"
    raise error


def _abandon(stream: TextIO) -> None:
    with contextlib.suppress(OSError):  # a stream that is not a file
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


_ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_ONE_S = 1.0
_SOON_S = 0.02
_latest: list[Signals] = []


def results_are_complete() -> None:
    """From now on a signal ends the command early with status 0, as all results are there."""
    for signals in _latest:
        signals.complete = True


class Signals:
    """The signals that ask a command to end.

    SIGINT, SIGTERM and SIGHUP end it alike: with one line, which begins with the prefix, and exit status 128 + n. While
    the command works, they raise KeyboardInterrupt. Before, while it is imported, and afterwards there is nothing to
    undo: they end the process at once, as a KeyboardInterrupt within an import leaves a traceback. Once all results are
    there (`complete`), they end it with status 0.
    """

    def __init__(self, prefix: str) -> None:
        self.prefix = prefix
        self.received: int | None = None
        self.working = self.silent = self.complete = False
        self._next_s = 0.0
        _latest[:] = [self]

    def take(self) -> None:
        """Handle the signals of this process from now on, except those that are ignored, as nohup does with SIGHUP."""
        for number in _ENDING:
            if signal.getsignal(number) is not signal.SIG_IGN:
                signal.signal(number, self._handle)
        sys.unraisablehook = self._unraisable

    def report(self) -> int:
        """Print a line on the signal, if it left something undone; returns the exit status."""
        if self.complete:
            return 0
        number = self.received or signal.SIGINT
        if not self.silent:
            self.silent = True
            write_error(
                f"{self.prefix}: interrupted{'' if number == signal.SIGINT else f' by {signal.Signals(number).name}'}"
            )
        return 128 + number

    def _handle(self, number: int, _: FrameType | None) -> None:
        # A closing terminal, and most service managers, send several: the first one is being answered.
        if self.received is not None and time.monotonic() < self._next_s:
            return
        self.received, self._next_s = self.received or number, time.monotonic() + _ONE_S
        if self.working:
            raise KeyboardInterrupt
        os._exit(self.report())

    def _unraisable(self, lost: Any) -> None:
        """Where an exception cannot propagate, as in a destructor, repeat a signal; print others as usual."""
        if self.received is None or not isinstance(lost.exc_value, KeyboardInterrupt):
            sys.__unraisablehook__(lost)
        else:
            self._next_s = 0.0
            threading.Timer(_SOON_S, _thread.interrupt_main, (self.received,)).start()  # raised here it would be lost
