"""What a network says of images whose true poses are known: what calibration learns from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from filtering.se3 import Poses


@dataclass(frozen=True)
class Observations:
    """Posterior samples of n images, and the true poses of these.

    Attributes:
        samples: Posterior samples of each, world_from_camera, (m,) each.
        truth: True poses, world_from_camera, (n,).
        score: How unlike the training images each is (`PosePosterior.unfamiliarity`), (n,); None where the model does
            not say.
    """

    samples: Sequence[Poses]
    truth: Poses
    score: Float64[np.ndarray, " n"] | None = None
