"""The input of one step of the filter: the pose posteriors of images, and the odometry, of one moment."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from filtering.errors import VaporTrackError
from filtering.motion import Odometry
from filtering.posterior import PosePosterior
from filtering.se3 import Poses

_ONLY_CAMERA = "camera"


@dataclass(frozen=True)
class View:
    """The pose posterior of one image of one camera.

    Attributes:
        posterior: Of the camera's pose.
        reference_from_camera: Its extrinsics: from the camera to the frame that is localized, one pose.
        camera: Its name; errors are correlated among the images of one camera only.
    """

    posterior: PosePosterior
    reference_from_camera: Poses
    camera: str


@dataclass(frozen=True)
class Observation:
    """The observations of one moment.

    Attributes:
        views: One of each camera that took an image; empty without any.
        odometry: Motion of the frame that is localized since the previous observation, not used on the first one; None
            where it is unknown.
        elapsed_s: Seconds since the previous observation; used where `odometry` is None.

    Raises:
        VaporTrackError: two views are of one camera, or the elapsed time is negative or infinite.
    """

    views: tuple[View, ...] = ()
    odometry: Odometry | None = None
    elapsed_s: float = 1.0

    def __post_init__(self) -> None:
        names = [view.camera for view in self.views]
        if len(set(names)) < len(names):
            raise VaporTrackError(f"views of cameras {', '.join(names)}, expected each once")
        if not 0.0 <= self.elapsed_s < np.inf:
            raise VaporTrackError(f"{self.elapsed_s} s since the previous step, expected a finite time of 0 s or more")

    @staticmethod
    def of_posterior(posterior: PosePosterior, odometry: Odometry | None, elapsed_s: float = 1.0) -> Observation:
        """One posterior, of the camera that is localized."""
        return Observation((View(posterior, Poses.identity(), _ONLY_CAMERA),), odometry, elapsed_s)

    @property
    def posterior(self) -> PosePosterior:
        """Of the first view, as its camera sees it; uninformative without any."""
        return self.views[0].posterior if self.views else PosePosterior.uninformative()
