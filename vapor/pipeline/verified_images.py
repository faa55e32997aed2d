"""Images of a run of which landmarks verified a place, a few of them, to show one at its end."""

from __future__ import annotations

import numpy as np
from jaxtyping import UInt8

from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from sequences.frame import Camera
from vapor.landmarks.localize import VerifiedPose
from vapor.landmarks.shown import ShownLandmarks
from vapor.observation import VaporObservationModel

_KEPT = 4


class VerifiedImages:
    """An observation model that keeps some of the images of which landmarks verified a place, evenly spread over them.

    Args:
        model: What makes the posteriors.
    """

    def __init__(self, model: VaporObservationModel) -> None:
        self._model = model
        self._kept: list[tuple[int, UInt8[np.ndarray, "h w 3"], Camera | None, list[VerifiedPose]]] = []
        self._number, self._verified, self._every = 0, 0, 1

    def observe(self, image: np.ndarray, *, rng: np.random.Generator) -> PosePosterior:
        """See `VaporObservationModel.observe`."""
        posterior = self._model.observe(image, rng=rng)
        if self._model.verifier is not None and (found := self._model.verifier.latest):
            if self._verified % self._every == 0:
                self._kept.append((self._number, image.copy(), self._model.camera, found))
            self._verified += 1
            if len(self._kept) == 2 * _KEPT:
                self._kept, self._every = self._kept[::2], 2 * self._every
        self._number += 1
        return posterior

    def middle(self, poses: Poses) -> ShownLandmarks | None:
        """What the image in the middle of those kept shows; None where landmarks verified nothing.

        Args:
            poses: Where the camera was taken to be in each image observed so far, (n,): the verified pose nearest to
                that is shown.
        """
        if self._model.verifier is None or not self._kept:
            return None
        ordinals = self._every * np.arange(len(self._kept))
        number, image, camera, found = self._kept[int(np.abs(ordinals - 0.5 * (self._verified - 1)).argmin())]
        metres, _ = Poses.stack([each.world_from_camera for each in found]).distance(poses[number])
        return self._model.verifier.shown(image, camera, found, which=int(np.argmin(metres)), number=number)
