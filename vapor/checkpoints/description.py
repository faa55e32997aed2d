"""What a model says of itself beside its weights: all that using it needs to know, whatever runs the network."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from filtering.se3 import Poses
from sequences.frame import Camera
from vapor.checkpoints.calibration import Calibration
from vapor.landmarks.verify import Landmarks
from vapor.regressors.familiarity import Familiarity
from vapor.regressors.network_config import NetworkConfig
from vapor.regressors.scene_box import SceneBox


@dataclass(frozen=True)
class ModelDescription:
    """A model without its weights.

    Attributes:
        network: Shape of the network.
        box: Box of predicted positions.
        calibration: How wrong its posteriors are.
        prior_poses: A posterior sample of each of n ≤ 2000 training images, batch (n,): they outline the scene.
        network_sha256: Digest of what the posterior samples depend on: network, box, weights and memory.
        training: Where it came from (data names, seed, images seen, validation figures); any JSON.
        familiarity: What training images look like to the network; None where that was never learned.
        camera: The camera of the training images, undistorted; None where unknown.
        memory_poses: True poses of the training images that a retrieval regressor remembers; None with any other.
        file: The file that it was read from; None of one in memory.
        landmarks: Points of the place, by which poses are found to centimetres; None where there are none.
    """

    network: NetworkConfig
    box: SceneBox
    calibration: Calibration
    prior_poses: Poses
    network_sha256: str
    training: Mapping[str, Any] = field(default_factory=dict)
    familiarity: Familiarity | None = None
    camera: Camera | None = None
    memory_poses: Poses | None = None
    file: Path | None = None
    landmarks: Landmarks | None = None


def poses_of(rotation: np.ndarray, translation: np.ndarray) -> Poses:
    """Poses (n,) of matrices (n, 3, 3) and positions (n, 3) of any precision."""
    return Poses(rotation.astype(np.float64), translation.astype(np.float64))
