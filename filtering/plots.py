"""Modes, particles and places from above, by Matplotlib, which is imported when something is drawn."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Float64

from filtering.errors import VaporTrackError, few, quoted
from filtering.se3 import Poses
from filtering.storeys import up_axis

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from filtering.estimate import Mode

BEST, OTHER, TRUTH, POINTS = "#0072b2", "#d55e00", "#222222", "#8a8a8a"
"""Colours of the best mode, of other ones, of the truth, and of samples and particles."""
_OUTLINE = np.stack([np.cos(np.linspace(0, 2 * np.pi, 73)), np.sin(np.linspace(0, 2 * np.pi, 73))])
_LABELLED = 0.02  # of the belief: lighter modes have no number
_WRITTEN = 3  # weights of modes above each other
_ARROW_INCHES = 0.25
_MARGIN = 0.08  # of the extent of what is drawn


class Plan:
    """Axes in which two coordinates of the world are drawn, in metres, at one scale.

    Attributes:
        axes: Matplotlib's.
        plane: Numbers of the two coordinates.
    """

    def __init__(self, axes: Axes | None, plane: str | None, poses: Poses) -> None:
        """Prepare axes, or a new figure for None.

        Args:
            axes: To draw in.
            plane: Two of x, y and z; None for the two that are horizontal, by the cameras.
            poses: Of cameras, batch (n,), that say what is horizontal.

        Raises:
            VaporTrackError: the plane is none.
        """
        self.plane = _numbers_of(plane) if plane is not None else level_axes(poses)
        self._is_new = axes is None
        if axes is None:
            from matplotlib import pyplot

            axes = pyplot.subplots(figsize=(6.0, 5.0), layout="constrained")[1]
        self.axes = axes
        shared = (axes.get_shared_x_axes(), axes.get_shared_y_axes())
        alone = all(len(group.get_siblings(axes)) == 1 for group in shared)
        axes.set_aspect("equal", adjustable="datalim" if alone else "box")
        axes.set(xlabel=f"{'xyz'[self.plane[0]]} [m]", ylabel=f"{'xyz'[self.plane[1]]} [m]")

    def points(self, poses: Poses, label: str, *, size: float = 6.0) -> None:
        """Draw poses (n,) as small points."""
        x, y = poses.translation[:, self.plane].T
        self.axes.scatter(x, y, s=size, color=POINTS, alpha=0.5, linewidths=0, label=label, zorder=2)

    def modes(self, modes: Sequence[Mode], probability: float, label: str) -> None:
        """Draw modes, the best one first: region, direction of view, and weight.

        Raises:
            VaporTrackError: the probability is not between 0 and 1.
        """
        labels: list[_Label] = []
        for number, mode in enumerate(modes):
            is_best = number == 0
            color, above = (BEST, 0.1) if is_best else (OTHER, 0.0)
            x, y = outline = self._region(mode, probability)
            self.axes.fill(x, y, color=color, alpha=0.05 + 0.25 * min(mode.weight, 1.0), linewidth=0, zorder=1 + above)
            named = {0: f"best {label}, {100 * probability:g} % region", 1: f"other {label}s"}
            self.axes.plot(x, y, color=color, linewidth=1.2, label=named.get(number), zorder=3 + above)
            self._camera(mode.world_from_camera, color, 4 + above)
            if mode.weight >= _LABELLED:
                top = outline[:, np.argmax(y)]
                labels = _labelled(
                    labels, _Label(top, float(np.ptp(outline, axis=1).max()), [f"{100 * mode.weight:.0f} %"])
                )
        style: dict[str, Any] = {"textcoords": "offset points", "ha": "center", "fontsize": 8}
        for each in labels:
            self.axes.annotate(each.text, tuple(each.top), (0, 2), zorder=6, **style)

    def truth(self, poses: Poses) -> None:
        """Draw a true pose, or a true path (n,)."""
        if poses.batch_shape:
            self.path(poses.translation, TRUTH, "true path", below=True)
            return
        x, y = poses.translation[list(self.plane)]
        self.axes.plot(x, y, "x", color=TRUTH, markersize=8, markeredgewidth=2, label="true pose", zorder=5)
        self._camera(poses, TRUTH, 5.0)

    def path(
        self,
        positions: Float64[np.ndarray, "n 3"],
        color: str,
        label: str,
        *,
        dotted: bool = False,
        below: bool = False,
    ) -> None:
        """Draw positions one after the other, a line that is broken at NaN, or dots; one below others is wider."""
        x, y = positions[:, self.plane].T
        line, marker = ("", ".") if dotted else ("-", "")
        width, zorder = (3.0, 2.5) if below else (1.4, 3.0)
        self.axes.plot(
            x, y, color=color, label=label, zorder=zorder, linestyle=line, marker=marker, markersize=3, linewidth=width
        )

    def finish(self, title: str = "") -> Axes:
        """Add the title where there is none yet, and the legend to a new figure: `axes.legend()` adds it to others."""
        if title and not self.axes.get_title():
            self.axes.set_title(title, fontsize=10)
        low, high = np.asarray(self.axes.dataLim.get_points())
        margin_m = _MARGIN * float((high - low).max()) or 0.5  # for the numbers; and of a single point
        self.axes.update_datalim([low - margin_m, high + margin_m])
        self.axes.autoscale_view()
        if self._is_new:
            self.axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.12), ncols=3, fontsize=8, frameon=False)
        return self.axes

    def _camera(self, pose: Poses, color: str, zorder: float) -> None:
        """A point where a camera is, and an arrow where it looks, shorter the more it looks out of the plane."""
        (x, y), (u, v) = pose.translation[list(self.plane)], pose.rotation[list(self.plane), 2]
        style: dict[str, Any] = {"angles": "xy", "scale_units": "inches", "scale": 1.0 / _ARROW_INCHES}
        self.axes.quiver(x, y, u, v, color=color, zorder=zorder, units="inches", width=0.02, **style)
        self.axes.plot(x, y, ".", color=color, markersize=4, zorder=zorder)

    def _region(self, mode: Mode, probability: float) -> Float64[np.ndarray, "2 73"]:
        """The outline of a mode's region of a probability, of the two coordinates alone."""
        rotation = mode.world_from_camera.rotation[list(self.plane)]
        values, vectors = np.linalg.eigh(rotation @ mode.covariance[:3, :3] @ rotation.T)
        radius = np.sqrt(mode.squared_radius(probability, dimensions=2))
        outline = radius * (vectors * np.sqrt(np.maximum(values, 0.0))) @ _OUTLINE
        return outline + mode.world_from_camera.translation[list(self.plane), None]


class _Label(NamedTuple):
    """Weights of the modes at one place of the plan, to be written above it."""

    top: np.ndarray
    size_m: float
    weights: list[str]

    @property
    def text(self) -> str:
        return " + ".join(few(self.weights, _WRITTEN))


def _labelled(labels: list[_Label], new: _Label) -> list[_Label]:
    """Labels with a new one, in one with those whose modes are in the same place of the plan."""
    for number, label in enumerate(labels):
        size_m = max(label.size_m, new.size_m)
        if np.linalg.norm(label.top - new.top) <= size_m / 2:
            top = max(label.top, new.top, key=lambda top: float(top[1]))
            return [*labels[:number], _Label(top, size_m, label.weights + new.weights), *labels[number + 1 :]]
    return [*labels, new]


def level_axes(poses: Poses) -> tuple[int, int]:
    """Numbers of the two axes of the world that are horizontal, by the cameras (n,); x and y where it is unclear."""
    up = int(np.argmax(np.abs(up_axis(poses)))) if len(poses) else 2
    first, second = (axis for axis in range(3) if axis != up)
    return first, second


def _numbers_of(plane: str) -> tuple[int, int]:
    if len(plane) != 2 or len(set(plane)) != 2 or not set(plane) <= set("xyz"):
        raise VaporTrackError(f"plane is {quoted(plane)}, expected two of x, y and z, such as 'xy'")
    return "xyz".index(plane[0]), "xyz".index(plane[1])
