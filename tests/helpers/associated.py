"""What an image makes of a belief, by the functions of the filter's step."""

from typing import NamedTuple

import numpy as np

from filtering.association import Correlation, correct, evidence, gate
from filtering.hypotheses import Hypotheses
from filtering.posterior import PosePosterior


class Associated(NamedTuple):
    """The hypotheses after an image, with weights not normalised, and what it says of each before it, (n,)."""

    hypotheses: Hypotheses
    log_evidence: np.ndarray
    agreement: float


def associate(
    belief: Hypotheses, posterior: PosePosterior, camera: int, *, novelty: float, distance: float
) -> Associated:
    """Weigh and correct a belief by an image of the camera with this number, which came so far since its last."""
    pairs = gate(belief, posterior, [Correlation(camera, distance)])
    found = evidence(belief, posterior, pairs)
    after = correct(belief.reweighted(novelty * found.log_likelihood), posterior, pairs, found.outlier)
    return Associated(after, found.log_likelihood, found.agreement)
