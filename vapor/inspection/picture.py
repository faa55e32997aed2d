"""The map of recordings from above, a panel a storey: passes near each place, and their directions."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from vapor.inspection.coverage import SECTORS, Coverage, height, in_axes
from vapor.reporting.drawing import new_figure, save_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_SEEN = ("#d55e00", "#f0b66b", "#9ecae1", "#4292c6", "#08519c")  # by one pass, two, ... five and more
_PANEL, _LARGEST, _WIDEST = 4.6, 9.0, 16.0  # inches
_MOST_STOREYS = 12


def draw_map(path: Path, coverage: Coverage) -> Path:
    """Draw the map as PNG. The picture appears under its name only when complete."""
    storeys = coverage.storeys()
    count = min(max(len(storeys), 1), _MOST_STOREYS)
    low, high = coverage.places[:, :2].min(axis=0), coverage.places[:, :2].max(axis=0)
    pad = coverage.cell_m
    size = high - low + 2 * pad
    width = float(np.clip(_PANEL * np.sqrt(size[0] / size[1]), 2.4, _LARGEST))
    tall = float(np.clip(width * size[1] / size[0], 2.0, _LARGEST))
    columns = min(count, max(int(_WIDEST / (width + 0.5)), 1))
    lines = -(-count // columns)
    figure = new_figure(max(columns * (width + 0.5) + 0.8, 7.5), lines * (tall + 0.7) + 1.2)
    axes = figure.subplots(lines, columns, squeeze=False)
    for ax in axes.flat:
        ax.set_axis_off()
    for storey in range(count):
        ax = axes[storey // columns, storey % columns]
        _draw_passes(ax, coverage, storey)
        ax.set_axis_on()
        ax.set_aspect("equal")
        ax.set(xlim=(low[0] - pad, high[0] + pad), ylim=(low[1] - pad, high[1] + pad))
        ax.set_xlabel(f"{in_axes(coverage.axes[0]).removeprefix('+')} [m]", fontsize=8)
        ax.set_ylabel(f"{in_axes(coverage.axes[1]).removeprefix('+')} [m]", fontsize=8)
        ax.tick_params(labelsize=7)
        ax.ticklabel_format(useOffset=False, style="plain")
        ax.spines[["top", "right"]].set_visible(False)
        if storeys:
            ax.set_title(f"storey {storey + 1} ({height(storeys[storey].low_m, storeys[storey].high_m)})", fontsize=9)
    _legend(figure)
    names = coverage.images.names
    count = len(np.unique(coverage.images.walk))
    cameras = f" by {len(names) // count} cameras" if len(names) > count else ""
    what = names[0] if len(names) == 1 else f"{count} recording{'s' if count > 1 else ''}{cameras}"
    title = f"{what}: passes near each place, and which way they looked"
    figure.suptitle(title, x=0.01, ha="left", fontsize=11, fontweight="bold")
    return save_figure(figure, path)


def _draw_passes(ax: Axes, coverage: Coverage, storey: int) -> None:
    """Cells by the number of passes; in each a mark for every direction, dark where two passes or more looked so."""
    from matplotlib.collections import LineCollection, PatchCollection
    from matplotlib.patches import Rectangle

    side, origin = coverage.cell_m, coverage.places[:, :2].min(axis=0)
    cells, colors, marks, inks, steep = [], [], [], [], []
    for cell in coverage.passes:
        if cell.storey != storey:
            continue
        corner = origin + side * np.array([cell.column, cell.row])
        cells.append(Rectangle((float(corner[0]), float(corner[1])), side, side))
        colors.append(_SEEN[min(cell.passes, len(_SEEN)) - 1])
        middle = corner + side / 2
        for sector, count in cell.looked.items():
            if sector >= SECTORS:
                steep.append(middle)
                continue
            turn = sector * 2 * np.pi / SECTORS
            ahead = np.array([np.cos(turn), np.sin(turn)])
            marks.append([middle + 0.12 * side * ahead, middle + 0.46 * side * ahead])
            inks.append("#000000" if count > 1 else "#ffffff")
    ax.add_collection(PatchCollection(cells, facecolors=colors, edgecolors="none"))
    ax.add_collection(LineCollection(marks, colors=inks, linewidths=0.9))
    middles = np.array([cell.get_center() for cell in cells]).reshape(-1, 2)
    ax.plot(*middles.T, ".", color="#000000", markersize=1.2)
    if steep:
        ax.plot(*np.array(steep).T, ".", color="#000000", markersize=4)


def _legend(figure: Figure) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    labels = ("1 pass", "2", "3", "4", "5 and more passes")
    handles: list[Patch | Line2D] = [
        Patch(color=color, label=label) for color, label in zip(_SEEN, labels, strict=True)
    ]
    handles.append(Line2D([], [], color="#000000", label="several passes look this way"))
    handles.append(Line2D([], [], color="#ffffff", label="one pass only does"))
    legend = figure.legend(handles=handles, loc="outside lower center", ncols=4, fontsize=8, frameon=True)
    legend.get_frame().set(facecolor="#d8d8d8", edgecolor="none")
