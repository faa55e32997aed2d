"""What a run knows of the vertical of each image: of a planar robot, by the training poses, and by gravity."""

from __future__ import annotations

from dataclasses import replace
from typing import Protocol, runtime_checkable

import numpy as np

from filtering.errors import VaporTrackError
from filtering.planar import Planar, VerticalWatch, world_up_of
from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from filtering.vertical import Vertical
from sequences.frame import Gravity
from vapor.checkpoints.calibration import Calibration
from vapor.pipeline.config import PlanarUse

_UP_RAD = 0.017  # standard deviation of up in the map
_APART = 3.0  # standard deviations of both, from which on two directions are not one
_SOME = 0.03  # of the images, for which it is worth a notice that a robot's tilt was not used
_LENGTHS = 10.0  # over which errors of gravity last: how a unit is mounted, for ever; accelerations, for less


@runtime_checkable
class Trained(Protocol):
    """What is asked of a model: see `vapor.checkpoints.checkpoint.ModelDescription`."""

    @property
    def prior_poses(self) -> Poses:
        """Samples of its network."""
        ...

    @property
    def memory_poses(self) -> Poses | None:
        """True poses of training images that it remembers."""
        ...

    @property
    def calibration(self) -> Calibration:
        """Its errors."""
        ...


def planar_of(model: Trained) -> Planar | None:
    """The tilt and height of the camera by a model's training poses; None where it has few.

    Where the model has samples of its network in place of true poses, the network's errors are part of the spread.
    """
    if model.memory_poses is not None:
        return Planar.found_in(model.memory_poses)
    found = Planar.found_in(model.prior_poses)
    if found is None or found.vertical.up is None:
        return found
    errors, along = np.square(model.calibration.errors.typical_std), np.square(found.vertical.up)
    tilt_error = float(np.sqrt(errors[3:] @ (1.0 - along) / 2.0))
    height_error = float(np.sqrt(errors[:3] @ along))
    return Planar.found_in(model.prior_poses, tilt_error_rad=tilt_error, height_error_m=height_error)


class Verticals:
    """The vertical of each image of a run.

    Args:
        model: Its training poses show whether a robot is planar, and which way is up.
        use: Whether the robot is planar: yes, no, or by these poses, as long as images agree.

    Attributes:
        notices: Sentences for users; complete after the run.

    Raises:
        VaporTrackError: it is said to be planar, and the model has too few training poses to know the tilt.
    """

    def __init__(self, model: Trained, use: PlanarUse) -> None:
        found = None if use == "no" else planar_of(model)
        if use == "yes" and found is None:
            raise VaporTrackError(
                f"--planar yes with a model of {len(model.prior_poses)} training poses, expected at least 20, which"
                " show the tilt and the height of the camera"
            )
        self._planar = found if use == "yes" or (found is not None and found.is_robot) else None
        self._watch = VerticalWatch() if self._planar is not None and use == "auto" else None
        self._poses, self._gravity_watch = model.memory_poses or model.prior_poses, VerticalWatch()
        self._world_up = self._planar.vertical.world_up if self._planar is not None else None

    def step(
        self, posterior: PosePosterior, gravity: Gravity | None = None, *, is_localized: bool = True
    ) -> Vertical | None:
        """The vertical of the next image; None where nothing is known.

        Args:
            posterior: Of the frame that is localized, by the image.
            gravity: About its axes.
            is_localized: Whether the camera that is localized took the image: others may be mounted otherwise than
                stated, so they do not say whether the vertical fits.
        """
        if not is_localized:
            posterior = posterior.without_places()
        vertical = None if self._planar is None else self._planar.vertical
        if vertical is not None and self._watch is not None:
            vertical = self._watch.step(posterior, vertical)
        if gravity is None:
            return vertical
        self._world_up = self._world_up or world_up_of(self._poses)
        std_rad = float(np.hypot(gravity.std_rad, _UP_RAD))
        measured = self._gravity_watch.step(posterior, Vertical(gravity.up, std_rad, None, self._world_up, _LENGTHS))
        return _together(vertical, measured) if vertical is not None and measured is not None else vertical or measured

    @property
    def usual_up(self) -> tuple[float, float, float] | None:
        """Up about the axes of a robot's camera; None where the tilt is not that of a robot."""
        return None if self._planar is None else self._planar.vertical.up

    @property
    def notices(self) -> list[str]:
        """Sentences for users, by the images so far."""
        notices, watch, gravity = [], self._watch, self._gravity_watch
        if self._planar is not None:
            spread = f"within {np.degrees(self._planar.tilt_std_rad):.1f}°"
            notices.append(f"planar robot: tilt ({spread}) and height of the camera are those of the training poses")
            if watch is not None and watch.num_let_go > _SOME * watch.num_images:
                notices[-1] = (
                    f"not a planar robot in {watch.num_let_go} of {watch.num_images} images: their tilt or height is"
                    f" not that of the training poses ({spread}), which were not used there"
                )
        if gravity.num_let_go:
            off = np.degrees(gravity.largest_tilt_rad)
            why = "upside down" if off > 135.0 else "another mount of the unit or another up of the model"
            notices.append(
                f"gravity is off the images by {off:.0f}° ({why}), and not used in {gravity.num_let_go} of"
                f" {gravity.num_images} images"
            )
        return notices


def _together(robot: Vertical, gravity: Vertical) -> Vertical:
    """The tilt of a robot and gravity as one direction, weighted by their variances, with the robot's height."""
    if robot.up is None or gravity.up is None:
        return robot
    if np.dot(robot.up, gravity.up) < np.cos(_APART * float(np.hypot(robot.tilt_std_rad, gravity.tilt_std_rad))):
        return robot
    weights = np.array([robot.tilt_std_rad, gravity.tilt_std_rad]) ** -2.0
    up = weights @ np.array([robot.up, gravity.up])
    x, y, z = (float(each) for each in up / np.linalg.norm(up))
    exact = gravity if gravity.tilt_std_rad < robot.tilt_std_rad else robot
    return replace(robot, up=(x, y, z), tilt_std_rad=float(weights.sum() ** -0.5), lengths=exact.lengths)
