"""Errors of verified poses: training images are localized without those taken near them in time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float64, Int64

from filtering.measurement_noise import MeasurementNoise
from filtering.se3 import Poses
from vapor.calibration.error_correlation import (
    LEAST_IMAGES,
    LEAST_PAIRS,
    ErrorCorrelation,
    Travel,
    along_map,
    best_decay,
    effective_images,
    pairs_of_images,
)
from vapor.checkpoints.scene_scale import spaced
from vapor.landmarks.build import Advance, BuiltMap, Material
from vapor.landmarks.localize import LandmarkLocalizer, VerifiedPose
from vapor.landmarks.tracks import view_change

_FOLDS = 5
_STRETCHES = 16.0, 8.0, 4.0, 2.0, 1.0  # lengths of hidden stretches that are tried: 1 is half a depth, or 25°
_END = 0.25  # fraction of a stretch at either end whose images are not localized
_ENOUGH = 0.5  # least fraction of verified images: else shorter stretches are hidden
_IMAGES, _TRIED = 200, 40  # localized images, and images by which the length of stretches is chosen
_DEPTH_RAD = 2.0 * np.deg2rad(25.0)  # a turn that changes the view as much as a depth moved
_LENGTHS, _USUAL_LENGTH = np.geomspace(0.05, 3.0, 13), 0.4  # correlation lengths of errors, in depths
_LEAST_CORRELATED, _MOST_CORRELATED = 0.5, 0.95  # of the variance
_NONE_RIGHT = 0.05  # outlier probability before held-out images are seen
_HELD = 0.9  # the region of this probability holds at least this fraction of the true poses
_RIGHT = 0.5, 0.35  # depths and radians, beyond which a pose is of another place


@dataclass(frozen=True)
class LeaveOut:
    """Training images, localized by a map without the images near them in time.

    Attributes:
        travel: Motion between the images, which are in order of time.
        found: Verified poses of each image.
        truth: True poses, (n,).
        view_distance: Distance of each from the most similar view of the map, see `MappedViews.distances`.
        depth_m: Median distance of the scene, metres.
    """

    travel: Travel
    found: tuple[tuple[VerifiedPose, ...], ...]
    truth: Poses
    view_distance: Float64[np.ndarray, " n"]
    depth_m: float

    @cached_property
    def right(self) -> tuple[tuple[int, VerifiedPose], ...]:
        """Rows of the images with a verified pose of the right place, and the nearest such pose of each."""
        rows = []
        for row, found in enumerate(self.found):
            if found:
                metres = Poses.stack([each.world_from_camera for each in found]).distance(self.truth[row])[0]
                nearest = found[int(np.argmin(metres))]
                if self._is_right(nearest, row):
                    rows.append((row, nearest))
        return tuple(rows)

    @property
    def verified(self) -> float:
        """Fraction of the images with a verified pose of the right place."""
        return len(self.right) / max(len(self.found), 1)

    @property
    def alike(self) -> Bool[np.ndarray, " n"]:
        """Mask of the images with a verified pose of another place, (n,)."""
        wrong = [not all(self._is_right(each, row) for each in found) for row, found in enumerate(self.found)]
        return np.array(wrong, bool)

    @property
    def elsewhere(self) -> float:
        """Fraction of the images whose verified pose of most landmarks is of another place."""
        wrong = [found for row, found in enumerate(self.found) if found and not self._is_right(found[0], row)]
        return len(wrong) / max(len(self.found), 1)

    @property
    def errors(self) -> tuple[Float64[np.ndarray, " k"], Float64[np.ndarray, " k"]]:
        """Errors of the poses in `right`: metres and radians."""
        if not self.right:
            return np.empty(0), np.empty(0)
        poses = Poses.stack([pose.world_from_camera for _, pose in self.right])
        return poses.distance(self.truth[np.array([row for row, _ in self.right])])

    def _is_right(self, found: VerifiedPose, row: int) -> bool:
        metres, radians = found.world_from_camera.distance(self.truth[row])
        return bool(metres < _RIGHT[0] * self.depth_m and radians < _RIGHT[1])


def leave_out(
    built: BuiltMap,
    *,
    most: int = _IMAGES,
    stretches: Sequence[float] = _STRETCHES,
    advance: Advance = lambda done, total: None,
) -> LeaveOut:
    """Localize `most` training images, evenly spaced, without the images near them in time.

    The longest stretches are hidden with which half of the images still verify the right place: in use, all landmarks
    were seen at another time.

    Args:
        built: The map of all images.
        most: Number of localized images.
        stretches: Lengths of hidden stretches, longest first: 1 is half a depth, or 25°.
        advance: Called with the number of images done, and of all.
    """
    stretch = middle = np.arange(len(built.material.truth))
    for length in stretches:
        stretch, in_middle = _stretches(built.material, length)
        middle = np.flatnonzero(in_middle)
        if length == stretches[-1]:
            break
        some = middle[spaced(len(middle), _TRIED)]
        if _without(built, stretch, some, lambda done, total: None).verified >= _ENOUGH:
            break
    return _without(built, stretch, middle[spaced(len(middle), most)], advance)


def _without(
    built: BuiltMap, stretch: Int64[np.ndarray, " n"], chosen: Int64[np.ndarray, " k"], advance: Advance
) -> LeaveOut:
    material, found = built.material, dict[int, tuple[VerifiedPose, ...]]()
    distance = np.zeros(len(material.truth))
    for fold in range(_FOLDS):
        own = chosen[stretch[chosen] % _FOLDS == fold]
        hidden = stretch[material.key] % _FOLDS == fold
        if not len(own) or hidden.all():
            continue
        localizer = LandmarkLocalizer(built.hiding(hidden))
        distance[own] = localizer.mapped().distances(material.truth[own])
        for image in own.tolist():
            found[image] = tuple(localizer.localize(localizer.described(material.query(image))))
            advance(len(found), len(chosen))
    image = np.array(sorted(found), np.int64)
    travel = Travel.along(material.truth, material.sequence)[image]
    of_images = tuple(found[i] for i in image.tolist())
    return LeaveOut(travel, of_images, material.truth[image], distance[image], material.depth_m)


def _stretches(material: Material, length: float) -> tuple[Int64[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
    """Number of the stretch of each image, over which the view changes by `length`, and the mask of middle images."""
    sequence = material.sequence
    change = np.cumsum(view_change(material.truth, material.depth_m))
    begins = np.flatnonzero(np.diff(sequence, prepend=sequence[:1] - 1))
    first = begins[np.searchsorted(begins, np.arange(len(sequence)), side="right") - 1]
    since = (change - change[first]) / length
    within = np.floor(since).astype(np.int64)
    _, number = np.unique(np.stack([first, within], axis=1), axis=0, return_inverse=True)
    part = since - within
    middle = (part >= _END) & (part <= 1.0 - _END)
    return number.reshape(-1).astype(np.int64), middle if middle.any() else np.ones(len(sequence), bool)


@dataclass(frozen=True)
class VerifiedErrors:
    """Errors of verified poses in the camera's frame.

    `elsewhere` is `LeaveOut.elsewhere`. Medians are of poses of the right place. `coverage` is of the 50, 90 and 95 %
    regions.
    """

    noise: MeasurementNoise
    images: int
    effective_images: float
    elsewhere: float
    median_m: float
    median_rad: float
    coverage: tuple[float, float, float]


def fit_verified_errors(left_out: LeaveOut, log_clutter_density: float) -> VerifiedErrors | None:
    """Errors of the poses of the right place; None where there are too few.

    `log_clutter_density` is of poses spread evenly over the map, per m³ rad³.
    """
    # Only fits need torch; `leave_out` is part of every inspection.
    from vapor.calibration.image_errors import cautious, most_likely_errors
    from vapor.calibration.places import Places

    rows, depth_m = left_out.right, left_out.depth_m
    if len(rows) < LEAST_IMAGES:
        return None
    which = np.array([row for row, _ in rows])
    truth = left_out.truth[which]
    residual = Poses.stack([pose.world_from_camera for _, pose in rows]).between(truth).log()
    covariance = np.stack([pose.covariance for _, pose in rows])
    places = Places(residual, covariance, np.ones(len(rows)), np.arange(len(rows)))
    found = most_likely_errors(places, depth_m, log_clutter_density, None)
    noise = replace(MeasurementNoise(log_clutter_density=log_clutter_density), **found.settings(depth_m))
    residuals, usable = places.residuals(noise)
    residuals = along_map(residuals, truth)
    travel = left_out.travel[which]
    correlated = _error_correlation(residuals, usable, travel, depth_m)
    effective = effective_images(travel, correlated)
    noise = cautious(noise, effective)
    # Up to half of the images may look like outliers of the likeliest errors, but all of these places are right.
    noise = noise.inflated(places.lacking(noise, _HELD))
    noise = replace(
        noise,
        outlier_probability=_NONE_RIGHT,
        correlated_fraction=correlated.fraction,
        length_m=correlated.length_m,
        length_rad=correlated.length_rad,
        typical_std=places.typical_std(noise),
    )
    metres, radians = (float(np.median(each)) for each in left_out.errors)
    return VerifiedErrors(noise, len(rows), effective, left_out.elsewhere, metres, radians, places.coverage(noise))


def _error_correlation(
    residual: Float64[np.ndarray, "n 6"], usable: Bool[np.ndarray, " n"], travel: Travel, depth_m: float
) -> ErrorCorrelation:
    unit = ErrorCorrelation(1.0, depth_m, _DEPTH_RAD)
    first, second = pairs_of_images(travel, usable)
    if len(first) < LEAST_PAIRS:
        return ErrorCorrelation(_MOST_CORRELATED, _USUAL_LENGTH * depth_m, _USUAL_LENGTH * _DEPTH_RAD)
    apart = unit.between(travel, first, second)
    products = np.vecdot(residual[first], residual[second]) / max(float(np.square(residual).sum(axis=1).mean()), 1e-300)
    weights = 1.0 / (second - first)  # neighbours as much as all that are ten times as far from each other
    length, fraction = best_decay(apart, products, weights, _LENGTHS, (_LEAST_CORRELATED, _MOST_CORRELATED))
    return ErrorCorrelation(fraction, length * depth_m, length * _DEPTH_RAD)
