"""The calls that the drawing process takes, see `drawing_process`; this module is imported there only."""

from __future__ import annotations

import os
import pickle
import sys
import traceback
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO

from filtering.errors import VaporTrackError
from filtering.estimate import Estimate
from filtering.se3 import Poses
from sequences.frame import Frame
from vapor.reporting.peak_memory import peak_rss_mb
from vapor.reporting.pictures import write_pictures
from vapor.reporting.record import RunRecord
from vapor.reporting.rerun_viewer import RerunViewer


class Calls:
    """What the process can be asked to do, one viewer at a time."""

    def __init__(self) -> None:
        self._viewer: RerunViewer | None = None

    def open(self, path: Path | None, spawn: bool) -> None:
        """Open a viewer, see `RerunViewer`."""
        self._viewer = RerunViewer(path, spawn=spawn)

    def log(self, frame: Frame, estimate: Estimate, posterior_poses: Poses | None) -> None:
        """Show an image in the viewer."""
        assert self._viewer is not None
        self._viewer.log(frame, estimate, posterior_poses)

    def close(self, keep: bool = True) -> None:
        """Close the viewer, if there is one; the recording gets its name, or goes."""
        viewer, self._viewer = self._viewer, None
        if viewer is not None:
            viewer.close(keep=keep)

    def peak_rss_mb(self) -> float:
        """This process's own."""
        return peak_rss_mb()

    def pictures(self, record: RunRecord, directory: Path, title: str) -> list[Path]:
        """Draw the pictures of a run, see `write_pictures`."""
        return write_pictures(record, directory, title=title)


def serve() -> None:
    """Take calls until there are no more, or one fails: its error is the last answer."""
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what others print is no answer
    import matplotlib.backends.backend_agg
    import matplotlib.figure  # noqa: F401  while nobody waits
    import rerun.blueprint  # noqa: F401

    calls = Calls()
    with suppress(EOFError, pickle.UnpicklingError, BrokenPipeError):  # the other process has no more calls, or is gone
        _serve(calls, sys.stdin.buffer, answers)
    calls.close(keep=False)
    os._exit(0)  # at once: nothing is left to be done


def _serve(calls: Calls, source: BinaryIO, answers: BinaryIO) -> None:
    while True:
        name, arguments, is_asked = pickle.load(source)
        try:
            answer = getattr(calls, name)(*arguments)
        except Exception as error:
            with_trace = RuntimeError(f"in the process that draws:\n{traceback.format_exc()}")
            pickle.dump(error if isinstance(error, (VaporTrackError, OSError, MemoryError)) else with_trace, answers)
            answers.flush()
            return
        if is_asked:
            pickle.dump(answer, answers)
            answers.flush()
