"""Where a path jumps: there a hypothesis gave way to another, and nothing moved."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64, Int64


def jumps(positions: Float64[np.ndarray, "n 3"]) -> Int64[np.ndarray, " k"]:
    """Indices of the positions (metres) that are much farther from the one before than is usual on the path."""
    step = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    if len(step) == 0:
        return np.zeros(0, np.int64)
    return np.flatnonzero(step > 0.4 + 6.0 * np.median(step)) + 1
