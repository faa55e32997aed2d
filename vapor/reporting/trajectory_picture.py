"""The picture of a run's paths: the truth, and what each method made of it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from vapor.reporting.colors import COLORS
from vapor.reporting.drawing import add_title, new_figure
from vapor.reporting.planes import AXES, choose_planes, draw_path, extent_of, prepare_plane
from vapor.reporting.record import RunRecord
from vapor.tracking.methods import METHODS

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def trajectory_figure(record: RunRecord, title: str) -> Figure:
    """Draw the paths, from above, and from the side where the scene has height."""
    low, high = extent_of(record)
    planes = choose_planes(low, high)
    sizes = np.array([high[list(plane)] - low[list(plane)] for plane in planes])
    height = 5.6
    widths = np.clip(height * sizes[:, 0] / sizes[:, 1], 2.2, 8.5)
    figure = new_figure(float(widths.sum()) + 1.0 * len(planes) + 1.9, height + 1.0)
    axes = figure.subplots(1, len(planes), squeeze=False, gridspec_kw={"width_ratios": widths})[0]
    for ax, plane in zip(axes, planes, strict=True):
        prepare_plane(ax, plane, low, high)
        ax.set_ylabel(f"{AXES[plane[1]]} [m]")
        if record.truth is not None:
            draw_path(ax, record.truth.poses, plane, color=COLORS["truth"], linewidth=4.5, alpha=0.22, label="truth")
        for name, trajectory in record.methods.items():
            method = METHODS[name]
            if method.kind == "image":
                points = trajectory.poses.translation
                style = {"s": 7.0, "linewidths": 0.0, "alpha": 0.55, "rasterized": True}
                ax.scatter(points[:, plane[0]], points[:, plane[1]], color=method.color, label=method.label, **style)
            else:
                width = 1.8 if method.kind == "ours" else 1.3
                draw_path(ax, trajectory.poses, plane, color=method.color, linewidth=width, label=method.label)
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside right upper", frameon=False, markerscale=1.8)
    add_title(figure, title)
    return figure
