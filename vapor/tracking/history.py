"""What is kept of every image for the methods that see a whole run at once."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float64

from filtering.estimate import Mode
from filtering.motion import Odometry
from filtering.se3 import Poses
from vapor.tracking.loop import Step

MOST_MODES = 16
"""Kept of each image, the heaviest: enough for a place among many alike, and bounded in memory over a long run."""


class History:
    """The steps of a run of n images, without their posterior samples and particles.

    Attributes:
        evidence: What each image says of where the camera is, as of `Step`, (n,).
        odometry: Motion since the image before, (n,); None where it is unknown.
    """

    def __init__(self) -> None:
        self.evidence: list[tuple[Mode, ...]] = []
        self.odometry: list[Odometry | None] = []
        self._distances: list[float] = []
        self._filtered: list[Poses] = []
        self._converged: list[bool] = []

    def add(self, step: Step, odometry: Odometry | None) -> None:
        """Append one image."""
        self.evidence.append(step.evidence[:MOST_MODES])
        self.odometry.append(odometry)
        self._distances.append(step.estimate.normalized_distance)
        self._filtered.append(step.estimate.modes[0].world_from_camera)
        self._converged.append(step.estimate.status == "converged")

    @property
    def normalized_distances(self) -> Float64[np.ndarray, " n"]:
        """That the camera moved since the image before (`Estimate.normalized_distance`), (n,)."""
        return np.array(self._distances)

    @property
    def filtered(self) -> Poses:
        """Best modes of the filter, world_from_camera, batch (n,)."""
        return Poses.stack(self._filtered)

    @property
    def converged(self) -> Bool[np.ndarray, " n"]:
        """Whether the filter said that it had converged, (n,)."""
        return np.array(self._converged, bool)
