"""Figures of a run that need no script: the status over time, the plan of the place, the reliability of weights."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from html import escape
from typing import Any

import numpy as np
from jaxtyping import Bool, Float64, Int64

from filtering.estimate import STATUSES
from filtering.storeys import up_axis
from vapor.reporting.drawing import jumps
from vapor.reporting.html.page import Block, table
from vapor.reporting.html.plans import Plans, line
from vapor.reporting.outline import Outline
from vapor.reporting.record import RunRecord

_MOST_POINTS = 1500  # of a path
_DIAGRAM = 260  # side of a diagram, pixels
_LABELS = 50  # below and to the left of it


def status_strip(record: RunRecord) -> Block:
    """The status over time, as a strip of colours."""
    seconds = (record.times_ns - record.times_ns[0]) / 1e9
    total = max(float(seconds[-1]), 1e-9)
    starts = [i for i, status in enumerate(record.status) if i == 0 or status != record.status[i - 1]]
    ends = [*(float(seconds[i]) for i in starts[1:]), total]
    bars = "".join(
        f'<rect x="{1000 * seconds[first] / total:.2f}" width="{1000 * (end - seconds[first]) / total:.2f}" y="0"'
        f' height="10" style="fill:var(--{record.status[first]})"/>'
        for first, end in zip(starts, ends, strict=True)
    )
    parts = {name: record.status.count(name) / len(record.status) for name in STATUSES}
    words = ", ".join(f"{name} in {100 * part:.0f} % of the images" for name, part in parts.items() if part)
    key = "".join(
        f'<span><i style="background:var(--{name})"></i>{name} {100 * part:.0f} %</span>'
        for name, part in parts.items()
        if part
    )
    return Block(
        f'<svg class="strip" viewBox="0 0 1000 10" preserveAspectRatio="none" role="img"'
        f' aria-label="{escape(f"Status over {total:.1f} s: {words}")}">{bars}</svg>'
        f'<p class="note key">{key}over {total:.1f} s</p>'
    )


def plan(record: RunRecord, outline: Outline) -> Block:
    """The place from above under the path of the filter: one plan, or one of each storey that the path is on."""
    path = record.methods["filter"].poses
    true_path = np.empty((0, 3)) if record.truth is None else record.truth.poses.translation
    plans = Plans.of(outline, path.translation, record.storeys, up_axis(path))
    thin, thin_truth = ThinnedPath.of(path.translation), ThinnedPath.of(true_path)
    at, truth = plans.drawn(path.translation), plans.drawn(true_path)
    of_path, of_truth = plans.storey(path.translation), plans.storey(true_path)
    doubted = np.array([status != "converged" for status in record.status])
    marks = {
        number: line("path", _polylines(at, of_path == number, thin))
        + line("doubted", _polylines(at, (of_path == number) & doubted, thin))
        + line("truth", _polylines(truth, of_truth == number, thin_truth))
        for number in np.unique(of_path).tolist()
    }
    key = [("path", "particle filter")]
    key += [("doubted", "not converged")] if doubted.any() else []
    key += [("truth", "truth")] if record.truth is not None else []
    return plans.block(marks, key, "The path")


def reliability(of_report: Mapping[str, Mapping[str, Any]]) -> Block:
    """How often the best mode is right, by its weight, from the `reliability` of a report: a diagram and its table."""
    total = sum(each["images"] for each in of_report.values())

    def at(stated: float, right: float) -> str:
        return f"{_LABELS + _DIAGRAM * stated:.0f} {10 + _DIAGRAM * (1.0 - right):.0f}"

    dots = "".join(
        f'<path class="dot" d="M{at(each["stated"], each["right"])}h0"'
        f' stroke-width="{6.0 + 24.0 * float(np.sqrt(each["images"] / total)):.0f}"/>'
        for each in of_report.values()
    )
    ticks = "".join(
        f'<path class="grid" d="M{at(part, 0.0)}V10M{at(0.0, part)}H{_LABELS + _DIAGRAM}"/>'
        f'<text x="{_LABELS + _DIAGRAM * part:.0f}" y="{_DIAGRAM + 28}" text-anchor="middle">{part:g}</text>'
        f'<text x="{_LABELS - 8}" y="{14 + _DIAGRAM * (1.0 - part):.0f}" text-anchor="end">{part:g}</text>'
        for part in (0.0, 0.5, 1.0)
    )
    middle = _LABELS + _DIAGRAM // 2
    words = f'<text x="{middle}" y="{_DIAGRAM + 48}" text-anchor="middle">stated weight of the best mode</text>'
    beside = (
        f'<text transform="translate(14 {10 + _DIAGRAM // 2}) rotate(-90)" text-anchor="middle">images right</text>'
    )
    diagram = (
        f'<svg class="diagram" viewBox="0 0 {_LABELS + _DIAGRAM + 20} {_DIAGRAM + 56}" role="img"'
        f' aria-label="How often the best mode is right, by its weight; the table has the numbers">{ticks}'
        f'<path class="diagonal" d="M{at(0.0, 0.0)}L{at(1.0, 1.0)}"/>{dots}{words}{beside}</svg>'
    )
    rows = [
        (f"{low} to {float(low) + 0.1:.1f}", f"{each['images']}", f"{each['stated']:.2f}", f"{each['right']:.2f}")
        for low, each in of_report.items()
    ]
    numbers = table(("weight", "images", "stated", "right"), rows, "The best mode, by its weight")
    return Block(f'<div class="pair"><figure>{diagram}</figure>{numbers.html}</div>')


def _polylines(points: Float64[np.ndarray, "n 2"], mask: Bool[np.ndarray, " n"], path: ThinnedPath) -> str:
    """The masked parts of a path as one line of an SVG."""
    words, goes_on = [], False
    for i, broken in zip(path.kept.tolist(), path.broken.tolist(), strict=True):
        if mask[i]:
            words.append(f"{'L' if goes_on and not broken else 'M'}{points[i, 0]:.0f} {points[i, 1]:.0f}")
        goes_on = bool(mask[i])
    return "".join(words)


@dataclass(frozen=True)
class ThinnedPath:
    """Which positions of a path are drawn, in order, and whether it is broken before each, as a hypothesis jumped."""

    kept: Int64[np.ndarray, " k"]
    broken: Bool[np.ndarray, " k"]

    @staticmethod
    def of(positions: Float64[np.ndarray, "n 3"]) -> ThinnedPath:
        """Some 1500 at most of the positions (metres), and those around jumps, much farther than is usual."""
        jumped = jumps(positions)
        kept = np.unique(np.concatenate([evenly(len(positions)), jumped, np.maximum(jumped - 1, 0)]))
        return ThinnedPath(kept, np.isin(kept, jumped))


def evenly(count: int, most: int = _MOST_POINTS) -> Int64[np.ndarray, " k"]:
    """At most so many of `count` indices, evenly spaced, the first and the last among them."""
    return np.linspace(0, count - 1, min(count, most)).round().astype(np.int64)
