"""What was measured of the parts of landmarks, as figures, tables and a sentence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from vapor.experiments.landmarks import PartsConfig
from vapor.experiments.local_features import SIFT
from vapor.experiments.pose_solvers import POSELIB
from vapor.landmarks.landmark_map import LEAST_INLIERS

MANY_INLIERS = 25
"""Landmarks with which a pose is hardly ever wrong."""
_WRONG_M, _WRONG_DEG = 0.3, 20.0
CELL = f"cm (°), verified; of these wrong, of those with {MANY_INLIERS} landmarks"
"""What stands in a cell of a table."""


@dataclass(frozen=True)
class Figures:
    """What a cell says.

    Attributes:
        images: That were localized.
        median_m: Half of all images err by less, metres; infinite where a pose is found for fewer.
        median_deg: Likewise, degrees.
        verified: Fraction of the images of which landmarks verify a pose.
        wrong: Fraction of these whose pose is wrong by 0.3 m or 20°; None where there are none.
        wrong_of_many: Fraction of those verified by `MANY_INLIERS` or more.
    """

    images: int
    median_m: float
    median_deg: float
    verified: float
    wrong: float | None
    wrong_of_many: float | None


def figures(cell: Mapping[str, Any]) -> Figures:
    """The figures of a cell of `measured`."""
    inliers = np.array(cell["inliers"])
    metres, degrees = (np.array([np.inf if e is None else e for e in cell[of]]) for of in ("metres", "degrees"))
    wrong = (metres > _WRONG_M) | (degrees > _WRONG_DEG)

    def fraction(least: int) -> float | None:
        some = inliers >= least
        return float(wrong[some].mean()) if some.any() else None

    return Figures(
        len(inliers),
        float(np.median(metres)),
        float(np.median(degrees)),
        float((inliers >= LEAST_INLIERS).mean()),
        fraction(LEAST_INLIERS),
        fraction(MANY_INLIERS),
    )


@dataclass(frozen=True)
class PartsTable:
    """What was measured on one recording.

    Attributes:
        recording: Its name.
        measured: On what, in words.
        columns: Headings.
        rows: Cells, the first the features and the solver.
    """

    recording: str
    measured: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


def tables(cells: Sequence[Mapping[str, Any]]) -> list[PartsTable]:
    """A table for each recording: a row for each choice of parts, a column for each disturbance."""
    return [
        _table([c for c in cells if c["recording"] == name]) for name in dict.fromkeys(c["recording"] for c in cells)
    ]


def _table(cells: Sequence[Mapping[str, Any]]) -> PartsTable:
    disturbances = tuple(dict.fromkeys(cell["disturbance"] for cell in cells))
    rows: list[tuple[str, ...]] = []
    for features, solver in dict.fromkeys((cell["features"], cell["solver"]) for cell in cells):
        own = {cell["disturbance"]: cell for cell in cells if (cell["features"], cell["solver"]) == (features, solver)}
        times = [own[disturbances[0]][what] for what in ("features_ms", "pose_ms")]
        spent = " + ".join("–" if ms is None else f"{ms:.0f}" for ms in times)
        rows.append((f"{features}, {solver}", *(_cell(figures(own[each])) for each in disturbances), f"{spent} ms"))
    about = f"{len(cells[0]['inliers'])} images, each cell: {CELL}"
    return PartsTable(cells[0]["recording"], about, ("", *disturbances, "features + pose"), tuple(rows))


def _cell(found: Figures) -> str:
    error = "–" if np.isinf(found.median_m) else f"{100 * found.median_m:.1f} ({found.median_deg:.1f})"
    wrong = ["–" if part is None else f"{100 * part:.0f}" for part in (found.wrong, found.wrong_of_many)]
    return f"{error}, {100 * found.verified:.0f} %; {wrong[0]}, {wrong[1]} %"


def markdown(cells: Sequence[Mapping[str, Any]], left_out: Sequence[str]) -> str:
    """The tables as Markdown, and what was left out."""
    lines: list[str] = []
    for table in tables(cells):
        lines += [f"**{table.recording}**, {table.measured}", ""]
        lines += ["| " + " | ".join(table.columns) + " |", "|---" * len(table.columns) + "|"]
        lines += ["| " + " | ".join(row) + " |" for row in table.rows]
        lines.append("")
    return "\n".join([*lines, *left_out])


def in_order(cells: Sequence[Mapping[str, Any]], config: PartsConfig) -> list[Mapping[str, Any]]:
    """Cells in the order of the settings."""
    place = {name: k for k, name in enumerate((*config.recordings, *config.features, *config.solvers))}
    column = {name: k for k, name in enumerate(config.disturbances)}
    return sorted(
        cells,
        key=lambda c: (place[c["recording"]], place[c["features"]], place[c["solver"]], column[c["disturbance"]]),
    )


def verdict(cells: Sequence[Mapping[str, Any]]) -> str:
    """Which parts are the most exact where images are as they are, and how ours compare, by recording."""
    said: list[str] = []
    for name in dict.fromkeys(cell["recording"] for cell in cells):
        first = next(cell["disturbance"] for cell in cells if cell["recording"] == name)
        own = {
            (c["features"], c["solver"]): figures(c).median_m
            for c in cells
            if c["recording"] == name and c["disturbance"] == first
        }
        best = min(own, key=lambda parts: own[parts])
        if np.isinf(own[best]):
            said.append(f"{name}: no choice localizes half of the images.")
            continue
        ours = own.get((SIFT, POSELIB))
        beside = "" if ours is None or best == (SIFT, POSELIB) else f", {SIFT} and {POSELIB} {100 * ours:.1f} cm"
        said.append(f"{name}: {' and '.join(best)} err least, {100 * own[best]:.1f} cm{beside}.")
    return " ".join(said)
