"""Particles -> Estimate: the hypotheses, with weight and covariance, and how sure they are."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float64

from filtering.se3 import Poses

Status = Literal["converged", "ambiguous", "lost"]


@dataclass(frozen=True)
class Mode:
    """One hypothesis of where the camera is.

    Attributes:
        world_from_camera: One pose, the mean of the mode.
        covariance: Covariance of ξ = (v, ω), metres and radians, in the tangent at the mode (camera frame).
        weight: Share of the belief, in [0, 1].
    """

    world_from_camera: Poses
    covariance: Float64[np.ndarray, "6 6"]
    weight: float


@dataclass(frozen=True)
class Estimate:
    """What the filter believes after one image.

    Attributes:
        modes: Hypotheses; the first is the best one reported, the others follow by falling weight.
        status: "converged" when one mode holds most of the belief, "ambiguous" when several share it,
            "lost" when the images no longer fit the belief.
        particles: All particles, world_from_camera, batch (n,).
        log_weights: Their normalised log weights, (n,).
        effective_sample_size: 1 / Σ w², before resampling, in particles.
        log_evidence: Log of the mean likelihood of the image under the predicted belief; low when the image is
            unlike what was expected.
    """

    modes: tuple[Mode, ...]
    status: Status
    particles: Poses
    log_weights: Float64[np.ndarray, " n"]
    effective_sample_size: float
    log_evidence: float
