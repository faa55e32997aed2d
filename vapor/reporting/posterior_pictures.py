"""The posterior of one image, as a picture and as a Rerun recording."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float64, UInt8

from filtering.estimate import posterior_modes
from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from sequences.frame import Frame
from vapor.reporting.drawing import COLORS, new_figure, save_figure
from vapor.reporting.rerun_layout import TRUTH, log_legend, log_styles, space_view, with_legend
from vapor.reporting.rerun_place import Place
from vapor.reporting.rerun_recording import recorded
from vapor.reporting.rerun_shapes import HypothesisColors, Photograph, frusta, shown_modes, thinned

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_AXES = ("x, to the right", "y, down", "z, ahead")
_BINS = 80
_ASPECT = 1.05  # of the panel of positions, width over height


def draw_posterior(
    path: Path,
    samples: Poses,
    *,
    image: UInt8[np.ndarray, "h w 3"],
    surroundings: Float64[np.ndarray, "n 3"],
    truth: Poses | None = None,
    title: str,
) -> Path:
    """Draw posterior samples (m,) of one image, and the true pose where known, as a PNG that appears when complete.

    The sphere is the base of the Hopf fibration in Mollweide's projection, the angle about the axis is the colour
    (Murphy et al., "Implicit-PDF: non-parametric representation of probability distributions on the rotation manifold",
    ICML 2021). Positions (metres) of the surroundings outline the scene: posterior samples of training images.
    """
    figure = new_figure(12.0, 5.6)
    left, right = figure.add_gridspec(1, 2, width_ratios=[1.3, 1.0])
    grid = left.subgridspec(2, 3, width_ratios=[1, 0.2, 0.2], height_ratios=[0.2, 1])
    above = figure.add_subplot(grid[1, 0])
    marginals = (
        figure.add_subplot(grid[0, 0], sharex=above),
        figure.add_subplot(grid[1, 1], sharey=above),
        figure.add_subplot(grid[1, 2]),
    )
    _draw_positions(above, marginals, samples, surroundings, truth)
    grid = right.subgridspec(2, 1)
    shown = figure.add_subplot(grid[0])
    shown.imshow(image)
    shown.set_axis_off()
    _draw_orientations(figure.add_subplot(grid[1], projection="mollweide"), samples, truth)
    figure.suptitle(title, x=0.01, ha="left", fontsize=12, fontweight="bold")
    return save_figure(figure, path)


def hopf_coordinates(
    rotation: Float64[np.ndarray, "n 3 3"], axis: int
) -> tuple[Float64[np.ndarray, " n"], Float64[np.ndarray, " n"], Float64[np.ndarray, " n"]]:
    """Direction of an axis of the camera, and the angle about it.

    Args:
        rotation: world_from_camera rotations.
        axis: 0, 1 or 2: x, y or z of the camera.

    Returns:
        Longitude in [−π, π] and latitude in [−π/2, π/2] of the axis in the world, and the angle in [0, 2π) about it
        from the rotation that brings the axis there straight from the pole. At the poles longitude and angle are one.
    """
    points, next_axis = rotation[:, :, axis], rotation[:, :, (axis + 1) % 3]
    longitude, latitude = np.arctan2(points[:, 1], points[:, 0]), np.arcsin(np.clip(points[:, 2], -1.0, 1.0))
    sin, cos = np.sin(longitude), np.cos(longitude)
    north = np.stack([-np.sin(latitude) * cos, -np.sin(latitude) * sin, np.cos(latitude)], axis=1)
    east = np.stack([-sin, cos, np.zeros_like(sin)], axis=1)
    angle = np.arctan2(np.einsum("ni,ni->n", next_axis, north), np.einsum("ni,ni->n", next_axis, east))
    return longitude, latitude, angle % (2 * np.pi)


def level_axis(rotation: Float64[np.ndarray, "n 3 3"]) -> int:
    """The axis of the camera that lies most level: it points to no pole of the sphere."""
    return int(np.argmin(np.square(rotation[:, 2]).mean(axis=0)))


def _draw_positions(
    above: Axes,
    marginals: tuple[Axes, Axes, Axes],
    samples: Poses,
    surroundings: Float64[np.ndarray, "n 3"],
    truth: Poses | None,
) -> None:
    points = samples.translation
    everything = np.concatenate([points, surroundings, *([] if truth is None else [truth.translation[None]])])
    low, high = everything.min(axis=0), everything.max(axis=0)
    pad = 0.04 * float((high - low).max()) + 0.05  # a scene without extent along an axis has a picture, too
    low, high = low - pad, high + pad
    height = max(high[1] - low[1], (high[0] - low[0]) / _ASPECT)
    for axis, size in ((0, _ASPECT * height), (1, height)):
        middle = (low[axis] + high[axis]) / 2
        low[axis], high[axis] = middle - size / 2, middle + size / 2
    above.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), xlabel="x [m]", ylabel="y [m]")
    above.scatter(*surroundings[:, :2].T, s=3, color="#d0d0d0", linewidths=0, label="posteriors of training images")
    above.scatter(*points[:, :2].T, s=6, color=COLORS["filter"], alpha=0.25, linewidths=0, label="posterior samples")
    for axis, ax in enumerate(marginals):
        bins = list(np.linspace(low[axis], high[axis], _BINS))
        orientation = "vertical" if axis == 0 else "horizontal"
        ax.hist(points[:, axis], bins=bins, density=True, color=COLORS["filter"], orientation=orientation)
        for side in ("top", "right"):
            ax.spines[side].set_visible(False)
        if truth is not None:
            (ax.axvline if axis == 0 else ax.axhline)(truth.translation[axis], color=COLORS["other"], linewidth=1.2)
    along_x, along_y, along_z = marginals
    along_x.tick_params(labelbottom=False, labelleft=False)
    along_y.tick_params(labelbottom=False, labelleft=False)
    along_z.tick_params(labelbottom=False)
    along_z.set(ylim=(low[2], high[2]), ylabel="z [m]")
    if truth is not None:
        above.plot(*truth.translation[:2], "x", color=COLORS["other"], markersize=8, markeredgewidth=2, label="truth")
    legend = above.legend(loc="upper left", fontsize=8, frameon=False)
    for handle in filter(None, legend.legend_handles):
        handle.set_alpha(1.0)


def _draw_orientations(ax: Axes, samples: Poses, truth: Poses | None) -> None:
    axis = level_axis(samples.rotation)
    longitude, latitude, angle = hopf_coordinates(samples.rotation, axis)
    style = {"s": 8, "alpha": 0.5, "linewidths": 0, "cmap": "twilight", "vmin": 0.0, "vmax": 360.0}
    drawn = ax.scatter(longitude, latitude, c=np.degrees(angle), **style)
    if truth is not None:
        *where, about = hopf_coordinates(truth.rotation[None], axis)
        ring = {"s": 120, "linewidths": 2, "facecolors": "none", "edgecolors": COLORS["other"]}
        ax.scatter(*where, **ring)
        ax.scatter(*where, c=np.degrees(about), **style | {"alpha": 1.0, "s": 30})
    ax.grid(True, color="#dddddd", linewidth=0.6)
    ax.tick_params(labelsize=7)
    ax.set_title(f"where the camera's {_AXES[axis]}, points", fontsize=9)
    ax.figure.colorbar(drawn, ax=ax, shrink=0.7, label="turned about it [°]", ticks=[0, 90, 180, 270, 360])


_CLOUD_SIZE, _FRUSTA = 2000, 100
_LEGEND = (
    "**orange** samples of the image's posterior  ·  **blue** the place with most of them, **other colours** the"
    " others, each with its fraction of the samples and an ellipsoid of two standard deviations  ·  **white** true pose"
    "  ·  **grey** {what}"
)


def record_posterior(
    path: Path, posterior: PosePosterior, *, frame: Frame, truth: Poses, place: Place, title: str
) -> Path:
    """Record the posterior of a frame's image in space, with its true pose and the cameras that outline the place.

    The recording, `.rrd`, appears under its name only when complete.

    Raises:
        SequenceError, VaporTrackError: it cannot be written.
    """
    import rerun as rr
    import rerun.blueprint as rrb

    image = rrb.Spatial2DView(origin="world/camera", contents="world/camera", name="image")
    with recorded(path, "vapor-track posterior", title) as stream:
        stream.send_blueprint(with_legend(space_view("posterior", place.first_view()), [image], [1.0]))
        log_styles(stream)
        log_legend(stream, _LEGEND.format(what=place.what))
        place.log(stream)
        points = thinned(posterior.samples, _CLOUD_SIZE).translation.astype(np.float32)
        cameras = frusta(thinned(posterior.samples, _FRUSTA), place.small_camera_m)
        stream.log("world/posterior", rr.Points3D.from_fields(positions=points), static=True)
        stream.log("world/posterior/cameras", rr.LineStrips3D.from_fields(strips=cameras), static=True)
        if modes := posterior_modes(posterior):
            colors = HypothesisColors(place.camera_m).of(Poses.stack([mode.world_from_camera for mode in modes]), None)
            for entity, archetype, components in shown_modes(modes, colors, camera_m=0.8 * place.camera_m):
                stream.log(entity, archetype.from_fields(**components), static=True)
        Photograph.of(frame).log(stream, "world/camera", truth, color=TRUTH, size_m=place.camera_m)
    return path
