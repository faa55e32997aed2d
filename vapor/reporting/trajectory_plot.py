"""Trajectories from above, by Matplotlib."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from filtering.errors import VaporTrackError
from filtering.plots import Plan
from filtering.se3 import Poses
from sequences.frame import Trajectory
from vapor.reporting.drawing import COLORS, jumps
from vapor.tracking.methods import METHODS

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_MORE = ("#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#0072b2", "#8c564b")
"""Colours of trajectories that are none of a method of ours."""


def plot_trajectories(
    trajectories: Mapping[str, Trajectory | Poses], axes: Axes | None = None, *, plane: str | None = None
) -> Axes:
    """Draw trajectories from above, by their names; a line is broken where a hypothesis jumps instead of moving.

    The truth lies below the others, and is wider: where they agree, both are seen.

    Names of tracking methods, as of `RunRecord.methods`, and `truth` have the labels and colours of the reports; any
    other name is its own label.

    Args:
        trajectories: Trajectories, or poses (n,) world_from_camera.
        axes: Matplotlib's axes to draw in, where `axes.legend()` adds a legend; None for a new figure with one.
        plane: Two axes of the world, such as "xz"; None for the horizontal ones, by the cameras.

    Raises:
        VaporTrackError: they have no names, there is no pose, or the plane is none.

    Example:
        >>> import vapor
        >>> paths = {"mine": vapor.read_tum("estimates.tum"), "truth": vapor.read_tum("truth.tum")}
        >>> axes = vapor.plot_trajectories(paths)
        >>> axes.get_xlabel()
        'x [m]'
        >>> axes.figure.savefig("paths.png")
    """
    if not isinstance(trajectories, Mapping):
        raise VaporTrackError(
            f"one {type(trajectories).__name__}, expected trajectories by name, such as {{'mine': ...}}"
        )
    paths = {name: each.poses if isinstance(each, Trajectory) else each for name, each in trajectories.items()}
    if not any(len(poses) for poses in paths.values()):
        raise VaporTrackError(f"no pose in {len(paths)} trajectories, expected one at least")
    plan = Plan(axes, plane, Poses.concatenate([*paths.values()]))
    more = iter(_MORE * len(paths))
    for name, poses in paths.items():
        method = METHODS.get(name)
        label = name if method is None else method.label
        color = COLORS["truth"] if name == "truth" else next(more) if method is None else method.color
        positions = poses.translation
        is_dotted = method is not None and method.kind == "image"
        drawn = positions if is_dotted else np.insert(positions, jumps(positions), np.nan, axis=0)
        plan.path(drawn, color, label, dotted=is_dotted, below=name == "truth")
    truth_first = sorted(paths, key=lambda name: name != "truth")
    x, y = next(paths[name] for name in truth_first if len(paths[name])).translation[0, plan.plane]
    plan.axes.plot(x, y, "o", color=COLORS["truth"], markersize=5, label="begin", zorder=4)
    return plan.finish()
