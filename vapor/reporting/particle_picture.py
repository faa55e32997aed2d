"""The picture of a run's particles at a few keyframes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from vapor.reporting.colors import COLORS, INK
from vapor.reporting.drawing import add_title, new_figure
from vapor.reporting.keyframes import Keyframe, choose_keyframes
from vapor.reporting.planes import AXES, choose_planes, draw_path, extent_of, prepare_plane
from vapor.reporting.record import RunRecord

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def particle_figure(record: RunRecord, title: str) -> Figure:
    """Draw image and particles at five keyframes at most."""
    keyframes = choose_keyframes(list(record.keyframes), 5)
    low, high = extent_of(record)
    plane = choose_planes(low, high)[-1]
    size = (high - low)[list(plane)]
    panel_width = 2.35
    panel_height = float(np.clip(panel_width * size[1] / size[0], 1.6, 6.0))
    pixels_high, pixels_wide = keyframes[0].thumbnail.shape[:2]
    image_height = panel_width * min(pixels_high / pixels_wide, 1.0) if pixels_high else 0.05
    width = max(panel_width * len(keyframes) + 0.8, 6.0)
    one_line = width > 9.0
    figure = new_figure(width, image_height + panel_height + (1.4 if one_line else 1.7))
    axes = figure.subplots(
        2, len(keyframes), squeeze=False, gridspec_kw={"height_ratios": [image_height, panel_height]}
    )
    for column, keyframe in enumerate(keyframes):
        if keyframe.thumbnail.size:
            axes[0, column].imshow(keyframe.thumbnail)
        axes[0, column].set_axis_off()
        count = len(keyframe.modes)
        hypotheses = "1 hypothesis" if count == 1 else f"{count} hypotheses"
        seconds = (keyframe.time_ns - int(record.times_ns[0])) / 1e9
        axes[0, column].set_title(f"{seconds:.1f} s · {hypotheses}", fontsize=10, color=INK)
        ax = axes[1, column]
        prepare_plane(ax, plane, low, high)
        path = record.methods["filter"].poses if record.truth is None else record.truth.poses
        label = "path of the filter" if record.truth is None else "true path"
        draw_path(ax, path, plane, label=label, color="#e4e4e4", linewidth=5.0, zorder=0)
        _draw_belief(ax, keyframe, plane, float(np.linalg.norm(size)))
        if column:
            ax.tick_params(labelleft=False)
        else:
            ax.set_ylabel(f"{AXES[plane[1]]} [m]")
    handles, labels = axes[1, 0].get_legend_handles_labels()
    columns = {"ncols": len(labels) if one_line else 2, "frameon": False, "markerscale": 1.6, "columnspacing": 1.6}
    figure.legend(handles, labels, loc="outside lower center", **columns)
    add_title(figure, title)
    return figure


def _draw_belief(ax: Axes, keyframe: Keyframe, plane: tuple[int, int], scale_m: float) -> None:
    """Particles in the colour of the best hypothesis or of the others; the truth as a ring that looks somewhere."""
    modes = np.stack([mode.world_from_camera.translation for mode in keyframe.modes])
    points = keyframe.cloud.translation
    distance = np.linalg.norm(points[:, None] - modes, axis=-1)
    reach = max(0.5, 3.0 * float(np.sqrt(np.trace(keyframe.modes[0].covariance[:3, :3]))))
    best = (distance.argmin(axis=1) == 0) & (distance[:, 0] <= reach)
    for inside, color, label in (
        (~best, COLORS["other"], "particles of other hypotheses"),
        (best, COLORS["filter"], "particles of the best hypothesis"),
    ):
        style = {"s": 10.0, "linewidths": 0.0, "alpha": 0.5, "zorder": 2, "label": label}
        ax.scatter(points[inside, plane[0]], points[inside, plane[1]], color=color, **style)
    if keyframe.world_from_camera is not None:
        at = keyframe.world_from_camera.translation[list(plane)]
        ahead = keyframe.world_from_camera.rotation[list(plane), 2] * 0.07 * scale_m
        ax.plot(*np.stack([at, at + ahead]).T, color=COLORS["truth"], linewidth=1.6, zorder=4)
        ring = {"markersize": 9.0, "markerfacecolor": "none", "markeredgewidth": 1.6, "linestyle": "none"}
        ax.plot(*at, marker="o", color=COLORS["truth"], label="truth, and where it looks", zorder=4, **ring)
