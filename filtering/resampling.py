"""Weights -> ancestor indices. Every scheme is unbiased: index i is drawn n·wᵢ times on average.

Source: Douc, Cappé and Moulines, "Comparison of resampling schemes for particle filtering", 2005.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from jaxtyping import Float64, Int64

from filtering.errors import VaporTrackError

Resampler = Callable[..., Int64[np.ndarray, " n"]]


def systematic(
    weights: Float64[np.ndarray, " m"], num_samples: int, *, rng: np.random.Generator
) -> Int64[np.ndarray, " n"]:
    """Ancestors at a regular grid with one random offset: each index ⌊n·w⌋ or ⌈n·w⌉ times."""
    return _invert(weights, (np.arange(num_samples) + rng.random()) / num_samples)


def stratified(
    weights: Float64[np.ndarray, " m"], num_samples: int, *, rng: np.random.Generator
) -> Int64[np.ndarray, " n"]:
    """Ancestors at one uniform draw in each of n equal strata."""
    return _invert(weights, (np.arange(num_samples) + rng.random(num_samples)) / num_samples)


def multinomial(
    weights: Float64[np.ndarray, " m"], num_samples: int, *, rng: np.random.Generator
) -> Int64[np.ndarray, " n"]:
    """Independent ancestors; the highest variance, for comparison."""
    return _invert(weights, np.sort(rng.random(num_samples)))


def _invert(weights: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Indices at which the cumulative weights pass the sorted points in [0, 1)."""
    if not np.isfinite(weights).all() or (weights < 0).any() or weights.sum() <= 0:
        raise VaporTrackError(
            f"resampling weights must be finite, at least 0 and not all 0; got minimum {weights.min():.3g}, "
            f"sum {weights.sum():.3g}"
        )
    cumulative = np.cumsum(weights)
    # Pinned so that rounding can never push a point beyond the end, nor onto a trailing zero weight.
    cumulative[np.flatnonzero(weights)[-1] :] = cumulative[-1]
    cumulative /= cumulative[-1]
    return np.searchsorted(cumulative, points, side="right").astype(np.int64)
