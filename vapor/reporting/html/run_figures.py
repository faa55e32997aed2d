"""Figures of a run: in space, and over time."""

from __future__ import annotations

from html import escape
from itertools import repeat
from typing import Any

import numpy as np

from filtering.storeys import up_axis
from sequences.frame import Trajectory
from vapor.evaluation.trajectory import RIGHT, THRESHOLDS, associate, pose_errors
from vapor.reporting.drawing import COLORS, as_jpeg, rgb
from vapor.reporting.html.drawings import ThinnedPath, evenly
from vapor.reporting.html.page import Block, data_url, plot
from vapor.reporting.record import Keyframe, Moment, RunRecord, choose_keyframes
from vapor.reporting.rerun_shapes import frusta
from vapor.tracking.methods import METHODS

_MOST_TIMES, _MOST_DOTS = 1500, 750  # of a curve over time, a thousand pixels wide, and of one without lines
_LEAST = 1e-3  # of an error that is drawn: dead reckoning begins on the truth
_LOG = {"type": "log", "tickformat": "~g", "nticks": 4}  # whole numbers at every tick, not the last digit alone
_MOST_IMAGES = 12
_FIRST = 0.15  # of the run: near there is the picture that a page shows first
_THINNEST = 0.1  # of the longest axis of the box
_TALL = 0.8  # height of a box over the diagonal of its plan, from which on its view is higher than wide
_CAMERA_OF_EXTENT = 0.03  # the size of a drawn camera


def run_scene(record: RunRecord) -> Block:
    """A run in space, to be turned and played: paths, particles, modes and cameras."""
    last = len(record.moments) - 1
    keyframes = [each for each in choose_keyframes(list(record.keyframes), _MOST_IMAGES) if each.thumbnail.size]
    of_keyframes = [_moment_of(each, record) for each in keyframes]
    first = min(of_keyframes, default=0, key=lambda moment: abs(moment - _FIRST * last))
    buttons = "".join(map(_moment_button, keyframes, of_keyframes, repeat(int(record.times_ns[0]))))
    seen = '<figure class="seen"><img alt="What the camera saw"><figcaption></figcaption></figure>'
    strip = f'<div class="moments" aria-label="Images" role="group">{buttons}</div>' if keyframes else ""
    data = _data(record)
    across, high = (np.linalg.norm(np.array([*data["ratio"].values()]) * part) for part in _level_and_up(data["up"]))
    shown = (
        '<figure data-figure="run" aria-label="Paths, particles and modes in space">'
        f'<div class="run{" tall" if high > _TALL * across else ""}"><div class="plot space"></div>'
        '<div class="player"><button type="button" class="play">▶ Play</button>'
        f'<input type="range" min="0" max="{last}" value="{first}" aria-label="Moment of the run"><output></output>'
        f"</div>{seen if keyframes else ''}{strip}</div>"
        "<figcaption>Drag to turn, scroll or pinch to zoom; a click in the legend shows or hides. "
        "Particles have the colour of the mode that they are nearest to: blue where it holds the whole belief, "
        "orange where it holds little of it. The best mode is the one that is reported: it stays the best until "
        "another is clearly heavier.</figcaption></figure>"
    )
    return Block(shown, {"run": data})


def _level_and_up(up: list[float]) -> tuple[np.ndarray, np.ndarray]:
    """Which axes are level, and which one is up, as 0 or 1 of each."""
    return 1.0 - np.abs(up), np.abs(up)


def _moment_of(keyframe: Keyframe, record: RunRecord) -> int:
    """The number of the moment that is nearest to a keyframe."""
    moments_ns = np.array([record.times_ns[moment.index] for moment in record.moments])
    return int(np.abs(moments_ns - keyframe.time_ns).argmin())


def _moment_button(keyframe: Keyframe, moment: int, start_ns: int) -> str:
    seconds = (keyframe.time_ns - start_ns) / 1e9
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
            "belief": _belief(moment),
            "camera": _millimetres(lines[moment.index]),
        }
        if record.inliers is not None:
            shown["inliers"] = int(record.inliers[moment.index])
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
    single = single[evenly(len(single))].round(3)
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
        "up": (up_axis(filtered) if record.storeys is None else np.array(record.storeys.up)).tolist(),
    }


def _belief(moment: Moment) -> str:
    """The modes in words; the heaviest, too, where that is not the best one."""
    if len(moment.weights) == 1:
        return "1 mode"
    best, heaviest = (round(100.0 * float(weight)) for weight in (moment.weights[0], moment.weights.max()))
    words = f"{len(moment.weights)} modes, best {best} %"
    return words if heaviest == best else f"{words}, heaviest {heaviest} %"


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
    thin = ThinnedPath.of(points)
    drawn = np.insert(points[thin.kept].round(3), np.flatnonzero(thin.broken), np.nan, axis=0)
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


def _millimetres(points: np.ndarray) -> list[list[int]]:
    return np.round(1000.0 * points).astype(int).T.tolist()


def error_plot(record: RunRecord) -> Block | None:
    """Errors of position and rotation over time; None without any true pose."""
    if record.truth is None:
        return None
    traces: list[dict[str, Any]] = []
    start_ns = int(record.times_ns[0])
    for name, trajectory in record.methods.items():
        method = METHODS[name]
        times_ns, *errors = pose_errors(trajectory, record.truth)
        some = evenly(len(times_ns), _MOST_DOTS if method.kind == "image" else _MOST_TIMES)
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
    axes = {
        "yaxis": {"title": {"text": "position [m]"}, **_LOG, "domain": [0.54, 1.0]},
        "yaxis2": {"title": {"text": "rotation [°]"}, **_LOG, "domain": [0.0, 0.46]},
    }
    layout = {**_layout(record, axes), "hovermode": "closest", "shapes": lines}
    return plot(
        "errors",
        traces,
        layout,
        "Errors of position and rotation over time",
        f"Dashed: within {limits[0]:g} m and {limits[1]:g}° a pose counts as right.",
    )


def belief_plot(record: RunRecord) -> Block:
    """How sure the filter was, over time: weight of the best mode, mass at none of the modes, agreement of the images,
    deviation, and landmarks that agree."""
    some = evenly(len(record.times_ns), _MOST_TIMES)
    seconds = ((record.times_ns[some] - record.times_ns[0]) / 1e9).round(3).tolist()
    position_m = np.sqrt(np.linalg.eigvalsh(record.covariance[some, :3, :3])[:, -1])
    curves = [
        ("weight of the best mode", record.best_weight[some], COLORS["filter"], "y"),
        ("at none of the modes", record.unassigned[some], "#cc79a7", "y"),
        ("agreement of the images", record.agreement[some], "#009e73", "y"),
        ("standard deviation of the best mode", np.maximum(position_m, _LEAST), "ink", "y2"),
    ]
    fractions = {"title": {"text": "fraction"}, "range": [0, 1.05], "domain": [0.54, 1.0]}
    deviation = {"title": {"text": "deviation [m]"}, **_LOG, "domain": [0.0, 0.46]}
    axes = {"yaxis": fractions, "yaxis2": deviation}
    if record.inliers is not None:
        curves.append(("landmarks that agree", record.inliers[some], "#d55e00", "y3"))
        fractions["domain"], deviation["domain"] = [0.7, 1.0], [0.37, 0.63]
        axes["yaxis3"] = {"title": {"text": "landmarks"}, "rangemode": "tozero", "domain": [0.0, 0.3]}
    traces = [
        {
            "type": "scatter",
            "mode": "lines",
            "name": name,
            "x": seconds,
            "y": values.round(4).tolist(),
            "yaxis": axis,
            "line": {"width": 1.6, "color": color},
        }
        for name, values, color, axis in curves
    ]
    return plot("belief", traces, _layout(record, axes), "How sure the filter was, over time")


def _layout(record: RunRecord, axes: dict[str, Any]) -> dict[str, Any]:
    duration_s = max(float(record.times_ns[-1] - record.times_ns[0]) / 1e9, 1e-3)
    return {
        "margin": {"l": 65, "r": 10, "t": 10, "b": 40},
        "legend": {"orientation": "h", "y": 1.02, "yanchor": "bottom", "x": 0},
        "xaxis": {"title": {"text": "time [s]"}, "anchor": f"y{len(axes)}", "range": [0, duration_s]},
        **axes,
    }
