"""What outlines the place of a run on its page: landmarks, or where the training images were taken."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32

from vapor.checkpoints.checkpoint import ModelDescription

_MOST_POINTS = 4000


@dataclass(frozen=True)
class Outline:
    """Points (p, 3) of the place of a run, metres, p ≥ 1, and what these are, in a few words."""

    points: Float32[np.ndarray, "p 3"]
    what: str

    @staticmethod
    def of_model(model: ModelDescription) -> Outline:
        """Landmarks of a model, or positions of its training images, or those that its network gives for these."""
        if model.landmarks is not None:
            points, what = model.landmarks.map.points, "landmarks"
        elif model.memory_poses is not None:
            points, what = model.memory_poses.translation, "training images"
        else:
            points, what = model.prior_poses.translation, "training images, where the network sees them"
        some = np.linspace(0, len(points) - 1, min(_MOST_POINTS, len(points))).round().astype(np.int64)
        return Outline(points[some].astype(np.float32), what)
