"""Correlation of errors, and of mistakes about the place, along the path of the camera."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float64, Int64

from filtering.se3 import Poses
from vapor.checkpoints.scene_scale import LENGTH_RAD

LEAST_IMAGES = 20
"""Least number of images for a fit of their errors."""
LEAST_PAIRS = 50
"""Least number of pairs of images for a fit of a correlation."""
_MOST_PAIRS = 10**6
_LENGTHS = np.geomspace(0.003, 0.15, 10)  # correlation lengths that are tried, in extents
_LENGTHS_RAD = (0.2, 0.4, 0.8, 1.6)
_CLEARLY = 1.01  # factor by which an angle must reduce the squares to replace the ordinary one
_FRACTIONS = (0.5, 0.7)  # range of the correlated fraction of the variance
_LEAST_IN_BIN, _LEAST_EFFECTIVE = 10, 30
_BINS = np.append(0.0, np.geomspace(0.05, 1e4, 72))  # edges of bins of pairs of images, by their distance in lengths
_WINDOW, _LEAST_CORRELATION = 4.0, 0.1
_NO_MISTAKE = 0.02  # least fraction of images that find the true place less likely than not
_MISTAKEN = np.geomspace(0.125, 32.0, 17)  # correlation lengths of mistakes that are tried, in lengths
_FARTHEST_LENGTHS, _LEAST_VOTE, _LEAST_MISTAKEN, _MOST_MISTAKEN = 100.0, 0.25, 4.0, 40.0
_ANOTHER_HOUR = 3.0  # factor of the excess over one length where the light differs from the held-out passes


@dataclass(frozen=True)
class Travel:
    """Distance of n images from the first image of their pass, metres and radians; images of one pass lie together."""

    pass_number: Int64[np.ndarray, " n"]
    metres: Float64[np.ndarray, " n"]
    radians: Float64[np.ndarray, " n"]

    @staticmethod
    def along(poses: Poses, pass_number: Int64[np.ndarray, " n"]) -> Travel:
        """The distances along poses (n,) of numbered passes, each in order of time."""
        begins = np.diff(pass_number, prepend=pass_number[:1] - 1) != 0
        steps = poses[:-1].distance(poses[1:])
        metres, radians = (np.cumsum(np.append(0.0, step)) for step in steps)
        first = np.flatnonzero(begins)[np.cumsum(begins) - 1]
        return Travel(pass_number, metres - metres[first], radians - radians[first])

    def __getitem__(self, indices: Int64[np.ndarray, " k"]) -> Travel:
        return Travel(self.pass_number[indices], self.metres[indices], self.radians[indices])


def pairs_of_images(
    travel: Travel, usable: Bool[np.ndarray, " n"]
) -> tuple[Int64[np.ndarray, " k"], Int64[np.ndarray, " k"]]:
    """Indices of the earlier and the later image of k pairs of usable images of one pass.

    Where there are too many pairs, the most distant ones are left out.
    """
    firsts, seconds = [np.empty(0, np.int64)], [np.empty(0, np.int64)]
    for lag in range(1, min(len(usable), _MOST_PAIRS // max(len(usable), 1) + 1)):
        first = np.flatnonzero((travel.pass_number[lag:] == travel.pass_number[:-lag]) & usable[lag:] & usable[:-lag])
        firsts.append(first)
        seconds.append(first + lag)
    return np.concatenate(firsts), np.concatenate(seconds)


@dataclass(frozen=True)
class ErrorCorrelation:
    """Correlated fraction of the variance of errors, and the lengths over which the correlation falls to 1/e."""

    fraction: float
    length_m: float
    length_rad: float

    def between(
        self, travel: Travel, first: slice | Int64[np.ndarray, " k"], second: slice | Int64[np.ndarray, " k"]
    ) -> Float64[np.ndarray, " k"]:
        """Distances between pairs of images, in lengths."""
        metres, radians = travel.metres[second] - travel.metres[first], travel.radians[second] - travel.radians[first]
        return np.hypot(metres / self.length_m, radians / self.length_rad)


def fit_decay(
    lengths: Float64[np.ndarray, " k"],
    products: Float64[np.ndarray, " k"],
    weights: Float64[np.ndarray, " k"] | float,
    limits: tuple[float, float] = (0.0, 1.0),
) -> tuple[float, float]:
    """Best fit of fraction · exp(−lengths) to the products of pairs: sum of squares, and fraction."""
    kernel = np.exp(-lengths)
    weight = max(float((weights * np.square(kernel)).sum()), 1e-300)
    fraction = float(np.clip((weights * kernel * products).sum() / weight, *limits))
    return float((weights * np.square(products - fraction * kernel)).sum()), fraction


def best_decay(
    apart: Float64[np.ndarray, " k"],
    products: Float64[np.ndarray, " k"],
    weights: Float64[np.ndarray, " k"] | float,
    lengths: Float64[np.ndarray, " l"],
    limits: tuple[float, float] = (0.0, 1.0),
) -> tuple[float, float]:
    """The length, and the fraction, of the best fit of fraction · exp(−apart / length) to products of pairs."""
    costs, fractions = zip(*(fit_decay(apart / length, products, weights, limits) for length in lengths), strict=True)
    best = int(np.argmin(costs))
    return float(lengths[best]), fractions[best]


def fit_error_correlation(
    residual: Float64[np.ndarray, "n 6"],
    usable: Bool[np.ndarray, " n"],
    travel: Travel,
    extent: float,
) -> ErrorCorrelation:
    """The correlation of the directions of errors (n, 6), in standard deviations, along the path of the camera.

    Least squares give the correlated fraction, and the ratio of metres to radians. Where errors have two correlation
    lengths, least squares find only the larger one, but the number of effective images depends on the sum of all
    correlations. So the lengths are matched to that sum, where there are enough images. Their unit is `extent`, metres.
    """
    # Directions only: errors are larger in one part of the scene than in another, which is no correlation.
    direction = residual / np.maximum(np.linalg.norm(residual, axis=1, keepdims=True), 1e-300)
    first, second = pairs_of_images(travel, usable)
    if len(first) < LEAST_PAIRS:
        return ErrorCorrelation(_FRACTIONS[1], _LENGTHS[len(_LENGTHS) // 2] * extent, LENGTH_RAD)
    products = (direction[second] * direction[first]).sum(axis=1)
    weights = 1.0 / (second - first)  # neighbours as much as all that are ten times as far from each other

    def least_squares(length_rad: float) -> tuple[float, ErrorCorrelation]:
        best, found = np.inf, ErrorCorrelation(_FRACTIONS[1], extent, length_rad)
        for length_m in _LENGTHS * extent:
            tried = ErrorCorrelation(1.0, float(length_m), length_rad)
            cost, fraction = fit_decay(tried.between(travel, first, second), products, weights)
            if cost < best:
                best, found = cost, replace(tried, fraction=float(np.clip(fraction, *_FRACTIONS)))
        return best, found

    ordinary, found = least_squares(LENGTH_RAD)
    if effective_images(travel, found) < _LEAST_EFFECTIVE:
        return found
    others = [least_squares(length_rad) for length_rad in _LENGTHS_RAD if length_rad != LENGTH_RAD]
    best, other = min(others, key=lambda each: each[0])
    if _CLEARLY * best < ordinary:
        found = other
    # Where the camera hardly turns, any angle fits as well.
    costs = [ordinary, *(cost for cost, _ in others)]
    turns = max(costs) > _CLEARLY * min(costs)
    longer = _correlation_length(found.between(travel, first, second), products) / found.fraction
    longer = float(np.clip(longer, _LENGTHS[0] * extent / found.length_m, _LENGTHS[-1] * extent / found.length_m))
    length_rad = min(longer * found.length_rad, _LENGTHS_RAD[-1]) if turns else found.length_rad
    return replace(found, length_m=longer * found.length_m, length_rad=length_rad)


def _correlation_length(lengths: Float64[np.ndarray, " k"], products: Float64[np.ndarray, " k"]) -> float:
    """Integral of the correlation over the distance between images, from products of pairs.

    It ends at a few correlation lengths (Sokal's window), or with the last pairs.
    """
    bins = np.searchsorted(_BINS, lengths, side="right") - 1
    count = np.bincount(bins, minlength=len(_BINS))
    mean = np.bincount(bins, products, minlength=len(_BINS)) / np.maximum(count, 1)
    enough = np.flatnonzero(count[:-1] >= _LEAST_IN_BIN)
    if len(enough) == 0:
        return 1.0
    nearest = max(float(mean[enough[0]]), _LEAST_CORRELATION)
    integral, correlation = 0.0, nearest
    for k in range(enough[-1] + 1):
        correlation = float(mean[k]) if count[k] >= _LEAST_IN_BIN else correlation
        integral += correlation * float(_BINS[k + 1] - _BINS[k])
        if nearest * _BINS[k + 1] >= _WINDOW * integral:
            break
    return integral


def along_map(residual: Float64[np.ndarray, "n 6"], poses: Poses) -> Float64[np.ndarray, "n 6"]:
    """Errors (n, 6) in the tangent at poses (n,) with their positions along the axes of the map, as they are correlated
    (`filtering.hypotheses.along_map`)."""
    return np.hstack([np.einsum("nij,nj->ni", poses.rotation, residual[:, :3]), residual[:, 3:]])


def effective_images(travel: Travel, correlated: ErrorCorrelation) -> float:
    """Number of independent images with the same information: one a pass and one for every two lengths, at most all."""
    steps = correlated.between(travel, slice(None, -1), slice(1, None))
    return 1.0 + float(np.where(np.diff(travel.pass_number) == 0, np.minimum(steps / 2.0, 1.0), 1.0).sum())


def outlier_lengths(
    evidence: Float64[np.ndarray, " n"], travel: Travel, correlated: ErrorCorrelation, *, same_conditions: bool = False
) -> float:
    """The distance over which images are one vote on the place, in lengths of errors; 1 where no image is mistaken.

    The correlation of the evidence (`PlaceWeights.evidence`) of two images of a pass falls with the distance between
    them. The weight of a vote follows from the sum of an image's correlations; uncorrelated evidence counts once a
    length.
    Under other conditions than on held-out passes mistakes last longer (three to five times in two synthetic buildings
    at another hour), so the excess over one length is tripled, unless `same_conditions`.
    """
    if len(evidence) < LEAST_PAIRS or (evidence < np.log(0.5)).mean() < _NO_MISTAKE:
        return 1.0
    value = (evidence - evidence.mean()) / evidence.std()
    first, second = pairs_of_images(travel, np.ones(len(value), bool))
    steps = correlated.between(travel, slice(None, -1), slice(1, None))[np.diff(travel.pass_number) == 0]
    apart = correlated.between(travel, first, second)
    near = apart < _FARTHEST_LENGTHS
    apart, products = apart[near], (value[first] * value[second])[near]
    if len(products) < LEAST_PAIRS:
        return 1.0
    lengths, fraction = best_decay(apart, products, 1.0, _MISTAKEN)
    vote = (1.0 - fraction) * min(float(np.median(steps)), 1.0) + 2.0 * fraction * lengths
    if same_conditions:
        return float(np.clip(vote, _LEAST_VOTE, _MOST_MISTAKEN))
    return float(np.clip(1.0 + _ANOTHER_HOUR * (vote - 1.0), _LEAST_MISTAKEN, _MOST_MISTAKEN))
