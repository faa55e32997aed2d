"""Which features of two images, or of an image and a map, show the same."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float32, Float64, Int64
from scipy.spatial import KDTree


def mutual_matches(
    one: Float32[np.ndarray, "n d"], other: Float32[np.ndarray, "m d"], ratio: float
) -> tuple[Int64[np.ndarray, " k"], Int64[np.ndarray, " k"]]:
    """Pairs that are each other's nearest, and nearer by a factor than the first's second nearest.

    Args:
        one: Descriptors, unit vectors.
        other: Likewise.
        ratio: That factor, in distances (Lowe 2004).

    Returns:
        Indices of each pair, in increasing order of the first.
    """
    if not len(one) or not len(other):
        return np.empty(0, np.int64), np.empty(0, np.int64)
    likeness = one @ other.T
    rows = np.arange(len(one))
    nearest = likeness.argmax(axis=1)
    best = likeness[rows, nearest]
    if likeness.shape[1] > 1:
        likeness[rows, nearest] = -2.0
        first = np.flatnonzero(1.0 - best < ratio**2 * (1.0 - likeness.max(axis=1)))
        likeness[rows, nearest] = best
    else:
        first = rows
    second = nearest[first]
    mutual = likeness[:, second].argmax(axis=0) == first
    return first[mutual], second[mutual]


def within(
    one: Float64[np.ndarray, "n 2"], other: Float64[np.ndarray, "m 2"], most_px: float
) -> tuple[Int64[np.ndarray, " p"], Int64[np.ndarray, " p"]]:
    """Indices of all pairs of pixels that lie within so many pixels of each other along both axes."""
    if not len(one) or not len(other):
        return np.empty(0, np.int64), np.empty(0, np.int64)
    pairs = KDTree(one).sparse_distance_matrix(KDTree(other), most_px, p=np.inf, output_type="ndarray")
    return pairs["i"].astype(np.int64), pairs["j"].astype(np.int64)


def mutual_matches_among(
    likeness: Float32[np.ndarray, " p"], i: Int64[np.ndarray, " p"], j: Int64[np.ndarray, " p"]
) -> tuple[Int64[np.ndarray, " k"], Int64[np.ndarray, " k"]]:
    """Those of some pairs that are each other's likest among these.

    Args:
        likeness: Of each pair; the first of equals is the likest.
        i: Of each pair, the index in one set.
        j: In the other.

    Returns:
        Indices of each pair, in increasing order of the first.
    """
    order = np.lexsort([j, i, -likeness])
    i, j = i[order], j[order]
    taken = np.zeros(len(order), bool)
    taken[np.intersect1d(np.unique(i, return_index=True)[1], np.unique(j, return_index=True)[1])] = True
    first, second = i[taken], j[taken]
    order = np.argsort(first, kind="stable")
    return first[order], second[order]
