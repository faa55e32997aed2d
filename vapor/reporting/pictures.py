"""Pictures of a run: the paths, the errors over time, and the particles at a few telling moments."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float64

from filtering.se3 import Poses
from sequences.atomic import atomic_output
from sequences.frame import Trajectory
from vapor.evaluation.trajectory import RIGHT, THRESHOLDS, convergence_s, pose_errors
from vapor.reporting.record import Moment, RunRecord, telling_moments

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LABELS: Mapping[str, str] = MappingProxyType(
    {
        "single_image": "single image",
        "dead_reckoning": "dead reckoning",
        "kalman": "Kalman filter",
        "gaussian_sum": "Gaussian sum",
        "filter": "particle filter",
        "smoothed": "smoothed",
    }
)
"""What a method is called where a person reads."""

COLORS: Mapping[str, str] = MappingProxyType(
    {
        "truth": "#222222",
        "single_image": "#e69f00",
        "dead_reckoning": "#56b4e9",
        "kalman": "#cc79a7",
        "gaussian_sum": "#8c564b",
        "filter": "#0072b2",
        "smoothed": "#009e73",
        "other": "#d55e00",  # hypotheses beside the best one
        "converged": "#cfdde6",
        "ambiguous": "#f0c8a0",
        "lost": "#b5423a",
    }
)
"""One colour for each method in every picture (Okabe and Ito's palette, safe for the colour-blind)."""

_AXES = ("x", "y", "z")
_SOFTWARE = "vapor-track"  # as a PNG says that made it
_INK = "#333333"
_FAINT = "#b8b8b8"
_THINNEST = 0.12  # of the longest axis: thinner, and the labels would not fit


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
    figures = {"trajectory.png": _trajectory_figure(record, title), "particles.png": _particles_figure(record, title)}
    if record.truth is not None:
        figures["errors.png"] = _errors_figure(record, record.truth, title)
    return [save_figure(figure, directory / name) for name, figure in figures.items()]


# --- the paths ---------------------------------------------------------------------------------------


def _trajectory_figure(record: RunRecord, title: str) -> Figure:
    low, high = _extent(record)
    planes = _planes(low, high)
    sizes = np.array([high[list(plane)] - low[list(plane)] for plane in planes])
    height = 5.6
    widths = np.clip(height * sizes[:, 0] / sizes[:, 1], 2.2, 8.5)
    figure = new_figure(float(widths.sum()) + 1.0 * len(planes) + 1.9, height + 1.0)
    axes = figure.subplots(1, len(planes), squeeze=False, gridspec_kw={"width_ratios": widths})[0]
    for ax, plane in zip(axes, planes, strict=True):
        _prepare_plane(ax, plane, low, high)
        ax.set_ylabel(f"{_AXES[plane[1]]} [m]")
        if record.truth is not None:
            _draw_path(ax, record.truth.poses, plane, color=COLORS["truth"], linewidth=4.5, alpha=0.22, label="truth")
        for name, trajectory in record.methods.items():
            if name == "single_image":
                points = trajectory.poses.translation
                style = {"s": 7.0, "linewidths": 0.0, "alpha": 0.55, "rasterized": True}
                ax.scatter(points[:, plane[0]], points[:, plane[1]], color=COLORS[name], label=LABELS[name], **style)
            else:
                width = 1.8 if name in ("filter", "smoothed") else 1.3
                _draw_path(ax, trajectory.poses, plane, color=COLORS[name], linewidth=width, label=LABELS[name])
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside right upper", frameon=False, markerscale=1.8)
    figure.suptitle(title, x=0.01, ha="left", fontsize=12, fontweight="bold", color=_INK)
    return figure


def _draw_path(ax: Axes, poses: Poses, plane: tuple[int, int], **style: object) -> None:
    """A line through the positions that is broken where a hypothesis jumped instead of moving."""
    points = poses.translation
    step = np.linalg.norm(np.diff(points, axis=0), axis=1)
    jumps = np.flatnonzero(step > 0.4 + 6.0 * np.median(step)) + 1 if len(step) else []
    points = np.insert(points, jumps, np.nan, axis=0)
    ax.plot(points[:, plane[0]], points[:, plane[1]], solid_capstyle="round", **style)  # pyright: ignore[reportArgumentType]


# --- the errors --------------------------------------------------------------------------------------


def _errors_figure(record: RunRecord, truth: Trajectory, title: str) -> Figure:
    figure = new_figure(9.5, 5.6)
    band, *panels = figure.subplots(3, 1, sharex=True, height_ratios=[0.06, 1, 1])
    start_ns = int(record.times_ns[0])
    limits = THRESHOLDS[RIGHT]
    for name in ("single_image", "dead_reckoning", "kalman", "filter"):
        if name not in record.methods:
            continue
        times_ns, *errors = pose_errors(record.methods[name], truth)
        seconds = (times_ns - start_ns) / 1e9
        for ax, error in zip(panels, errors, strict=True):
            error = np.maximum(error, 1e-9)
            if name == "single_image":
                style = {"s": 6.0, "linewidths": 0.0, "alpha": 0.55, "rasterized": True}
                ax.scatter(seconds, error, color=COLORS[name], label=LABELS[name], **style)
            else:
                ax.plot(seconds, error, color=COLORS[name], label=LABELS[name], linewidth=1.6)
        if name == "filter":
            right = (errors[0] <= limits[0]) & (errors[1] <= limits[1])
            moment = convergence_s(times_ns, right, start_ns=start_ns)
            for ax in panels if moment is not None else ():
                ax.axvline(float(moment or 0.0), color=_INK, linewidth=1.0)
            if moment is not None:
                note = f" right from {moment:.1f} s on"
                at = (moment, 0.97)
                panels[0].annotate(note, at, xycoords=("data", "axes fraction"), va="top", fontsize=9, color=_INK)
    for ax, limit, name, unit in zip(panels, limits, ("translation error", "rotation error"), "m°", strict=True):
        ax.set_yscale("log")
        ax.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
        ax.set_ylabel(f"{name} [{unit}]")
        ax.axhline(limit, color=_INK, linewidth=0.8, linestyle=(0, (4, 3)))
        note = f"{limit:g} m" if unit == "m" else f"{limit:g}°"
        style = {"xycoords": ("axes fraction", "data"), "va": "center", "fontsize": 8, "color": _INK}
        ax.annotate(note, (1.005, limit), **style)
        ax.grid(axis="y", color="#e8e8e8", linewidth=0.7)
        ax.set_axisbelow(True)
        _quiet(ax)
        _limit_log_axis(ax, limit)
    _draw_status(band, record)
    panels[-1].set_xlabel("time [s]")
    panels[-1].set_xlim(0.0, max((int(record.times_ns[-1]) - start_ns) / 1e9, 1e-3))
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), frameon=False, markerscale=1.8)
    figure.suptitle(title, x=0.01, ha="left", fontsize=12, fontweight="bold", color=_INK)
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


# --- the particles -----------------------------------------------------------------------------------


def _particles_figure(record: RunRecord, title: str) -> Figure:
    moments = telling_moments(list(record.moments), 5)
    low, high = _extent(record)
    plane = _planes(low, high)[-1]
    size = (high - low)[list(plane)]
    panel_width = 2.35
    panel_height = float(np.clip(panel_width * size[1] / size[0], 1.6, 6.0))
    pixels_high, pixels_wide = moments[0].thumbnail.shape[:2]
    image_height = panel_width * min(pixels_high / pixels_wide, 1.0) if pixels_high else 0.05
    width = max(panel_width * len(moments) + 0.8, 6.0)
    one_line = width > 9.0
    figure = new_figure(width, image_height + panel_height + (1.4 if one_line else 1.7))
    axes = figure.subplots(2, len(moments), squeeze=False, gridspec_kw={"height_ratios": [image_height, panel_height]})
    for column, moment in enumerate(moments):
        if moment.thumbnail.size:
            axes[0, column].imshow(moment.thumbnail)
        axes[0, column].set_axis_off()
        count = len(moment.modes)
        hypotheses = "1 hypothesis" if count == 1 else f"{count} hypotheses"
        seconds = (moment.time_ns - int(record.times_ns[0])) / 1e9
        axes[0, column].set_title(f"{seconds:.1f} s · {hypotheses}", fontsize=10, color=_INK)
        ax = axes[1, column]
        _prepare_plane(ax, plane, low, high)
        path = record.filter if record.truth is None else record.truth.poses
        label = "path of the filter" if record.truth is None else "true path"
        _draw_path(ax, path, plane, label=label, color="#e4e4e4", linewidth=5.0, zorder=0)
        _draw_belief(ax, moment, plane, float(np.linalg.norm(size)))
        if column:
            ax.tick_params(labelleft=False)
        else:
            ax.set_ylabel(f"{_AXES[plane[1]]} [m]")
    handles, labels = axes[1, 0].get_legend_handles_labels()
    columns = {"ncols": len(labels) if one_line else 2, "frameon": False, "markerscale": 1.6, "columnspacing": 1.6}
    figure.legend(handles, labels, loc="outside lower center", **columns)
    figure.suptitle(title, x=0.01, ha="left", fontsize=12, fontweight="bold", color=_INK)
    return figure


def _draw_belief(ax: Axes, moment: Moment, plane: tuple[int, int], scale_m: float) -> None:
    """Particles in the colour of the best hypothesis or of the others; the truth as a ring that looks somewhere."""
    modes = np.stack([mode.world_from_camera.translation for mode in moment.modes])
    points = moment.cloud.translation
    distance = np.linalg.norm(points[:, None] - modes, axis=-1)
    reach = max(0.5, 3.0 * float(np.sqrt(np.trace(moment.modes[0].covariance[:3, :3]))))
    best = (distance.argmin(axis=1) == 0) & (distance[:, 0] <= reach)
    for inside, color, label in (
        (~best, COLORS["other"], "particles of other hypotheses"),
        (best, COLORS["filter"], "particles of the best hypothesis"),
    ):
        style = {"s": 10.0, "linewidths": 0.0, "alpha": 0.5, "zorder": 2, "label": label}
        ax.scatter(points[inside, plane[0]], points[inside, plane[1]], color=color, **style)
    if moment.world_from_camera is not None:
        at = moment.world_from_camera.translation[list(plane)]
        ahead = moment.world_from_camera.rotation[list(plane), 2] * 0.07 * scale_m
        ax.plot(*np.stack([at, at + ahead]).T, color=COLORS["truth"], linewidth=1.6, zorder=4)
        ring = {"markersize": 9.0, "markerfacecolor": "none", "markeredgewidth": 1.6, "linestyle": "none"}
        ax.plot(*at, marker="o", color=COLORS["truth"], label="truth, and where it looks", zorder=4, **ring)


# --- shared ------------------------------------------------------------------------------------------


def _extent(record: RunRecord) -> tuple[Float64[np.ndarray, "3"], Float64[np.ndarray, "3"]]:
    """Corners of the box to show: the true path, where hypotheses are, drifting methods as far as they stay near."""
    held = [moment.cloud for moment in record.moments] + [record.single_image, record.filter]
    ranges = np.array([np.percentile(poses.translation, [1, 99], axis=0) for poses in held])
    low, high = ranges[:, 0].min(axis=0), ranges[:, 1].max(axis=0)
    if record.truth is not None:
        path = record.truth.poses.translation
        low, high = np.minimum(low, path.min(axis=0)), np.maximum(high, path.max(axis=0))
    margin = 0.2 * float((high - low).max())
    ranges = np.array([np.percentile(path.poses.translation, [1, 99], axis=0) for path in record.methods.values()])
    low = np.minimum(low, np.maximum(ranges[:, 0].min(axis=0), low - margin))
    high = np.maximum(high, np.minimum(ranges[:, 1].max(axis=0), high + margin))
    pad = 0.03 * float((high - low).max()) + 0.1
    low, high = low - pad, high + pad
    widen = np.maximum(_THINNEST * (high - low).max() - (high - low), 0.0) / 2
    return low - widen, high + widen


def _planes(low: Float64[np.ndarray, "3"], high: Float64[np.ndarray, "3"]) -> list[tuple[int, int]]:
    """The planes worth looking at: from above, and from the side if the scene has height; the most telling last."""
    size = high - low
    side = (int(np.argmax(size[:2])), 2)
    if size[2] < 0.25 * size.max():
        return [(0, 1)]
    if size[:2].min() <= 1.01 * _THINNEST * size.max():
        return [side]
    return [(0, 1), side]


def new_figure(width: float, height: float) -> Figure:
    """An empty figure of so many inches, drawn without a window."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), dpi=120, layout="constrained", facecolor="white")
    FigureCanvasAgg(figure)
    return figure


def _prepare_plane(ax: Axes, plane: tuple[int, int], low: np.ndarray, high: np.ndarray) -> None:
    ax.set_aspect("equal")
    ax.set_xlim(low[plane[0]], high[plane[0]])
    ax.set_ylim(low[plane[1]], high[plane[1]])
    ax.set_xlabel(f"{_AXES[plane[0]]} [m]")
    _quiet(ax)


def _quiet(ax: Axes) -> None:
    ax.spines[["top", "right"]].set_visible(False)
    ax.spines[["left", "bottom"]].set_color(_FAINT)
    ax.tick_params(colors=_INK, labelsize=9, color=_FAINT)
    ax.xaxis.label.set_color(_INK)
    ax.yaxis.label.set_color(_INK)


def save_figure(figure: Figure, path: Path) -> Path:
    """Write a PNG, the same bytes for the same figure; it appears under its name only when complete."""
    with atomic_output(path) as partial:
        figure.savefig(partial, format="png", metadata={"Software": _SOFTWARE})
    return path


def is_picture(path: Path) -> bool:
    """Whether a file is a PNG that `save_figure` wrote."""
    with path.open("rb") as file:
        return b"tEXtSoftware\0" + _SOFTWARE.encode() in file.read(1000)
