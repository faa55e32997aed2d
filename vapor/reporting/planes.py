"""The planes in which a run is drawn: which ones, how far they reach, and paths in them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float64

from filtering.se3 import Poses
from vapor.reporting.drawing import quiet_axes
from vapor.reporting.jumps import jumps
from vapor.reporting.record import RunRecord

if TYPE_CHECKING:
    from matplotlib.axes import Axes

AXES = ("x", "y", "z")
"""Names of the axes, by number."""

_THINNEST = 0.12  # of the longest axis: thinner, and the labels would not fit


def extent_of(record: RunRecord) -> tuple[Float64[np.ndarray, "3"], Float64[np.ndarray, "3"]]:
    """Corners of the box to show: the true path, where hypotheses are, drifting methods as far as they stay near."""
    held = [keyframe.cloud for keyframe in record.keyframes]
    held += [record.methods[name].poses for name in ("single_image", "filter")]
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


def choose_planes(low: Float64[np.ndarray, "3"], high: Float64[np.ndarray, "3"]) -> list[tuple[int, int]]:
    """The planes worth looking at: from above, and from the side if the scene has height; the most informative last."""
    size = high - low
    side = (int(np.argmax(size[:2])), 2)
    if size[2] < 0.25 * size.max():
        return [(0, 1)]
    if size[:2].min() <= 1.01 * _THINNEST * size.max():
        return [side]
    return [(0, 1), side]


def prepare_plane(ax: Axes, plane: tuple[int, int], low: np.ndarray, high: np.ndarray) -> None:
    """Make axes show a plane from one corner of a box to the other, metres."""
    ax.set_aspect("equal")
    ax.set_xlim(low[plane[0]], high[plane[0]])
    ax.set_ylim(low[plane[1]], high[plane[1]])
    ax.set_xlabel(f"{AXES[plane[0]]} [m]")
    quiet_axes(ax)


def draw_path(ax: Axes, poses: Poses, plane: tuple[int, int], **style: object) -> None:
    """A line through the positions that is broken where a hypothesis jumped instead of moving."""
    points = np.insert(poses.translation, jumps(poses.translation), np.nan, axis=0)
    ax.plot(points[:, plane[0]], points[:, plane[1]], solid_capstyle="round", **style)  # pyright: ignore[reportArgumentType]
