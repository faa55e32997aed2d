"""Places one above the other: which floor a pose is on, and how good poses are but for it."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
from jaxtyping import Bool, Float64, Int64

from filtering.se3 import Poses
from vapor.evaluation.trajectory import is_right

_LEAST_APART_M, _MOST_APART_M = 1.8, 8.0  # less is no storey; a higher one is cut no lower than this
_LEAST_ABOVE = 0.02  # of the cells of a plan must have something above them
_BINS = 12  # of the histogram of heights, a storey


def find_floors(
    heights_m: Float64[np.ndarray, " n"], cells: Int64[np.ndarray, " n"]
) -> tuple[Int64[np.ndarray, " n"], int]:
    """Which floor each of n positions is on, from 0 at the bottom, and how many floors there are.

    Floors are where positions lie above each other by 1.8 m and more; they are cut where the fewest positions are.
    Stairs go to the floor that is nearer.

    Args:
        heights_m: Heights of the positions, metres.
        cells: Number of the cell of the plan that each is in.
    """
    from scipy.signal import find_peaks  # loads all of SciPy's signals and statistics, which takes a while

    one = np.zeros(len(heights_m), np.int64), 1
    order = np.lexsort((heights_m, cells))
    gaps = np.diff(heights_m[order])
    within = np.diff(cells[order]) == 0
    above = within & (gaps >= _LEAST_APART_M)
    if not above.any() or len(np.unique(cells[order][1:][above])) < _LEAST_ABOVE * len(np.unique(cells)):
        return one
    apart_m = min(float(np.quantile(gaps[above], 0.25)), _MOST_APART_M)
    step_m = apart_m / _BINS
    low = float(heights_m.min()) - step_m
    bins = np.floor((heights_m - low) / step_m).astype(np.int64)
    # How many cells have something at a height: a camera that stands counts once.
    counts = np.bincount(np.unique(np.column_stack([bins, cells]), axis=0)[:, 0], minlength=int(bins.max()) + 2)
    smooth = np.convolve(counts, np.hanning(_BINS // 2 + 3)[1:-1], mode="same")
    peaks = find_peaks(np.concatenate([[0.0], smooth, [0.0]]), distance=round(0.7 * _BINS))[0] - 1
    if len(peaks) < 2:
        return one
    cuts = []
    for low_bin, high_bin in pairwise(peaks.tolist()):
        between = smooth[low_bin:high_bin]
        cuts.append(low_bin + int(np.median(np.flatnonzero(between <= between.min() + 0.05 * between.max()))))
    floor = np.searchsorted(cuts, bins, side="left")
    return np.unique(floor, return_inverse=True)[1].astype(np.int64), len(np.unique(floor))


def floors_off(poses: Poses, truth: Poses, floor_height_m: float) -> Int64[np.ndarray, " n"]:
    """By how many floors poses (n,) are too high, to the nearest floor."""
    return np.round((poses.translation[:, 2] - truth.translation[:, 2]) / floor_height_m).astype(np.int64)


def on_true_floor(poses: Poses, truth: Poses, floor_height_m: float) -> Poses:
    """The poses (n,), each moved up or down by whole floors to the true one."""
    down = np.zeros_like(poses.translation)
    down[:, 2] = floor_height_m * floors_off(poses, truth, floor_height_m)
    return Poses(poses.rotation, poses.translation - down)


def once_on_floor(poses: Poses, truth: Poses, floor_height_m: float) -> Bool[np.ndarray, " n"]:
    """The images from the first on which, and on all later ones of which, the floor is right, (n,)."""
    wrong = floors_off(poses, truth, floor_height_m) != 0
    return np.cumsum(wrong[::-1])[::-1] == 0


def evaluate_floor(poses: Poses, truth: Poses, floor_height_m: float) -> dict[str, Any]:
    """How often poses (n,) are right but for their floor, and once their floor is right.

    Returns:
        `but_for_it`: fraction of the images that are right if they are moved to the true floor. `settled_images`: those
        from the first on which, and on all later ones of which, the floor is right; `settled_right`: fraction of
        them that is right, None if there are none.
    """
    right, settled = is_right(poses, truth), once_on_floor(poses, truth, floor_height_m)
    return {
        "but_for_it": float(np.mean(is_right(on_true_floor(poses, truth, floor_height_m), truth))),
        "settled_images": int(settled.sum()),
        "settled_right": float(np.mean(right[settled])) if settled.any() else None,
    }
