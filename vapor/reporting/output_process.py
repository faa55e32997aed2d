"""A second Python process that writes and draws what a run leaves behind, while this one goes on to the next image.

It imports what draws (Rerun, Matplotlib) while this one imports what computes, and takes calls through a pipe, one
after the other: threads would wait for each other's Python. It has a session of its own, so that signals of a terminal
reach this process only, and ends when the pipe does, as when this process is killed. It runs no code of `__main__`:
scripts and notebooks need no guard.
"""

from __future__ import annotations

import atexit
import os
import pickle
import queue
import select
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

from filtering.errors import VaporTrackError

_SERVE = "import sys; sys.path[:] = sys.argv[1:]; from vapor.reporting.output_calls import serve; serve()"
_ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
_MOST_WAITING = 64  # calls, 0.3 MB each, so that nobody waits while the process starts or sends off its rows
_SOON_S = 5.0
DISCARDED = "discarded"
"""The answer to `discard`."""

_idle: list[OutputProcess] = []
os.register_at_fork(after_in_child=_idle.clear)


class OutputProcess:
    """The process as this one sees it; the calls are the methods of `output_calls.Calls`."""

    def __init__(self) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-c", _SERVE, *sys.path],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env={**os.environ, **_ONE_THREAD},
            start_new_session=True,
        )
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._pipe, self._answers = self._process.stdin, self._process.stdout
        self._waiting: queue.Queue[bytes | None] = queue.Queue(_MOST_WAITING)
        self._sender = threading.Thread(target=self._write, daemon=True)
        self._sender.start()

    def _write(self) -> None:
        """Write what waits, in a thread; what comes when the process is no more is lost, as the next answer tells."""
        while (call := self._waiting.get()) is not None:
            with suppress(OSError):
                self._pipe.write(call)
                self._pipe.flush()
        with suppress(OSError):  # of what is still buffered
            self._pipe.close()

    @property
    def pid(self) -> int:
        """Its number."""
        return self._process.pid

    @property
    def is_alive(self) -> bool:
        """Whether it has not ended."""
        return self._process.poll() is None

    def send(self, name: str, *arguments: Any) -> None:
        """Call a method, and do not wait for it.

        Raises:
            Exception: what an earlier call raised.
        """
        if select.select([self._answers], [], [], 0.0)[0]:  # only errors come without being asked for
            self._receive()
        self._call(name, arguments, is_asked=False)

    def ask(self, name: str, *arguments: Any) -> Any:
        """Call a method after all that were sent, and wait for what it returns.

        Raises:
            Exception: what it raised, or an earlier call.
        """
        self._call(name, arguments, is_asked=True)
        return self._receive()

    def _call(self, name: str, arguments: tuple[Any, ...], *, is_asked: bool) -> None:
        self._waiting.put(pickle.dumps((name, arguments, is_asked), pickle.HIGHEST_PROTOCOL))

    def _receive(self) -> Any:
        try:
            answer = pickle.load(self._answers)
        except (EOFError, pickle.UnpicklingError):
            raise VaporTrackError(
                "the process that writes the results ended unexpectedly, perhaps for lack of memory; a run with"
                " --no-recording needs less"
            ) from None
        if isinstance(answer, BaseException):
            raise answer
        return answer

    def discard(self) -> None:
        """After an error: let it remove what is not finished; then it can be used again, if it is alive."""
        try:
            self._call("discard", (), is_asked=True)
            while pickle.load(self._answers) != DISCARDED:  # errors that nobody has waited for
                pass
        except (OSError, EOFError, pickle.UnpicklingError):
            self.kill()

    def end(self) -> None:
        """Let it remove what is not finished, and end; it is killed where that takes long, or by another signal."""
        try:
            with suppress(queue.Full, subprocess.TimeoutExpired):
                self._waiting.put(None, timeout=_SOON_S)
                self._process.wait(_SOON_S)
        finally:
            self.kill()

    def kill(self) -> None:
        """End it at once."""
        self._process.kill()
        self._process.wait()
        if self._sender.is_alive():
            self._waiting.put(None)  # there is room: nothing waits for a process that is no more
            self._sender.join()
        self._answers.close()


@contextmanager
def output_process() -> Iterator[OutputProcess]:
    """A process for a `with` block, in which no other block has it; it is kept for the next, as it takes a second."""
    process = None
    with suppress(IndexError):  # none idle
        process = _idle.pop()
    if process is None or not process.is_alive:
        process = OutputProcess()
    try:
        yield process
    except Exception:
        process.discard()
        raise
    except BaseException:  # a signal, perhaps within a call
        process.end()
        raise
    finally:
        if process.is_alive:
            _idle.append(process)


def start_output_process() -> None:
    """Start a process that will be needed, so that it is ready by then."""
    if not _idle:
        _idle.append(OutputProcess())


@atexit.register
def _end_idle() -> None:
    while _idle:
        _idle.pop().kill()
