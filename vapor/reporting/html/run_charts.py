"""A run over time: errors, status, and how sure the filter was."""

from __future__ import annotations

from dataclasses import dataclass
from html import escape
from typing import Any

import numpy as np

from vapor.evaluation.trajectory import RIGHT, THRESHOLDS, pose_errors
from vapor.reporting.colors import COLORS
from vapor.reporting.html.page import Plot
from vapor.reporting.record import RunRecord
from vapor.tracking.methods import METHODS

_LEAST = 1e-3  # of an error that is drawn: dead reckoning begins on the truth
_MOST_POINTS = 3000


@dataclass(frozen=True)
class StatusStrip:
    """The status over time, as a strip of colours."""

    record: RunRecord

    def html(self, packed: dict[str, Any]) -> str:
        """See `vapor.reporting.html.page.Block`."""
        record = self.record
        seconds = (record.times_ns - record.times_ns[0]) / 1e9
        total = max(float(seconds[-1]), 1e-9)
        starts = [i for i, status in enumerate(record.status) if i == 0 or status != record.status[i - 1]]
        ends = [*(float(seconds[i]) for i in starts[1:]), total]
        bars = "".join(
            f'<rect x="{1000 * seconds[first] / total:.2f}" width="{1000 * (end - seconds[first]) / total:.2f}" y="0"'
            f' height="10" style="fill:var(--{record.status[first]})"/>'
            for first, end in zip(starts, ends, strict=True)
        )
        parts = {name: record.status.count(name) / len(record.status) for name in ("converged", "ambiguous", "lost")}
        said = ", ".join(f"{name} in {100 * part:.0f} % of the images" for name, part in parts.items() if part)
        key = "".join(
            f'<span><i style="background:var(--{name})"></i>{name} {100 * part:.0f} %</span>'
            for name, part in parts.items()
            if part
        )
        return (
            f'<svg class="strip" viewBox="0 0 1000 10" preserveAspectRatio="none" role="img"'
            f' aria-label="{escape(f"Status over {total:.1f} s: {said}")}">{bars}</svg>'
            f'<p class="note key">{key}over {total:.1f} s</p>'
        )


def error_plot(record: RunRecord) -> Plot | None:
    """Errors of position and rotation over time; None without any true pose."""
    if record.truth is None:
        return None
    traces: list[dict[str, Any]] = []
    start_ns = int(record.times_ns[0])
    for name, trajectory in record.methods.items():
        method = METHODS[name]
        times_ns, *errors = pose_errors(trajectory, record.truth)
        some = np.linspace(0, len(times_ns) - 1, min(len(times_ns), _MOST_POINTS)).round().astype(int)
        seconds = ((times_ns[some] - start_ns) / 1e9).round(3).tolist()
        drawn = {"mode": "markers", "marker": {"size": 3, "color": method.color, "opacity": 0.6}}
        if method.kind != "image":
            drawn = {"mode": "lines", "line": {"width": 1.6, "color": method.color}}
        for axis, error, unit in zip(("y", "y2"), errors, (" m", "°"), strict=True):
            traces.append(
                {
                    "type": "scatter",
                    "name": method.label,
                    "legendgroup": name,
                    "showlegend": axis == "y",
                    "visible": True if method.error_curve else "legendonly",
                    "x": seconds,
                    "y": np.maximum(error[some], _LEAST).round(4).tolist(),
                    "yaxis": axis,
                    "hovertemplate": f"%{{x:.1f}} s: %{{y:.3f}}{unit}",
                    **drawn,
                }
            )
    limits = THRESHOLDS[RIGHT]
    lines = [
        {
            "type": "line",
            "xref": "paper",
            "x0": 0,
            "x1": 1,
            "yref": axis,
            "y0": limit,
            "y1": limit,
            "line": {"width": 1, "dash": "dash", "color": "#808890"},
        }
        for axis, limit in zip(("y", "y2"), limits, strict=True)
    ]
    layout = {
        "margin": {"l": 65, "r": 10, "t": 10, "b": 40},
        "hovermode": "closest",
        "shapes": lines,
        "legend": {"orientation": "h", "y": 1.02, "yanchor": "bottom", "x": 0},
        "xaxis": {"title": {"text": "time [s]"}, "anchor": "y2", "range": [0, _duration_s(record)]},
        "yaxis": {"title": {"text": "position [m]"}, "type": "log", "domain": [0.54, 1.0], "minor": {"nticks": 0}},
        "yaxis2": {"title": {"text": "rotation [°]"}, "type": "log", "domain": [0.0, 0.46]},
    }
    return Plot(
        "errors",
        traces,
        layout,
        "Errors of position and rotation over time",
        f"Dashed: within {limits[0]:g} m and {limits[1]:g}° a pose counts as right.",
    )


def belief_plot(record: RunRecord) -> Plot:
    """How sure the filter was, over time: weight of the best mode, agreement of the images, number of modes."""
    some = np.linspace(0, len(record.times_ns) - 1, min(len(record.times_ns), _MOST_POINTS)).round().astype(int)
    seconds = ((record.times_ns[some] - record.times_ns[0]) / 1e9).round(3).tolist()
    position_m = np.sqrt(np.linalg.eigvalsh(record.covariance[some, :3, :3])[:, -1])
    curves = (
        ("weight of the best mode", record.best_weight[some], COLORS["filter"], "y"),
        ("agreement of the images", record.agreement[some], "#009e73", "y"),
        ("standard deviation of the best mode [m]", np.maximum(position_m, _LEAST), COLORS["filter"], "y2"),
    )
    traces = [
        {
            "type": "scatter",
            "mode": "lines",
            "name": name,
            "x": seconds,
            "y": values.round(4).tolist(),
            "yaxis": axis,
            "line": {"width": 1.6, "color": color, "dash": "dot" if axis == "y2" else "solid"},
        }
        for name, values, color, axis in curves
    ]
    layout = {
        "margin": {"l": 65, "r": 10, "t": 10, "b": 40},
        "legend": {"orientation": "h", "y": 1.02, "yanchor": "bottom", "x": 0},
        "xaxis": {"title": {"text": "time [s]"}, "anchor": "y2", "range": [0, _duration_s(record)]},
        "yaxis": {"title": {"text": "fraction"}, "range": [0, 1.05], "domain": [0.54, 1.0]},
        "yaxis2": {"title": {"text": "deviation [m]"}, "type": "log", "domain": [0.0, 0.46]},
    }
    return Plot("belief", traces, layout, "How sure the filter was, over time")


def _duration_s(record: RunRecord) -> float:
    return max(float(record.times_ns[-1] - record.times_ns[0]) / 1e9, 1e-3)
