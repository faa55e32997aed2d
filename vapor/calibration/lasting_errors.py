"""How long errors last as the camera moves on, and so how many independent images the data are worth."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float64

from vapor.calibration.travel import LEAST_PAIRS, Travel, pairs_of_images
from vapor.checkpoints.scene_scale import LENGTH_RAD

_LENGTHS = np.geomspace(0.003, 0.15, 10)  # over which errors last, in extents
_LENGTHS_RAD = (0.2, 0.4, 0.8, 1.6)
_CLEARLY = 1.01  # by this factor another angle must make the squares smaller to be taken for the ordinary one
_FRACTIONS = (0.5, 0.7)  # of the variance, that last
_LEAST_IN_BIN, _LEAST_EFFECTIVE = 10, 30
_BINS = np.append(0.0, np.geomspace(0.05, 1e4, 72))  # of pairs of images, by how many lengths they are apart
_WINDOW, _LEAST_CORRELATION = 4.0, 0.1


@dataclass(frozen=True)
class LastingErrors:
    """How long errors last.

    Attributes:
        fraction: Of their variance, that lasts while the view stays the same.
        length_m: Over which that fades to 1/e, metres.
        length_rad: Likewise, radians.
    """

    fraction: float
    length_m: float
    length_rad: float

    def lengths(
        self, metres: Float64[np.ndarray, " k"], radians: Float64[np.ndarray, " k"]
    ) -> Float64[np.ndarray, " k"]:
        """How many lengths the camera came that travelled so far and turned by so much."""
        return np.hypot(metres / self.length_m, radians / self.length_rad)


def lasting_errors(
    residual: Float64[np.ndarray, "n 6"],
    usable: Bool[np.ndarray, " n"],
    travel: Travel,
    extent: float,
) -> LastingErrors:
    """How long errors last, by the correlation of their directions as the camera moves on.

    Least squares give the fraction that lasts, and how many metres change a view as much as how many radians. Of two
    errors, one that fades soon and one that does not, they see the larger only; but how many images are worth as much
    as independent ones depends on the sum of all correlations. So the lengths are matched to that sum where there are
    enough images.

    Args:
        residual: Errors in standard deviations, (n, 6).
        usable: Which of the images say anything of their errors, (n,).
        travel: Of the camera, between the images.
        extent: Of the scene, metres: lengths are searched for in proportion to it.
    """
    # Of their directions: images err more in one part of the scene than in another, which is not an error that lasts.
    direction = residual / np.maximum(np.linalg.norm(residual, axis=1, keepdims=True), 1e-300)
    first, second = pairs_of_images(travel, usable)
    if len(first) < LEAST_PAIRS:
        return LastingErrors(_FRACTIONS[1], _LENGTHS[len(_LENGTHS) // 2] * extent, LENGTH_RAD)
    metres, radians = travel.metres[second] - travel.metres[first], travel.radians[second] - travel.radians[first]
    products = (direction[second] * direction[first]).sum(axis=1)
    weights = 1.0 / (second - first)  # neighbours as much as all that are ten times as far from each other

    def least_squares(length_rad: float) -> tuple[float, LastingErrors]:
        best, found = np.inf, LastingErrors(_FRACTIONS[1], extent, length_rad)
        for length_m in _LENGTHS * extent:
            tried = LastingErrors(1.0, float(length_m), length_rad)
            kernel = np.exp(-tried.lengths(metres, radians))
            weight = max(float((weights * np.square(kernel)).sum()), 1e-300)
            fraction = float(np.clip((weights * kernel * products).sum() / weight, 0.0, 1.0))
            cost = float((weights * np.square(products - fraction * kernel)).sum())
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
    longer = _correlation_length(found.lengths(metres, radians), products) / found.fraction
    longer = float(np.clip(longer, _LENGTHS[0] * extent / found.length_m, _LENGTHS[-1] * extent / found.length_m))
    length_rad = min(longer * found.length_rad, _LENGTHS_RAD[-1]) if turns else found.length_rad
    return replace(found, length_m=longer * found.length_m, length_rad=length_rad)


def _correlation_length(lengths: Float64[np.ndarray, " k"], products: Float64[np.ndarray, " k"]) -> float:
    """Integral of the correlation over the distance between images, from products of pairs so many lengths apart.

    It ends at a few times the length over which the correlation is seen to fade (Sokal's window), as beyond that there
    is noise only, or where there are no more pairs.
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


def effective_images(travel: Travel, lasting: LastingErrors) -> float:
    """How many independent images are worth as much: one a pass and one for every two lengths; at most all that are."""
    steps = lasting.lengths(np.diff(travel.metres), np.diff(travel.radians))
    return 1.0 + float(np.where(np.diff(travel.pass_number) == 0, np.minimum(steps / 2.0, 1.0), 1.0).sum())
