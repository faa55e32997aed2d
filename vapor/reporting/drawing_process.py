"""A second Python process that draws, pictures and what the Rerun viewer shows, while this one goes on.

It imports what draws (Rerun, Matplotlib) while this one imports what computes, and takes calls through a pipe, one
after the other. It has a session of its own, so that signals of a terminal reach this process only, and ends when the
pipe does, as when this process is killed. It runs no code of `__main__`: scripts and notebooks need no guard.
"""

from __future__ import annotations

import atexit
import os
import pickle
import select
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from filtering.errors import VaporTrackError
from vapor.reporting.peak_memory import peak_rss_mb as own_peak_rss_mb

if TYPE_CHECKING:
    from vapor.reporting.record import RunRecord

_SERVE = "import sys; sys.path[:] = sys.argv[1:]; from vapor.reporting.drawing_calls import serve; serve()"
_ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
_PIPE_BYTES = 1 << 20  # room for a few images, so that nobody waits for one that is being drawn
_SOON_S = 5.0

_idle: list[DrawingProcess] = []
os.register_at_fork(after_in_child=_idle.clear)


class DrawingProcess:
    """The process as this one sees it; the calls are the methods of `drawing_calls.Calls`."""

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
        self._calls, self._answers = self._process.stdin, self._process.stdout
        with suppress(ImportError, AttributeError, OSError):  # elsewhere than on Linux
            import fcntl

            fcntl.fcntl(self._calls, fcntl.F_SETPIPE_SZ, _PIPE_BYTES)

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
        try:
            pickle.dump((name, arguments, False), self._calls, pickle.HIGHEST_PROTOCOL)
            self._calls.flush()
        except BrokenPipeError:
            self._receive()

    def ask(self, name: str, *arguments: Any) -> Any:
        """Call a method after all that were sent, and wait for what it returns.

        Raises:
            Exception: what it raised, or an earlier call.
        """
        with suppress(BrokenPipeError):
            pickle.dump((name, arguments, True), self._calls, pickle.HIGHEST_PROTOCOL)
            self._calls.flush()
        return self._receive()

    def _receive(self) -> Any:
        try:
            answer = pickle.load(self._answers)
        except (EOFError, pickle.UnpicklingError):
            raise VaporTrackError(
                "the process that draws ended unexpectedly, perhaps for lack of memory; a run with --no-recording"
                " needs less"
            ) from None
        if isinstance(answer, BaseException):
            raise answer
        return answer

    def end(self) -> None:
        """Let it remove what it has not finished, and end."""
        with suppress(OSError):  # of what is still buffered
            self._calls.close()
        try:
            self._process.wait(_SOON_S)
        except BaseException:
            self._process.kill()
            self._process.wait()
            raise
        finally:
            self._answers.close()


@contextmanager
def drawing_process() -> Iterator[DrawingProcess]:
    """A process for a `with` block, in which no other block has it; it is kept for the next, but after an error."""
    process = _idle.pop() if _idle else None
    if process is None or not process.is_alive:
        process = DrawingProcess()
    try:
        yield process
    except BaseException:
        process.end()
        raise
    _idle.append(process)


def start_drawing_process() -> None:
    """Start a process that will be needed, so that it is ready by then."""
    if not _idle:
        _idle.append(DrawingProcess())


def write_pictures(record: RunRecord, directory: Path, *, title: str) -> list[Path]:
    """See `vapor.reporting.pictures.write_pictures`."""
    with drawing_process() as process:
        return process.ask("pictures", record, directory, title)


def peak_rss_mb() -> float:
    """Peak resident memory of this process and of idle ones that draw, in all, MiB."""
    return own_peak_rss_mb() + sum(process.ask("peak_rss_mb") for process in _idle)


@atexit.register
def _end_idle() -> None:
    while _idle:
        _idle.pop().end()
