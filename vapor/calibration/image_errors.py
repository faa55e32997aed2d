"""Errors of a network's posteriors, by maximum likelihood on held-out images."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float64
from torch import Tensor

from filtering.measurement_noise import LEAST_SCORE, OUT_OF_DISTRIBUTION, MeasurementNoise, Six
from filtering.se3 import Poses
from filtering.training_prior import TrainingPrior
from sequences.odometry_fit.result import six
from vapor.calibration.error_correlation import (
    ErrorCorrelation,
    Travel,
    along_map,
    effective_images,
    fit_error_correlation,
    outlier_lengths,
)
from vapor.calibration.place_weights import PlaceWeights
from vapor.calibration.places import Observations, Places, log_densities, log_sums
from vapor.checkpoints.scene_scale import RADIUS_RAD, log_clutter_density, scene_extent
from vapor.evaluation.reliability import Reliability

_STARTS = (0.003, 0.02, 0.1, 0.3)  # initial noise floors, in extents
_TRIES, _STEPS = 12, 80  # steps of the optimiser, from every start and from the best
_LOG_SPREAD, _LOG_NOISE_FLOOR, _LOG_DEGREES_OF_FREEDOM, _LOGIT_OUTLIERS = (
    (-5.0, 4.0),
    (-9.0, 0.0),
    (0.7, 4.0),
    (-5.0, 0.0),
)
_LIMITS = (_LOG_SPREAD, *[_LOG_NOISE_FLOOR] * 6, _LOGIT_OUTLIERS, _LOG_DEGREES_OF_FREEDOM)
_PULL, _PULLED_TO = 1e-4, np.log(0.02)  # weak prior of the noise floor's logarithms, decisive without data
_POWERS = np.linspace(0.0, 1.5, 13)  # powers of the score that are tried
_ALONG_A_WALK = 0.4  # of the power of weights of single images: a preference lasts for longer than mistakes show
LEAST_OUTLIERS = 0.05
"""Least probability of outliers: errors of neighbouring images are correlated, so 500 images cannot exclude them."""
_RADII = np.geomspace(0.01, 0.32, 6)  # radii of a place that are tried, in extents of the scene
_AS_GOOD = 0.1  # loss of likelihood, nats an image, that is accepted for a wider place
_ALIKE = 10.0  # weight of the assumption that all axes have equal errors, images
_UNSEEN = 2.0  # divided by the number of images: fraction of the variance that may be common to all
_UNSURE = 10.0  # divided by the number of images: fraction by which fitted variances are too small


@dataclass(frozen=True)
class Change:
    """Values of a fit before and after it, by the name of the setting; `gain` is in nats per held-out image."""

    what: str
    before: dict[str, float | Six]
    after: dict[str, float | Six]
    gain: float | None = None


@dataclass(frozen=True)
class FoundErrors:
    """The likeliest errors for one radius of a place.

    Attributes:
        score: Mean log likelihood, with the prior of the noise floor.
        parameters: Logarithms of spread and noise floor (in extents), logit of the outlier probability, and logarithm
            of the degrees of freedom, (9,).
    """

    score: float
    parameters: Tensor

    def settings(self, extent: float) -> dict[str, float | Six]:
        """Fields of the `MeasurementNoise`, for a scene of this extent in metres."""
        spread, noise_floor, outliers, degrees_of_freedom = (value.numpy() for value in _unpack(self.parameters))
        lengths = np.array([extent] * 3 + [1.0] * 3)
        return {
            "spread": float(spread),
            "noise_floor": six(noise_floor * lengths),
            "outlier_probability": float(1.0 / (1.0 + np.exp(-outliers))),
            "degrees_of_freedom": float(degrees_of_freedom),
        }


def _unpack(parameters: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    return (
        parameters[0].clamp(*_LOG_SPREAD).exp(),
        parameters[1:7].clamp(*_LOG_NOISE_FLOOR).exp(),
        parameters[7].clamp(*_LOGIT_OUTLIERS),
        parameters[8].clamp(*_LOG_DEGREES_OF_FREEDOM).exp(),
    )


def most_likely_errors(places: Places, extent: float, flat: float, also: Tensor | None) -> FoundErrors:
    """Spread, noise floor, degrees of freedom and outlier probability of highest likelihood.

    Args:
        places: Places of the images.
        extent: Extent of the scene, metres, the unit of lengths.
        flat: Log density of poses spread evenly over the scene, per m³ rad³.
        also: Parameters from which the search starts, too.
    """
    unit = np.array([extent] * 3 + [1.0] * 3)
    residual = torch.from_numpy(places.residual / unit)
    covariance = torch.from_numpy(places.covariance / (unit[:, None] * unit) + 1e-12 * np.eye(6))
    fraction, image = torch.from_numpy(places.fraction), torch.from_numpy(places.image)
    log_unit = 3.0 * np.log(extent)

    low, high = (torch.tensor(limits, dtype=torch.float64) for limits in zip(*_LIMITS, strict=True))

    def loss(parameters: Tensor) -> tuple[float, Tensor]:
        """Negative mean log likelihood, with the prior of the noise floor, and its gradient."""
        spread, noise_floor, outliers, degrees_of_freedom = _unpack(parameters)
        terms, slopes = log_densities(residual, covariance, fraction, spread, noise_floor, degrees_of_freedom)
        log_places = log_sums(terms, image)
        out, right = torch.nn.functional.logsigmoid(outliers), torch.nn.functional.logsigmoid(-outliers)
        log_right = right + log_places - log_unit
        log_likelihood = torch.logaddexp(out + flat, log_right)
        by_right = (log_right - log_likelihood).exp()  # of each image: the chance that it is no outlier
        by_place = (terms - log_places[image]).exp() * by_right[image] / len(by_right)
        off = parameters[1:7] - _PULLED_TO
        gradient = torch.empty_like(parameters)
        gradient[[0, 1, 2, 3, 4, 5, 6, 8]] = -(by_place @ slopes)
        gradient[7] = by_right.mean() - right.exp()
        gradient[(parameters < low) | (parameters > high)] = 0.0
        gradient[1:7] += 2.0 * _PULL * off
        return float(_PULL * off.square().sum() - log_likelihood.mean()), gradient

    def search(start: Tensor, steps: int) -> tuple[float, Tensor]:
        parameters = start.clone().requires_grad_(True)
        optimiser = torch.optim.LBFGS(
            [parameters], max_iter=steps, line_search_fn="strong_wolfe", tolerance_grad=1e-4, tolerance_change=1e-7
        )

        def closure() -> float:
            value, parameters.grad = loss(parameters.detach())
            return value

        optimiser.step(closure)
        found = parameters.detach()
        value, _ = loss(found)
        return (value, found) if np.isfinite(value) and torch.isfinite(found).all() else (np.inf, start)

    starts = []
    for noise_floor in _STARTS:
        angle = min(max(noise_floor, 0.02), 0.2)
        logs = [0.0, *[np.log(noise_floor)] * 3, *[np.log(angle)] * 3, -2.5, 1.8]
        starts.append(torch.tensor(logs, dtype=torch.float64))
    ends = [search(start, _TRIES) for start in (starts if also is None else [*starts, also])]
    value, parameters = min(ends, key=lambda end: end[0])
    better, refined = search(parameters, _STEPS)
    return FoundErrors(-better, refined) if better < value else FoundErrors(-value, parameters)


def growing_errors(
    noise: MeasurementNoise,
    places: Places,
    score: Float64[np.ndarray, " n"],
    trained: Observations,
    trained_score: Float64[np.ndarray, " k"],
) -> MeasurementNoise:
    """The errors with growth by the power of the score that has the highest likelihood.

    Held-out images (n) and training images (k), which have lower scores, have the same total weight.
    """
    noise = replace(noise, typical_ood_score=ordinary_score(score))
    known = Places.near(trained.samples, trained.truth, noise.radius_m, noise.radius_rad)

    def likelihood(grown: MeasurementNoise) -> float:
        held_out = places.grown(grown, score).log_density(grown).mean()
        return float(held_out + known.grown(grown, trained_score).log_density(grown).mean())

    return max((replace(noise, ood_power=float(power)) for power in _POWERS), key=likelihood)


def ordinary_score(score: Float64[np.ndarray, " n"]) -> float:
    """The median score, at most the threshold of images out of distribution."""
    return float(np.clip(np.median(score), LEAST_SCORE, OUT_OF_DISTRIBUTION))


@dataclass(frozen=True)
class ErrorFit:
    """Fitted errors of posteriors, with the coverage of their 50, 90 and 95 % regions, the reliability of their best
    places, and what the log ratio of two weights of a single image is worth."""

    noise: MeasurementNoise
    changes: tuple[Change, ...]
    coverage: tuple[float, float, float]
    reliability: Reliability
    weight_power: float
    effective_images: float


def fit_errors(
    held_out: Observations,
    travel: Travel,
    scene: Poses,
    before: MeasurementNoise,
    *,
    trained: Observations | None = None,
    training_poses: Poses | None = None,
    same_conditions: bool = False,
) -> ErrorFit:
    """Fit the errors of the posteriors of n held-out images.

    Places, spread, noise floor, tails and outliers maximise the mean log likelihood

        log[ε flat + (1 − ε) Σₖ fractionₖ t(true pose; placeₖ, spread Cₖ + diag(noise_floor²), ν)].

    Of radii of places with nearly the same likelihood, the widest is taken. Growth with the OOD score is the power of
    highest likelihood. The correlation of errors follows from products of the normalised errors of two images, the
    correlation of mistakes from the evidence of two images for the true place. The fewer independent images, the more
    equal are the axes and the larger the variances.

    Args:
        held_out: Held-out images.
        travel: Motion between them.
        scene: Poses that outline the scene, the unit of all lengths.
        before: Errors before the fit, from which other fields are kept.
        trained: Training images, if errors may grow with the OOD score.
        training_poses: Poses of training images, evenly chosen, whose density is divided out of weights; None where it
            is even.
        same_conditions: Whether held-out images show the light and season of use.
    """
    extent = scene_extent(scene)
    flat = log_clutter_density(scene)
    radius, places, found = _widest_places(held_out, extent, flat)
    noise = replace(
        before,
        radius_m=radius,
        radius_rad=RADIUS_RAD,
        log_clutter_density=flat,
        **found.settings(extent),
    )
    if held_out.score is not None:
        if trained is not None and trained.score is not None:
            noise = growing_errors(noise, places, held_out.score, trained, trained.score)
        places = places.grown(noise, held_out.score)
        noise = replace(noise, **most_likely_errors(places, extent, flat, found.parameters).settings(extent))
    else:
        noise = replace(noise, ood_power=0.0)
    residual, usable = places.residuals(noise)
    residual = along_map(residual, held_out.truth)
    correlated = fit_error_correlation(residual, usable, travel, extent)
    effective = effective_images(travel, correlated)
    noise = cautious(noise, effective)
    noise = replace(
        noise,
        outlier_probability=max(noise.outlier_probability, LEAST_OUTLIERS),
        correlated_fraction=correlated.fraction,
        length_m=correlated.length_m,
        length_rad=correlated.length_rad,
        typical_std=places.typical_std(noise),
    )
    prior = None if training_poses is None else TrainingPrior(training_poses, radius, RADIUS_RAD)
    weights = PlaceWeights.of(held_out, noise, prior)

    def mistaken(noise: MeasurementNoise) -> float:
        return outlier_lengths(weights.evidence(noise), travel, correlated, same_conditions=same_conditions)

    longer = max(mistaken(replace(noise, weight_power=1.0)), 1.0)  # where weights do not count, no mistake shows
    votes = ErrorCorrelation(1.0, longer * correlated.length_m, longer * correlated.length_rad)
    worth = effective_images(travel, votes) / len(held_out.truth)
    power, _ = weights.fitted_power(noise, worth)
    noise = replace(noise, outlier_lengths=mistaken(noise), weight_power=_ALONG_A_WALK * power)
    places_before = Places.near(held_out.samples, held_out.truth, before.radius_m, before.radius_rad)
    if held_out.score is not None:
        places_before = places_before.grown(before, held_out.score)
    gain = float((places.log_density(noise) - places_before.log_density(before)).mean())
    fits = {
        "errors of an image": (
            "radius_m",
            "spread",
            "noise_floor",
            "degrees_of_freedom",
            "outlier_probability",
            "ood_power",
        ),
        "how long they last": ("correlated_fraction", "length_m", "length_rad", "outlier_lengths"),
    }
    changes = []
    for (what, names), gained in zip(fits.items(), (gain, None), strict=True):
        formerly, now = ({name: getattr(model, name) for name in names} for model in (before, noise))
        changes.append(Change(what, formerly, now, gained))
    return ErrorFit(noise, tuple(changes), places.coverage(noise), weights.reliability(noise, worth), power, effective)


def _widest_places(held_out: Observations, extent: float, flat: float) -> tuple[float, Places, FoundErrors]:
    """The widest radius of places with nearly the highest likelihood, these places, and their errors."""
    tried = []
    parameters = None
    for radius in _RADII * extent:
        places = Places.near(held_out.samples, held_out.truth, float(radius), RADIUS_RAD)
        found = most_likely_errors(places, extent, flat, parameters)
        parameters = found.parameters
        tried.append((float(radius), places, found))
    highest = max(found.score for _, _, found in tried)
    return next(entry for entry in reversed(tried) if entry[2].score >= highest - _AS_GOOD)


def cautious(noise: MeasurementNoise, effective: float) -> MeasurementNoise:
    """Larger errors and more equal axes, the fewer independent images there are.

    An error common to all images is not visible, so the constant fraction of the variance grows, too.
    """
    variances = np.square(noise.noise_floor).reshape(2, 3)
    variances = (effective * variances + _ALIKE * variances.mean(axis=1, keepdims=True)) / (effective + _ALIKE)
    larger = (effective + _UNSURE) / effective
    return replace(
        noise,
        spread=larger * noise.spread,
        noise_floor=six(np.sqrt(larger * variances).ravel()),
        constant_fraction=min(1.0, MeasurementNoise().constant_fraction + _UNSEEN / effective),
    )
