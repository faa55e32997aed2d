"""What a run knows of the vertical of each image: that of a planar robot, as the model's training poses show it."""

from __future__ import annotations

import numpy as np

from filtering.errors import VaporTrackError
from filtering.planar import Planar, PlanarWatch
from filtering.posterior import PosePosterior
from filtering.vertical import Vertical
from vapor.checkpoints.checkpoint import ModelDescription
from vapor.pipeline.config import PlanarUse


def planar_of(model: ModelDescription) -> Planar | None:
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
        model: Its training poses show whether a robot is planar.
        use: Whether it is: yes, no, or by these poses, as long as images agree.

    Attributes:
        notices: Sentences for users; complete after the run.

    Raises:
        VaporTrackError: it is said to be planar, and the model has too few training poses to know the tilt.
    """

    def __init__(self, model: ModelDescription, use: PlanarUse) -> None:
        found = None if use == "no" else planar_of(model)
        if use == "yes" and found is None:
            raise VaporTrackError(
                f"--planar yes with a model of {len(model.prior_poses)} training poses, expected at least 20, which"
                " show the tilt and the height of the camera"
            )
        self._planar = found if use == "yes" or (found is not None and found.is_robot) else None
        self._watch = PlanarWatch(self._planar) if self._planar is not None and use == "auto" else None

    def step(self, posterior: PosePosterior) -> Vertical | None:
        """The vertical of the next image; None where nothing is known."""
        if self._watch is not None:
            return self._watch.step(posterior)
        return None if self._planar is None else self._planar.vertical

    @property
    def notices(self) -> list[str]:
        """Sentences for users, by the images so far."""
        if self._planar is None:
            return []
        watch = self._watch
        spread = f"within {np.degrees(self._planar.tilt_std_rad):.1f}°"
        if watch is None or watch.num_let_go == 0:
            return [f"planar robot: tilt ({spread}) and height of the camera are those of the training poses"]
        return [
            f"not a planar robot in {watch.num_let_go} of {watch.num_images} images: their tilt or height is not that"
            f" of the training poses ({spread}), which were not used there"
        ]
