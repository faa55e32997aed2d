"""Lines that are walked, as points in order."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64


def distances_along(line: Float64[np.ndarray, "n k"]) -> Float64[np.ndarray, " n"]:
    """Distance of each point of a line from its first one."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])


def points_at(line: Float64[np.ndarray, "n k"], distances: Float64[np.ndarray, " m"]) -> Float64[np.ndarray, "m k"]:
    """Points at distances along a line."""
    walked = distances_along(line)
    return np.stack([np.interp(distances, walked, values) for values in line.T], axis=1)


def resampled(line: Float64[np.ndarray, "n k"], spacing: float) -> Float64[np.ndarray, "m k"]:
    """The same line with points at even distances."""
    return points_at(line, np.arange(0.0, distances_along(line)[-1], spacing))
