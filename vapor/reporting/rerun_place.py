"""The place in which something is shown: what outlines it, how large it is, and from where all of it is seen."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float64

from filtering.se3 import Poses
from filtering.storeys import up_axis
from vapor.checkpoints.checkpoint import ModelDescription
from vapor.reporting.rerun_shapes import frusta, thinned

if TYPE_CHECKING:
    import rerun as rr
    import rerun.blueprint as rrb

_POINTS, _FRUSTA = 2000, 200
_TAIL = 0.005  # of the positions, at either end of each axis: predictions of networks may lie anywhere
_MARGIN = 0.05  # of the box that is looked at, in its diagonals
_CAMERA, _SMALL_CAMERA = 0.05, 0.012  # sizes of cameras, in diagonals
_AROUND_RAD, _DOWN_RAD = np.radians([30.0, 33.0])  # from where one looks at the long side of the place
_HALF_VIEW = np.tan(np.radians(55.0 / 2))  # of Rerun's eye, up and down
_FAINT = (105, 105, 112)


@dataclass(frozen=True)
class Place:
    """The place of a run, outlined by cameras (n,), world_from_camera, n ≥ 1, and what these are, in a few words."""

    poses: Poses
    what: str

    @staticmethod
    def of_model(model: ModelDescription) -> Place:
        """Where the training images of a model were taken, or posterior samples of these where it keeps no poses."""
        if model.memory_poses is not None:
            return Place(thinned(model.memory_poses, _POINTS), "training cameras")
        return Place(thinned(model.prior_poses, _POINTS), "posterior samples of training images")

    @cached_property
    def box(self) -> tuple[Float64[np.ndarray, "3"], Float64[np.ndarray, "3"]]:
        """The lowest and the highest corner of the box around it, metres; a metre wide where all is one point."""
        low, high = np.quantile(self.poses.translation, [_TAIL, 1.0 - _TAIL], axis=0)
        if np.linalg.norm(high - low) < 1e-9:
            return low - 0.5, high + 0.5
        return low, high

    @property
    def camera_m(self) -> float:
        """Size at which a camera is drawn that stands out, metres."""
        return _CAMERA * float(np.linalg.norm(self.box[1] - self.box[0]))

    @property
    def small_camera_m(self) -> float:
        """Size at which one of many cameras is drawn, metres."""
        return _SMALL_CAMERA / _CAMERA * self.camera_m

    @cached_property
    def up(self) -> Float64[np.ndarray, "3"]:
        """The axis that is up."""
        return up_axis(self.poses)

    def first_view(self, followed: str | None = None) -> rrb.EyeControls3D:
        """From obliquely above its long side, as near as all of it is in view; the eye may follow an entity."""
        import rerun.blueprint as rrb

        eye, target = whole_view(*self.box, self.up)
        return rrb.EyeControls3D(position=eye, look_target=target, eye_up=self.up, tracking_entity=followed)

    def log(self, stream: rr.RecordingStream) -> None:
        """Log which way is up, and its cameras, faint and small."""
        self.log_up(stream)
        entity = f"world/place/{self.what.replace(' ', '_')}"
        log_cameras(stream, entity, self.poses, _FAINT, size_m=self.small_camera_m)

    def log_up(self, stream: rr.RecordingStream) -> None:
        """Log which way is up."""
        import rerun as rr

        axis = int(np.argmax(np.abs(self.up)))
        name = f"RIGHT_HAND_{'XYZ'[axis]}_{'UP' if self.up[axis] > 0 else 'DOWN'}"
        stream.log("world", getattr(rr.ViewCoordinates, name), static=True)


def whole_view(
    low: Float64[np.ndarray, "3"], high: Float64[np.ndarray, "3"], up: Float64[np.ndarray, "3"]
) -> tuple[Float64[np.ndarray, "3"], Float64[np.ndarray, "3"]]:
    """Eye and target from which a box (metres) is seen as a whole, in a view that is no higher than wide.

    The axis of the world that is up, or its opposite, is `up`.
    """
    sides = high - low
    level = [axis for axis in range(3) if up[axis] == 0.0]
    long, short = (np.eye(3)[axis] for axis in sorted(level, key=lambda axis: -sides[axis]))
    ahead = np.cos(_DOWN_RAD) * (np.cos(_AROUND_RAD) * short - np.sin(_AROUND_RAD) * long) - np.sin(_DOWN_RAD) * up
    across = np.cross(ahead, up)
    across /= np.linalg.norm(across)
    target = (low + high) / 2
    half = sides / 2 + _MARGIN * float(np.linalg.norm(sides))
    corners = half * np.stack(np.meshgrid([-1, 1], [-1, 1], [-1, 1]), axis=-1).reshape(-1, 3)
    aside = np.abs(corners @ np.stack([across, np.cross(across, ahead)], axis=1)).max(axis=1)
    return target - float((aside / _HALF_VIEW - corners @ ahead).max()) * ahead, target


def log_cameras(
    stream: rr.RecordingStream, entity: str, poses: Poses, color: tuple[int, int, int], *, size_m: float
) -> None:
    """Log many cameras (n,), which never change, as points, and some of them as cameras of a size in metres."""
    import rerun as rr

    points = thinned(poses, _POINTS).translation.astype(np.float32)
    lines = frusta(thinned(poses, _FRUSTA), size_m)
    stream.log(entity, rr.Points3D(points, colors=color, radii=rr.Radius.ui_points(1.5)), static=True)
    strips = rr.LineStrips3D(lines, colors=color, radii=rr.Radius.ui_points(0.5))
    stream.log(f"{entity}/looking", strips, static=True)
