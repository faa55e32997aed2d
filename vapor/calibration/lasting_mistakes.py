"""How long images mistake one place for another as the camera moves on."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64

from vapor.calibration.lasting_errors import LastingErrors
from vapor.calibration.travel import LEAST_PAIRS, Travel, pairs_of_images

_NO_MISTAKE = 0.02  # of the images, that find the true place less likely than not: fewer count as none
_MISTAKEN = np.geomspace(0.125, 32.0, 17)  # lengths over which mistakes fade
_FARTHEST_LENGTHS, _LEAST_VOTE, _LEAST_MISTAKEN, _MOST_MISTAKEN = 100.0, 0.25, 4.0, 40.0
_ANOTHER_HOUR = 3.0  # times as far beyond one length mistakes reach where the light is another than on held-out passes


def mistaken_lengths(
    evidence: Float64[np.ndarray, " n"], travel: Travel, lasting: LastingErrors, *, same_conditions: bool = False
) -> float:
    """Over how many lengths of errors images are one vote on where the camera is; 1 where no image mistakes the place.

    The evidence of two images of a pass correlates, the less the more lengths they are apart. A vote is worth less by
    the sum of an image's correlations with all others; what does not last is new with every image, and counts once a
    length where images are farther apart. Under other conditions than on held-out passes mistakes last longer (three to
    five times in two synthetic buildings at another hour): what is beyond one length is multiplied.

    Args:
        evidence: Of n images, the log of how possible each finds the true place (`Places.evidence`).
        travel: Of the camera, between them.
        lasting: How long errors last: lengths are those.
        same_conditions: Whether the images are of the hours, the light and the seasons of use.
    """
    if len(evidence) < LEAST_PAIRS or (evidence < np.log(0.5)).mean() < _NO_MISTAKE:
        return 1.0
    value = (evidence - evidence.mean()) / evidence.std()
    first, second = pairs_of_images(travel, np.ones(len(value), bool))
    steps = lasting.lengths(np.diff(travel.metres), np.diff(travel.radians))[np.diff(travel.pass_number) == 0]
    apart = lasting.lengths(
        travel.metres[second] - travel.metres[first], travel.radians[second] - travel.radians[first]
    )
    near = apart < _FARTHEST_LENGTHS
    apart, products = apart[near], (value[first] * value[second])[near]
    if len(products) < LEAST_PAIRS:
        return 1.0
    best, vote, new = np.inf, 1.0, min(float(np.median(steps)), 1.0)
    for lengths in _MISTAKEN:
        kernel = np.exp(-apart / lengths)
        weight = max(float(np.square(kernel).sum()), 1e-300)
        fraction = float(np.clip((kernel * products).sum() / weight, 0.0, 1.0))
        cost = float(np.square(products - fraction * kernel).mean())
        if cost < best:
            best, vote = cost, (1.0 - fraction) * new + 2.0 * fraction * float(lengths)
    if same_conditions:
        return float(np.clip(vote, _LEAST_VOTE, _MOST_MISTAKEN))
    return float(np.clip(1.0 + _ANOTHER_HOUR * (vote - 1.0), _LEAST_MISTAKEN, _MOST_MISTAKEN))
