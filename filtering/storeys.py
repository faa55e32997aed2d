"""Storeys of a building: which one a pose is on, and how a belief is spread over them."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float64, Int64

from filtering.errors import VaporTrackError
from filtering.estimate import Estimate
from filtering.se3 import Poses

_LEAST_APART_M, _MOST_APART_M = 1.8, 8.0  # less is no storey; a higher one is cut no lower than this
_LEAST_ABOVE = 0.02  # of the cells of a plan must have something above them
_BINS = 12  # of the histogram of heights, a storey
_CELL_M, _MOST_CELLS = 0.5, 50  # of a plan: side of a cell, and how many there are along its longer side at most
_ON_STOREY = 0.1  # of a storey: where the median position is further from a storey, most are on stairs
_TAILS = (0.005, 0.995)  # quantiles of heights: samples of a network may lie anywhere
_UPWARD = 0.2  # how much rather z is taken for up than another axis


@dataclass(frozen=True)
class Storeys:
    """The storeys of a building by their heights; stairs belong to the storey on their side of a cut.

    Attributes:
        heights_m: Of cameras on each storey, along `up`, metres, from the lowest storey up, (f,).
        up: Unit vector in the world.
        cuts_m: Heights between one storey and the next, (f - 1,); empty for halfway.

    Example:
        >>> import vapor
        >>> storeys = vapor.Storeys(heights_m=(1.6, 4.6, 7.6))
        >>> storeys.of(vapor.Poses.from_quat_xyzw([[0, 0, 1.5], [0, 0, 5.0]], [[0, 0, 0, 1], [0, 0, 0, 1]]))
        array([0, 1])
    """

    heights_m: tuple[float, ...]
    up: tuple[float, float, float] = (0.0, 0.0, 1.0)
    cuts_m: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if not self.heights_m or not np.isfinite(self.heights_m).all() or (np.diff(self.heights_m) <= 0.0).any():
            raise VaporTrackError(f"heights_m are {self.heights_m}, expected at least one, finite, from the lowest up")
        if not self.cuts_m:
            halfway = np.array(self.heights_m[1:]) / 2.0 + np.array(self.heights_m[:-1]) / 2.0
            object.__setattr__(self, "cuts_m", tuple(halfway.tolist()))
        if len(self.cuts_m) != len(self.heights_m) - 1 or not all(
            low <= cut <= high for (low, high), cut in zip(pairwise(self.heights_m), self.cuts_m, strict=True)
        ):
            raise VaporTrackError(f"cuts_m are {self.cuts_m}, expected one between every two of {self.heights_m}")
        if not abs(float(np.linalg.norm(self.up)) - 1.0) <= 1e-6:  # NaN compares as false
            raise VaporTrackError(f"up is {self.up}, expected a unit vector")

    @staticmethod
    def found_in(poses: Poses) -> Storeys | None:
        """The storeys that poses lie on, such as those of training images; None where there is one only.

        Storeys are where poses lie above each other by 1.8 m and more, see `find_storeys`; up is an axis of the world.
        Where most poses are between storeys, as on stairs, all storeys are as high as most, from the lowest pose up,
        and cut where the fewest poses are: not at a half landing.

        Args:
            poses: world_from_camera, batch (n,), lengths in metres.
        """
        if len(poses) == 0:
            return None
        up = up_axis(poses)
        heights_m, plan = poses.translation @ up, poses.translation[:, up == 0.0]
        plan = plan - plan.min(axis=0)
        cells = np.floor(plan / max(_CELL_M, float(plan.max()) / _MOST_CELLS)).astype(np.int64)
        cells = cells[:, 0] * (cells[:, 1].max() + 1) + cells[:, 1]
        label, count = find_storeys(heights_m, cells)
        if count == 1:
            return None
        on_it = [heights_m[label == number] for number in range(count)]
        found_m = np.array([np.median(each) for each in on_it])
        cuts_m = np.array([(below.max() + above.min()) / 2.0 for below, above in pairwise(on_it)])
        apart_m = float(np.median(_apart(heights_m, cells)))
        if np.median(np.abs(heights_m - found_m[label])) > _ON_STOREY * apart_m:
            low_m, high_m = np.quantile(heights_m, _TAILS)
            found_m = low_m + apart_m * np.arange(round((high_m - low_m) / apart_m) + 1)
            cuts_m = found_m[:-1] + apart_m * _emptiest((heights_m - low_m) / apart_m, cells)
        x, y, z = up.tolist()
        heights, cuts = (tuple(np.round(each, 3).tolist()) for each in (found_m, cuts_m))
        return None if len(found_m) < 2 else Storeys(heights, (x, y, z), cuts)

    def of(self, poses: Poses) -> Int64[np.ndarray, "*n"]:
        """The storey of each pose (any batch), from 0 for the lowest."""
        return np.searchsorted(self.cuts_m, poses.translation @ np.array(self.up)).astype(np.int64)

    def belief(self, estimate: Estimate) -> Float64[np.ndarray, " f"]:
        """How much of a belief is on each storey: the weights of its particles, 1 in all."""
        weights = np.exp(estimate.log_weights)
        return np.bincount(self.of(estimate.particles), weights, minlength=len(self.heights_m)) / weights.sum()


def up_axis(poses: Poses) -> Float64[np.ndarray, "3"]:
    """The axis of the world, there or back, that is up in most of the images of cameras (n,); z where it is unclear."""
    right, up = poses.rotation[:, :, 0], -poses.rotation[:, :, 1]
    signed = np.concatenate([np.eye(3), -np.eye(3)])
    upright = (up @ signed.T).mean(axis=0) - np.abs(right @ signed.T).mean(axis=0)
    return signed[int(np.argmax(upright + _UPWARD * (np.arange(6) == 2)))] + 0.0


def _apart(heights_m: Float64[np.ndarray, " n"], cells: Int64[np.ndarray, " n"]) -> Float64[np.ndarray, " k"]:
    """How far apart what lies above each other in a cell is, with nothing between, middle to middle, metres."""
    order = np.lexsort((heights_m, cells))
    heights_m, cells = heights_m[order], cells[order]
    other = (np.diff(cells) != 0) | (np.diff(heights_m) >= _LEAST_APART_M)
    group = np.concatenate([[0], np.cumsum(other)])
    middle_m = np.bincount(group, heights_m) / np.bincount(group)
    return np.diff(middle_m)[np.diff(cells)[other] == 0]


def _emptiest(storeys: Float64[np.ndarray, " n"], cells: Int64[np.ndarray, " n"]) -> float:
    """The fraction of a storey at which the fewest cells have a position, all storeys taken together."""
    bins = np.floor(storeys % 1.0 * 2 * _BINS).astype(np.int64) % (2 * _BINS)
    counts = np.bincount(np.unique(np.column_stack([bins, cells]), axis=0)[:, 0], minlength=2 * _BINS)
    smooth = counts + (np.roll(counts, 1) + np.roll(counts, -1)) / 2.0
    between = slice(_BINS // 3, -(_BINS // 3))  # not at the storeys themselves
    return (_BINS // 3 + int(np.argmin(smooth[between])) + 0.5) / (2 * _BINS)


def find_storeys(
    heights_m: Float64[np.ndarray, " n"], cells: Int64[np.ndarray, " n"]
) -> tuple[Int64[np.ndarray, " n"], int]:
    """Which storey each of n positions is on, from 0 at the bottom, and how many storeys there are.

    Storeys are where positions lie above each other by 1.8 m and more; they are cut where the fewest positions are.
    Stairs go to the storey that is nearer.

    Args:
        heights_m: Heights of the positions, metres.
        cells: Number of the cell of the plan that each is in.
    """
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
    peaks = peaks_of(smooth, apart=round(0.7 * _BINS))
    if len(peaks) < 2:
        return one
    cuts = []
    for low_bin, high_bin in pairwise(peaks.tolist()):
        between = smooth[low_bin:high_bin]
        cuts.append(low_bin + int(np.median(np.flatnonzero(between <= between.min() + 0.05 * between.max()))))
    storey = np.searchsorted(cuts, bins, side="left")
    return np.unique(storey, return_inverse=True)[1].astype(np.int64), len(np.unique(storey))


def peaks_of(values: Float64[np.ndarray, " n"], apart: int) -> Int64[np.ndarray, " p"]:
    """Where values above 0 are higher than on both sides, without what is nearer than `apart` to a higher peak.

    The same as `scipy.signal.find_peaks(values, distance=apart)` with zeros put around the values; but importing
    `scipy.signal` loads SciPy's statistics as well, which takes half a second.

    Args:
        values: At least one.
        apart: Least distance of two peaks, in indices.

    Returns:
        Indices in order; of equal values in a row the middle.
    """
    begins = np.concatenate([[0], np.flatnonzero(np.diff(values)) + 1])
    ends = np.concatenate([begins[1:], [len(values)]]) - 1
    runs = np.concatenate([[0.0], values[begins], [0.0]])
    peaks = ((begins + ends) // 2)[(runs[1:-1] > runs[:-2]) & (runs[1:-1] > runs[2:])]
    kept: list[int] = []
    for peak in peaks[np.argsort(values[peaks])[::-1]].tolist():
        if all(abs(peak - other) >= apart for other in kept):
            kept.append(peak)
    return np.array(sorted(kept), dtype=np.int64)
