"""What came of one recording among many: a row of `summary.json`, from the stored results of its run."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from filtering.errors import listed
from sequences.reading.counts import ImageCounts
from vapor.evaluation.trajectory import associate, is_right
from vapor.reporting.html.drawings import evenly
from vapor.reporting.name_cell import WholeWords
from vapor.reporting.next_steps import TRAINED_ON, next_steps
from vapor.reporting.stored_run import StoredRun

if TYPE_CHECKING:
    from rich.table import Table

_NAMED = 5  # recordings in a sentence
STATES = ("right", "converged", "ambiguous", "lost", "wrong")
"""Of an image: its status, but where its true pose is known `converged` is `right` or `wrong`."""


@dataclass(frozen=True)
class Visited:
    """Where the camera was at some of the k images of a recording, evenly spread, and the state of each.

    Attributes:
        positions_m: In the map, rounded to centimetres, (k, 3).
        states: Of the same images, k.
        are_true: Whether these are true positions; else the filter's, which are guesses where it is lost.
    """

    positions_m: tuple[tuple[float, ...], ...] = ()
    states: tuple[str, ...] = ()
    are_true: bool = False


@dataclass(frozen=True)
class Outcome:
    """The result of one sequence, by the name of its folder: figures, or an error.

    Without true poses the median errors of the filter, and `success` (whether it found the place, and kept it), are
    None. `status` and `states` have fractions of the images; `few_images` is a sentence where fewer than half of the
    images were used. `steps` are what to do next, each with its reason.
    """

    name: str
    sequence: str
    error: str | None = None
    images: int = 0
    duration_s: float = 0.0
    status: dict[str, float] = field(default_factory=dict)
    states: dict[str, float] = field(default_factory=dict)
    final_status: str | None = None
    images_with_true_pose: int = 0
    median_translation_m: float | None = None
    median_rotation_deg: float | None = None
    success: bool | None = None
    skipped: dict[str, int] = field(default_factory=dict)
    few_images: str | None = None
    notices: tuple[str, ...] = ()
    steps: tuple[tuple[str, str], ...] = ()
    visited: Visited = Visited()

    @property
    def went_well(self) -> bool:
        """Whether the filter found the place and kept it; without true poses, whether it was sure at the end."""
        if self.error is not None:
            return False
        return self.final_status == "converged" if self.success is None else self.success

    @property
    def trained_on(self) -> bool:
        """Whether the model was trained on images of it, so that its errors say nothing about new images."""
        return any(TRAINED_ON in notice for notice in self.notices)

    @staticmethod
    def of_run(name: str, sequence: str, run: StoredRun, most_positions: int) -> Outcome:
        """The result of a run, with so many of the positions."""
        report, statuses = run.report, run.status["status"]
        errors, notices = report.get("filter", {}), tuple(report["notices"])
        few_images = None if (counts := report["images"]) is None else _counts(counts).warning
        steps, _ = next_steps(report, [*filter(None, [few_images]), *notices])
        states, visited = _states(run, most_positions)
        return Outcome(
            name,
            sequence,
            images=report["frames"],
            duration_s=report["duration_s"],
            status=report["status"],
            states=states,
            final_status=str(statuses[-1]),
            images_with_true_pose=report["frames_with_true_pose"],
            median_translation_m=errors.get("median_translation_m"),
            median_rotation_deg=errors.get("median_rotation_deg"),
            success=errors.get("success"),
            skipped=report["skipped"],
            few_images=few_images,
            notices=notices,
            steps=tuple(steps),
            visited=visited,
        )


def _counts(stored: Mapping[str, Any]) -> ImageCounts:
    return ImageCounts(**{**stored, "skipped": Counter(stored["skipped"])})


def _states(run: StoredRun, most_positions: int) -> tuple[dict[str, float], Visited]:
    """The fraction of the images in each state, and where the camera was."""
    estimate, truth = run.trajectories["filter"], run.trajectories.get("truth")
    states = np.array(run.status["status"], object)
    positions, shown = estimate.poses.translation, np.arange(len(states))
    if truth is not None:
        known, poses = associate(estimate.times_ns, truth)
        shown, sure = np.flatnonzero(known), states[known] == "converged"
        right = is_right(estimate.poses[known], poses)
        states[shown[sure & right]], states[shown[sure & ~right]] = "right", "wrong"
        positions = poses.translation
    some = evenly(len(shown), most_positions)
    fractions = {state: float(np.mean(states == state)) for state in STATES}
    return {state: round(part, 6) for state, part in fractions.items() if part}, Visited(
        tuple(tuple(each) for each in positions[some].round(2).tolist()),
        tuple(states[shown[some]].tolist()),
        are_true=truth is not None,
    )


def said_of_training(outcomes: Sequence[Outcome]) -> str | None:
    """Which recordings have images that the model was trained on; None where none has."""
    names = [outcome.name for outcome in outcomes if outcome.trained_on]
    return f"The model was trained on images of {len(names)} of these: {listed(names, _NAMED)}." if names else None


def total(outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """Sums over sequences: fractions are of all images, the median is that of the sequences' medians."""
    images = sum(outcome.images for outcome in outcomes)
    converged = sum(outcome.images * outcome.status.get("converged", 0.0) for outcome in outcomes)
    medians = [outcome.median_translation_m for outcome in outcomes if outcome.median_translation_m is not None]
    successes = [outcome.success for outcome in outcomes if outcome.success is not None]
    return {
        "failed": sum(outcome.error is not None for outcome in outcomes),
        "went_well": sum(outcome.went_well for outcome in outcomes),
        "images": images,
        "duration_s": round(sum(outcome.duration_s for outcome in outcomes), 6),
        "converged": round(converged / images, 6) if images else None,
        "median_translation_m": round(float(np.median(medians)), 6) if medians else None,
        "judged": len(successes),
        "successes": sum(successes),
    }


def format_batch(outcomes: Sequence[Outcome]) -> Table:
    """A row a sequence; those of error and success only where there are true poses."""
    from rich.table import Table

    has_truth = any(outcome.median_translation_m is not None for outcome in outcomes)
    table = Table()
    table.add_column("sequence")
    for name in ("images", "duration", "converged", "at the end"):
        table.add_column(name, justify="right")
    for name in ("median error", "success") if has_truth else ():
        table.add_column(name, justify="right")
    for o in outcomes:
        if o.error is not None:
            table.add_row(WholeWords(o.name), "", "", "", "failed", style="red")
            continue
        error = (
            "" if o.median_translation_m is None else f"{o.median_translation_m:.2f} m  {o.median_rotation_deg:5.1f}°"
        )
        success = "" if o.success is None else "yes" if o.success else "no"
        table.add_row(
            WholeWords(o.name),
            str(o.images),
            f"{o.duration_s:.1f} s",
            f"{100 * o.status['converged']:.0f} %",
            o.final_status,
            *((error, success) if has_truth else ()),
        )
    return table
