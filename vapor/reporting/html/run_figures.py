"""Figures of a run: in space, and over time."""

from __future__ import annotations

from html import escape
from typing import Any

import numpy as np

from filtering.estimate import STATUSES
from sequences.frame import Trajectory
from vapor.evaluation.trajectory import RIGHT, THRESHOLDS, associate, pose_errors
from vapor.reporting.drawing import COLORS, as_jpeg, jumps, rgb
from vapor.reporting.html.page import Block, data_url, plot
from vapor.reporting.record import Keyframe, RunRecord, choose_keyframes
from vapor.reporting.rerun_shapes import frusta
from vapor.tracking.methods import METHODS

_MOST_POINTS, _MOST_TIMES = 1500, 3000  # of a path, and of a curve over time
_LEAST = 1e-3  # of an error that is drawn: dead reckoning begins on the truth
_MOST_IMAGES = 12
_THINNEST = 0.2  # of the longest axis of the box
_CAMERA_OF_EXTENT = 0.03  # the size of a drawn camera


def run_scene(record: RunRecord) -> Block:
    """A run in space, to be turned and played: paths, particles, modes and cameras."""
    last = len(record.moments) - 1
    first = min(int(0.15 * last), last)
    keyframes = [each for each in choose_keyframes(list(record.keyframes), _MOST_IMAGES) if each.thumbnail.size]
    buttons = "".join(_moment_button(each, record) for each in keyframes)
    seen = '<figure class="seen"><img alt="What the camera saw"><figcaption></figcaption></figure>'
    strip = f'<div class="moments" aria-label="Images" role="group">{buttons}</div>' if keyframes else ""
    shown = (
        '<figure data-figure="run" aria-label="Paths, particles and modes in space">'
        f'<div class="beside"><div class="plot space"></div>{seen if keyframes else ""}</div>'
        '<div class="player"><button type="button" class="play">▶ Play</button>'
        f'<input type="range" min="0" max="{last}" value="{first}" aria-label="Moment of the run"><output></output>'
        f"</div>{strip}<figcaption>Drag to turn, scroll or pinch to zoom; a click in the legend shows or hides. "
        "Particles have the colour of the mode that they are nearest to: blue where it holds the whole belief, "
        "orange where it holds little of it.</figcaption></figure>"
    )
    return Block(shown, {"run": _data(record)})


def _moment_button(keyframe: Keyframe, record: RunRecord) -> str:
    seconds = (keyframe.time_ns - int(record.times_ns[0])) / 1e9
    moments_ns = np.array([record.times_ns[moment.index] for moment in record.moments])
    moment = int(np.abs(moments_ns - keyframe.time_ns).argmin())
    words = f"{seconds:.1f} s · {keyframe.status}"
    return (
        f'<button type="button" data-moment="{moment}" aria-pressed="false">'
        f'<img alt="" src="{data_url(as_jpeg(keyframe.thumbnail, 80))}">{escape(words)}</button>'
    )


def _data(record: RunRecord) -> dict[str, Any]:
    start_ns = int(record.times_ns[0])
    filtered = record.methods["filter"].poses
    low, high = _extent(record)
    size_m = float(_CAMERA_OF_EXTENT * (high - low).max())
    lines = frusta(filtered, size_m)
    truth_lines = np.zeros((len(record.times_ns), 0, 3), np.float32)
    found = np.zeros(len(record.times_ns), bool)
    if record.truth is not None:
        found, poses = associate(record.times_ns, record.truth)
        truth_lines = frusta(poses, size_m)
    position_of_truth = np.cumsum(found) - 1
    moments = []
    for moment in record.moments:
        nearest = np.linalg.norm(moment.particles[:, None] - moment.modes, axis=-1).argmin(axis=1)
        shown = {
            "time_s": round((int(record.times_ns[moment.index]) - start_ns) / 1e9, 3),
            "status": record.status[moment.index],
            "particles": _millimetres(moment.particles),
            "of": nearest.tolist(),
            "modes": _millimetres(moment.modes),
            "weights": moment.weights.round(4).tolist(),
            "camera": _millimetres(lines[moment.index]),
        }
        if moment.jpeg:
            shown["image"] = data_url(moment.jpeg)
        if found[moment.index]:
            shown["truth"] = _millimetres(truth_lines[position_of_truth[moment.index]])
        moments.append(shown)
    paths = [
        _path(METHODS[name].label, METHODS[name].color, trajectory, visible=name in ("filter", "smoothed"))
        for name, trajectory in record.methods.items()
        if METHODS[name].kind != "image"
    ]
    single = record.methods["single_image"].poses.translation
    single = single[_evenly(len(single))].round(3)
    paths.append(
        {
            "type": "scatter3d",
            "mode": "markers",
            "name": METHODS["single_image"].label,
            **{axis: single[:, number].tolist() for number, axis in enumerate("xyz")},
            "marker": {"size": 2, "color": METHODS["single_image"].color},
            "hoverinfo": "name",
            "visible": "legendonly",
        }
    )
    if record.truth is not None:
        paths.append(_path("truth", "ink", record.truth, visible=True))
    ratio = (high - low) / (high - low).max()
    return {
        "moments": moments,
        "paths": paths,
        "none": rgb(COLORS["other"]),
        "all": rgb(COLORS["filter"]),
        "ranges": np.stack([low, high]).T.round(3).tolist(),
        "ratio": dict(zip("xyz", ratio.round(3).tolist(), strict=True)),
    }


def _extent(record: RunRecord) -> tuple[np.ndarray, np.ndarray]:
    """Corners of the box that holds the paths of filter and truth and nearly all particles; never flat."""
    points = [record.methods["filter"].poses.translation]
    points += [np.percentile(np.concatenate([each.particles for each in record.moments]), [0.5, 99.5], axis=0)]
    if record.truth is not None:
        points.append(record.truth.poses.translation)
    low, high = np.concatenate(points).min(axis=0), np.concatenate(points).max(axis=0)
    size = max(float((high - low).max()), 0.1)
    widen = np.maximum(_THINNEST * size - (high - low), 0.05 * size) / 2
    return low - widen, high + widen


def _path(name: str, color: str, trajectory: Trajectory, *, visible: bool) -> dict[str, Any]:
    """A line that is broken where a hypothesis jumped instead of moving."""
    points = trajectory.poses.translation
    jumped = jumps(points)
    kept = np.unique(np.concatenate([_evenly(len(points)), jumped, np.maximum(jumped - 1, 0)]))
    broken = np.isin(kept, jumped)
    drawn = np.insert(points[kept].round(3), np.flatnonzero(broken), np.nan, axis=0)
    x, y, z = np.where(np.isnan(drawn), np.array(None), drawn).T.tolist()
    return {
        "type": "scatter3d",
        "mode": "lines",
        "name": name,
        "x": x,
        "y": y,
        "z": z,
        "line": {"width": 3, "color": color},
        "hoverinfo": "name",
        "visible": True if visible else "legendonly",
    }


def _evenly(count: int, most: int = _MOST_POINTS) -> np.ndarray:
    return np.linspace(0, count - 1, min(count, most)).round().astype(int)


def _millimetres(points: np.ndarray) -> list[list[int]]:
    return np.round(1000.0 * points).astype(int).T.tolist()


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


def error_plot(record: RunRecord) -> Block | None:
    """Errors of position and rotation over time; None without any true pose."""
    if record.truth is None:
        return None
    traces: list[dict[str, Any]] = []
    start_ns = int(record.times_ns[0])
    for name, trajectory in record.methods.items():
        method = METHODS[name]
        times_ns, *errors = pose_errors(trajectory, record.truth)
        some = _evenly(len(times_ns), _MOST_TIMES)
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
        **_layout(record),
        "hovermode": "closest",
        "shapes": lines,
        "yaxis": {"title": {"text": "position [m]"}, "type": "log", "domain": [0.54, 1.0], "minor": {"nticks": 0}},
        "yaxis2": {"title": {"text": "rotation [°]"}, "type": "log", "domain": [0.0, 0.46]},
    }
    return plot(
        "errors",
        traces,
        layout,
        "Errors of position and rotation over time",
        f"Dashed: within {limits[0]:g} m and {limits[1]:g}° a pose counts as right.",
    )


def belief_plot(record: RunRecord) -> Block:
    """How sure the filter was, over time: weight of the best mode, mass at none of the modes, agreement of the images,
    deviation."""
    some = _evenly(len(record.times_ns), _MOST_TIMES)
    seconds = ((record.times_ns[some] - record.times_ns[0]) / 1e9).round(3).tolist()
    position_m = np.sqrt(np.linalg.eigvalsh(record.covariance[some, :3, :3])[:, -1])
    curves = (
        ("weight of the best mode", record.best_weight[some], COLORS["filter"], "y"),
        ("at none of the modes", record.unassigned[some], "#cc79a7", "y"),
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
        **_layout(record),
        "yaxis": {"title": {"text": "fraction"}, "range": [0, 1.05], "domain": [0.54, 1.0]},
        "yaxis2": {"title": {"text": "deviation [m]"}, "type": "log", "domain": [0.0, 0.46]},
    }
    return plot("belief", traces, layout, "How sure the filter was, over time")


def _layout(record: RunRecord) -> dict[str, Any]:
    duration_s = max(float(record.times_ns[-1] - record.times_ns[0]) / 1e9, 1e-3)
    return {
        "margin": {"l": 65, "r": 10, "t": 10, "b": 40},
        "legend": {"orientation": "h", "y": 1.02, "yanchor": "bottom", "x": 0},
        "xaxis": {"title": {"text": "time [s]"}, "anchor": "y2", "range": [0, duration_s]},
    }
