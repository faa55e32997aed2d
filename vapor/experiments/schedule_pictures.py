"""Picture of the schedule experiment: recall over the time of training."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from vapor.experiments.schedule import DEFAULT, PAPER, Point
from vapor.reporting.colors import COLORS
from vapor.reporting.drawing import new_figure, save_figure

_COLOR = {DEFAULT: COLORS["filter"], PAPER: COLORS["other"]}


def draw_courses(path: Path, courses: Mapping[str, Sequence[Point]], *, title: str) -> Path:
    """Recall of held-out images over minutes and over images seen, of both schedules.

    Args:
        path: The picture, PNG.
        courses: By schedule.
        title: What is drawn.
    """
    figure = new_figure(9.5, 3.6)
    over_time, over_images = figure.subplots(1, 2, sharey=True)
    for schedule, course in courses.items():
        recall = [point.recall for point in course]
        over_time.plot([p.seconds / 60 for p in course], recall, ".-", color=_COLOR[schedule], label=schedule)
        over_images.plot([p.images / 1000 for p in course], recall, ".-", color=_COLOR[schedule], label=schedule)
    for ax, label in ((over_time, "training [min]"), (over_images, "images seen [thousands]")):
        ax.axhline(max(p.recall for p in courses[DEFAULT]), color="#888888", lw=0.8, ls=":")
        ax.set(xlabel=label, xlim=(0, None), ylim=(0, None))
        ax.legend(loc="lower right", frameon=False)
    over_time.set_ylabel("samples at the true pose")
    figure.suptitle(title, x=0.01, ha="left", fontsize=12, fontweight="bold")
    return save_figure(figure, path)
