"""The picture of a run's errors over time, and of what the filter said of itself."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from vapor.evaluation.trajectory import RIGHT, THRESHOLDS, convergence_s, pose_errors
from vapor.reporting.colors import COLORS, INK
from vapor.reporting.drawing import add_title, new_figure, quiet_axes
from vapor.reporting.record import RunRecord
from vapor.tracking.methods import METHODS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def error_figure(record: RunRecord, title: str) -> Figure | None:
    """Draw the errors of position and rotation over time, and the status above them; None without any true pose."""
    if record.truth is None:
        return None
    figure = new_figure(9.5, 5.6)
    band, *panels = figure.subplots(3, 1, sharex=True, height_ratios=[0.06, 1, 1])
    start_ns = int(record.times_ns[0])
    limits = THRESHOLDS[RIGHT]
    for name, trajectory in record.methods.items():
        method = METHODS[name]
        if not method.error_curve:
            continue
        times_ns, *errors = pose_errors(trajectory, record.truth)
        seconds = (times_ns - start_ns) / 1e9
        for ax, error in zip(panels, errors, strict=True):
            error = np.maximum(error, 1e-9)
            if method.kind == "image":
                style = {"s": 6.0, "linewidths": 0.0, "alpha": 0.55, "rasterized": True}
                ax.scatter(seconds, error, color=method.color, label=method.label, **style)
            else:
                ax.plot(seconds, error, color=method.color, label=method.label, linewidth=1.6)
        if name == "filter":
            right = (errors[0] <= limits[0]) & (errors[1] <= limits[1])
            moment = convergence_s(times_ns, right, start_ns=start_ns)
            for ax in panels if moment is not None else ():
                ax.axvline(float(moment or 0.0), color=INK, linewidth=1.0)
            if moment is not None:
                note = f" right from {moment:.1f} s on"
                at = (moment, 0.97)
                panels[0].annotate(note, at, xycoords=("data", "axes fraction"), va="top", fontsize=9, color=INK)
    for ax, limit, name, unit in zip(panels, limits, ("translation error", "rotation error"), "m°", strict=True):
        ax.set_yscale("log")
        ax.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
        ax.set_ylabel(f"{name} [{unit}]")
        ax.axhline(limit, color=INK, linewidth=0.8, linestyle=(0, (4, 3)))
        note = f"{limit:g} m" if unit == "m" else f"{limit:g}°"
        style = {"xycoords": ("axes fraction", "data"), "va": "center", "fontsize": 8, "color": INK}
        ax.annotate(note, (1.005, limit), **style)
        ax.grid(axis="y", color="#e8e8e8", linewidth=0.7)
        ax.set_axisbelow(True)
        quiet_axes(ax)
        _limit_log_axis(ax, limit)
    _draw_status(band, record)
    panels[-1].set_xlabel("time [s]")
    panels[-1].set_xlim(0.0, max((int(record.times_ns[-1]) - start_ns) / 1e9, 1e-3))
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), frameon=False, markerscale=1.8)
    add_title(figure, title)
    return figure


def _limit_log_axis(ax: Axes, limit: float) -> None:
    """Dead reckoning starts on the truth: an error of 1e-9 m must not stretch the axis to nothing."""
    _, high = ax.get_ylim()
    drawn = [np.asarray(line.get_ydata(), float) for line in ax.get_lines()]
    values = np.concatenate([*(values for values in drawn if len(values) > 2), [limit]])
    low = max(float(np.percentile(values[values > 1e-6], 1)) / 2, high / 1e4)
    ax.set_ylim(min(low, limit / 2), max(high, limit * 2))


def _draw_status(ax: Axes, record: RunRecord) -> None:
    from matplotlib.patches import Patch

    seconds = (record.times_ns - record.times_ns[0]) / 1e9
    edges = np.append(seconds, seconds[-1])
    starts = [i for i, status in enumerate(record.status) if i == 0 or status != record.status[i - 1]]
    spans = zip(starts, [*starts[1:], len(record.status)], strict=True)
    for first, last in spans:
        ax.axvspan(edges[first], edges[last], color=COLORS[record.status[first]], linewidth=0)
    ax.set_axis_off()
    present = [status for status in ("converged", "ambiguous", "lost") if status in record.status]
    patches = [Patch(color=COLORS[status], label=status) for status in present]
    style = {"frameon": False, "fontsize": 8, "handlelength": 1.2, "handleheight": 0.9, "columnspacing": 1.2}
    ax.legend(handles=patches, loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, borderpad=0.0, **style)
