"""By how much more images err that look unlike those of the training."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from filtering.error_model import FOREIGN, LEAST_SCORE, ErrorModel
from vapor.calibration.observations import Observations
from vapor.calibration.places import Places

_POWERS = np.linspace(0.0, 1.5, 13)  # by which errors grow with the score


def growing_errors(
    errors: ErrorModel,
    places: Places,
    score: Float64[np.ndarray, " n"],
    trained: Observations,
    trained_score: Float64[np.ndarray, " k"],
) -> ErrorModel:
    """The model with errors that grow with the score by the power of highest likelihood.

    Images held out and images trained on, which are more familiar, have the same weight in it.

    Args:
        errors: The model so far, fitted on the held-out images.
        places: Of the held-out images, n.
        score: How unfamiliar each of these is.
        trained: Images that were trained on, k.
        trained_score: How unfamiliar each of these is.
    """
    errors = replace(errors, unfamiliar_score=ordinary_score(score))
    known = Places.near(trained.samples, trained.truth, errors.radius_m, errors.radius_rad)

    def likelihood(grown: ErrorModel) -> float:
        held_out = places.grown(grown, score).log_density(grown).mean()
        return float(held_out + known.grown(grown, trained_score).log_density(grown).mean())

    return max((replace(errors, unfamiliar_power=float(power)) for power in _POWERS), key=likelihood)


def ordinary_score(score: Float64[np.ndarray, " n"]) -> float:
    """The score of an ordinary one among n images of the place: their median, within the range that counts."""
    return float(np.clip(np.median(score), LEAST_SCORE, FOREIGN))
