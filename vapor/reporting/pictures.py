"""Pictures of a run: the paths, the errors over time, and the particles at a few keyframes."""

from __future__ import annotations

from pathlib import Path

from vapor.reporting.error_picture import error_figure
from vapor.reporting.figures import save_figure
from vapor.reporting.particle_picture import particle_figure
from vapor.reporting.record import RunRecord
from vapor.reporting.trajectory_picture import trajectory_figure


def write_pictures(record: RunRecord, directory: Path, *, title: str) -> list[Path]:
    """Draw a run into `trajectory.png`, `particles.png` and, where true poses are known, `errors.png`.

    Args:
        record: The run.
        directory: Where to put the pictures; it must exist.
        title: Printed over each picture, such as the name of the sequence.

    Returns:
        The pictures written; each appears under its name only when complete.

    Raises:
        SequenceError: a picture cannot be written.
    """
    figures = {"trajectory.png": trajectory_figure(record, title), "particles.png": particle_figure(record, title)}
    if record.truth is not None:
        figures["errors.png"] = error_figure(record, record.truth, title)
    return [save_figure(figure, directory / name) for name, figure in figures.items()]
