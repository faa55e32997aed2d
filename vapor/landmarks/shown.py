"""The landmarks that verify a pose, as an image shows them, to be looked at."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, UInt8


@dataclass(frozen=True)
class ShownLandmarks:
    """An image with the features that were looked at, of which k are landmarks that agree with a pose.

    Attributes:
        image: RGB, of the size at which features are found.
        features: Where features are, pixels, (n, 2).
        seen: Where the image shows the landmarks, pixels, (k, 2).
        predicted: Where these must be seen from the pose, (k, 2).
        others: Landmarks that agree with each of the other poses that are verified of the image.
        number: Of the image in its run, from 0.
    """

    image: UInt8[np.ndarray, "h w 3"]
    features: Float64[np.ndarray, "n 2"]
    seen: Float64[np.ndarray, "k 2"]
    predicted: Float64[np.ndarray, "k 2"]
    others: tuple[int, ...]
    number: int
