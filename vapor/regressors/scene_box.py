"""SceneBox: where in the world cameras can be."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from filtering.errors import VaporTrackError
from filtering.se3 import Poses

_MARGIN, _MARGIN_M = 0.1, 0.3
_MAX_POSITION_M = 1e8  # further than anything on Earth


@dataclass(frozen=True)
class SceneBox:
    """Axis-aligned box that predicted camera positions lie in, metres, from training poses only."""

    lower: tuple[float, float, float]
    upper: tuple[float, float, float]

    def __post_init__(self) -> None:
        lower, upper = np.array(self.lower), np.array(self.upper)
        if not ((np.abs([lower, upper]) <= _MAX_POSITION_M).all() and (lower < upper).all()):
            raise VaporTrackError(
                f"box from {self.lower} to {self.upper}, expected numbers within {_MAX_POSITION_M:g} m, each lower one"
                " below its upper one"
            )

    @property
    def extent(self) -> Float64[np.ndarray, "3"]:
        """Edges, metres."""
        return np.array(self.upper) - self.lower

    @staticmethod
    def around(training_poses: Poses) -> SceneBox:
        """The box around training poses (n,), wider on each side by a tenth of its extent, at least 0.3 m."""
        lower, upper = training_poses.translation.min(axis=0), training_poses.translation.max(axis=0)
        wider = np.maximum(_MARGIN * (upper - lower), _MARGIN_M)
        return SceneBox(_triple(lower - wider), _triple(upper + wider))

    def union(self, other: SceneBox) -> SceneBox:
        """The smallest box around both."""
        return SceneBox(_triple(np.minimum(self.lower, other.lower)), _triple(np.maximum(self.upper, other.upper)))


def _triple(values: np.ndarray) -> tuple[float, float, float]:
    return float(values[0]), float(values[1]), float(values[2])
