"""How often a network saw each place in training, which its posterior contains and a likelihood does not."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from jaxtyping import Float32, Float64

from filtering.errors import VaporTrackError
from filtering.se3 import Poses

_RAREST = 0.05  # fraction of the training poses with fewer around them than any place counts as having
_SOME = 500  # training poses by which that is found


class TrainingPrior:
    """Density of training poses, smoothed over the width of a place.

    A network trained on a place more often prefers it: its posterior is the likelihood times this density. A place with
    hardly any training pose around it counts as one of the rarest 5 % of the training poses.

    Args:
        poses: Poses of training images, evenly chosen, batch (n,), n ≥ 1.
        radius_m: Width of a place, metres: the standard deviation of the kernel.
        radius_rad: And radians.

    Raises:
        VaporTrackError: no pose.
    """

    def __init__(self, poses: Poses, radius_m: float, radius_rad: float) -> None:
        if len(poses) == 0:
            raise VaporTrackError("a training prior needs at least one pose, got an empty batch")
        self._widths = np.repeat([radius_m, radius_rad], [3, 9])
        self._origin = np.median(poses.chordal, axis=0)
        # Squared distances between these are (metres / radius)² + (2 − 2 cos angle) / radius².
        self._centres = self._embedded(poses)
        self._squares = np.float32(-0.5) * np.vecdot(self._centres, self._centres)

    def density(self, poses: Poses) -> Float64[np.ndarray, " k"]:
        """Training poses around each of these, by a Gaussian kernel of height 1, (k,)."""
        return np.maximum(self._around(self._embedded(poses)), self._least)

    @cached_property
    def _least(self) -> float:
        some = self._centres[:: max(1, len(self._centres) // _SOME)]
        return float(np.quantile(self._around(some), _RAREST))

    def _embedded(self, poses: Poses) -> Float32[np.ndarray, "k 12"]:
        return ((poses.chordal - self._origin) / self._widths).astype(np.float32)

    def _around(self, embedded: Float32[np.ndarray, "k 12"]) -> Float64[np.ndarray, " k"]:
        exponent = embedded @ self._centres.T
        exponent += self._squares
        exponent -= np.float32(0.5) * np.vecdot(embedded, embedded)[:, None]
        np.minimum(exponent, 0.0, out=exponent)
        return np.exp(exponent, out=exponent).sum(axis=1, dtype=np.float64)
