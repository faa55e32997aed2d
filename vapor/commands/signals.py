"""SIGINT, SIGTERM and SIGHUP all end the command the same way: undo what it began, one line, exit status 128 + n."""

from __future__ import annotations

import _thread
import os
import signal
import sys
import threading
import time
from types import FrameType
from typing import Any

from vapor.commands.terminal import say

_ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_ONE_S = 1.0
_SOON_S = 0.02
_latest: list[Signals] = []


def results_are_complete() -> None:
    """From now on a signal ends the command early, and with status 0: what was asked for is there."""
    for signals in _latest:
        signals.complete = True


class Signals:
    """The signals that ask a command to end.

    While the command works, they raise KeyboardInterrupt. Before that, while it is imported, and afterwards there is
    nothing to undo: they end the process at once, as a KeyboardInterrupt within an import leaves a traceback.

    Attributes:
        prefix: Beginning of the line that reports a signal.
        received: The first signal that came; None before.
        working: Whether there is something to undo.
        silent: Whether the command has said its last line.
        complete: Whether all that was asked for is done: a signal then ends the command early, and with status 0.
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

    def tell(self) -> int:
        """Say in one line that a signal ended the command, if it left something undone; returns the exit status."""
        if self.complete:
            return 0
        number = self.received or signal.SIGINT
        if not self.silent:
            self.silent = True
            say(f"{self.prefix}: interrupted{'' if number == signal.SIGINT else f' by {signal.Signals(number).name}'}")
        return 128 + number

    def _handle(self, number: int, _: FrameType | None) -> None:
        # A closing terminal, and most service managers, send several: the first one is being answered.
        if self.received is not None and time.monotonic() < self._next_s:
            return
        self.received, self._next_s = self.received or number, time.monotonic() + _ONE_S
        if self.working:
            raise KeyboardInterrupt
        os._exit(self.tell())

    def _unraisable(self, lost: Any) -> None:
        """If an exception cannot propagate, as in a destructor: repeat a signal, and print others as usual."""
        if self.received is None or not isinstance(lost.exc_value, KeyboardInterrupt):
            sys.__unraisablehook__(lost)
        else:
            self._next_s = 0.0
            threading.Timer(_SOON_S, _thread.interrupt_main, (self.received,)).start()  # raised here it would be lost
