"""The pictures of a run. To add one: a function in a file of its own in this folder, and a row here."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

from vapor.reporting.drawing import save_figure
from vapor.reporting.error_picture import error_figure
from vapor.reporting.particle_picture import particle_figure
from vapor.reporting.record import RunRecord
from vapor.reporting.trajectory_picture import trajectory_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PICTURES: Mapping[str, Callable[[RunRecord, str], Figure | None]] = MappingProxyType(
    {
        "trajectory.png": trajectory_figure,
        "particles.png": particle_figure,
        "errors.png": error_figure,
    }
)
"""File in a run's directory -> what draws it, given a title; None where the run has nothing to draw."""


def write_pictures(record: RunRecord, directory: Path, *, title: str) -> list[Path]:
    """Draw a run: the pictures of `PICTURES` that it has something for.

    Args:
        record: The run.
        directory: Where to put the pictures; it must exist.
        title: Printed over each picture, such as the name of the sequence.

    Returns:
        The pictures written; each appears under its name only when complete.

    Raises:
        SequenceError: a picture cannot be written.
    """
    figures = {name: draw(record, title) for name, draw in PICTURES.items()}
    return [save_figure(figure, directory / name) for name, figure in figures.items() if figure is not None]
