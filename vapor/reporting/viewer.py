"""What watches a run while it goes on."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Protocol

from filtering.estimate import Estimate
from filtering.se3 import Poses
from sequences.frame import Frame
from vapor.reporting.drawing_process import DrawingProcess, drawing_process


class Viewer(Protocol):
    """Watches a run."""

    def log(self, frame: Frame, estimate: Estimate, posterior_poses: Poses | None) -> None:
        """Show one image, the belief after it, and samples (m,) of the image's own posterior."""
        ...


class NullViewer:
    """Shows nothing, so that the loop never asks."""

    def log(self, frame: Frame, estimate: Estimate, posterior_poses: Poses | None) -> None:
        """Do nothing."""


class ViewerBeside:
    """A `RerunViewer` in the drawing process: what is shown there does not keep the loop waiting."""

    def __init__(self, process: DrawingProcess) -> None:
        self._process = process

    def log(self, frame: Frame, estimate: Estimate, posterior_poses: Poses | None) -> None:
        """Hand over one image, see `RerunViewer.log`.

        Raises:
            VaporTrackError: what came before could not be written, or the viewer not be started.
        """
        self._process.send("log", frame, estimate, posterior_poses)


@contextmanager
def open_viewer(recording: Path | None, *, view: bool) -> Iterator[Viewer]:
    """What watches a run, for a `with` block.

    Args:
        recording: The recording to write; after an error in the block it is not there. None for none.
        view: Whether to open the Rerun viewer's window and stream into it.

    Raises:
        VaporTrackError: the viewer cannot be started, or the recording cannot be written; perhaps only at the end.
    """
    if recording is None and not view:
        yield NullViewer()
        return
    with drawing_process() as process:
        process.send("open", recording, view)
        yield ViewerBeside(process)
        process.ask("close")
