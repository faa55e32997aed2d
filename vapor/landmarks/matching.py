"""Which features of two images, or of an image and a map, show the same."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float32, Int64


def mutual_matches(
    one: Float32[np.ndarray, "n d"],
    other: Float32[np.ndarray, "m d"],
    ratio: float,
    *,
    apart: Bool[np.ndarray, "n m"] | None = None,
    least: float = -1.0,
) -> tuple[Int64[np.ndarray, " k"], Int64[np.ndarray, " k"]]:
    """Pairs that are each other's nearest, and nearer by a factor than the first's second nearest.

    Args:
        one: Descriptors, unit vectors.
        other: Likewise.
        ratio: That factor, in distances; 1 for none (Lowe 2004).
        apart: Pairs that are none; None where all may be.
        least: Cosine of a pair, at least.

    Returns:
        Indices of each pair, in increasing order of the first.
    """
    if not len(one) or not len(other):
        return np.empty(0, np.int64), np.empty(0, np.int64)
    likeness = one @ other.T
    if apart is not None:
        likeness[apart] = -2.0
    nearest = likeness.argmax(axis=1)
    rows = np.arange(len(one))
    best = likeness[rows, nearest]
    taken = (likeness.argmax(axis=0)[nearest] == rows) & (best > least)
    if ratio < 1.0 and likeness.shape[1] > 1:
        likeness[rows, nearest] = -2.0
        second = likeness.max(axis=1)
        taken &= 1.0 - best < ratio**2 * (1.0 - second)
    first = np.flatnonzero(taken)
    return first, nearest[first]
