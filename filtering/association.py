"""Data association: which hypothesis sees which place of an image, its likelihood, and its correction.

Sources: Chen and Liu, "Mixture Kalman filters", 2000 (particles that carry Gaussians); Roth, Özkan and Gustafsson, "A
Student's t filter for heavy tailed process and measurement noise", 2013; Plummer, "Cuts in Bayesian graphical models",
2015 (the details of a place do not decide which place it is).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple, TypeVar, cast

import numpy as np
from jaxtyping import Bool, Float64, Int64

from filtering.hypotheses import POSE, RIGHT, Hypotheses, along_map, blocks, concatenate, correlated_error
from filtering.measurement import Measurement, PredictedMeasurement, kalman_update, predict_measurement
from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from filtering.unchecked import unchecked_replace

Of = TypeVar("Of")

_GATE = 36.0  # times the summed variances of position, and of rotation: a coarse gate before any Mahalanobis distance
_LEAST = 1e-3  # fraction of a hypothesis that goes on as one of its own; smaller ones go to its other parts
_DENSITY = 0.1  # power of the likelihoods of hypotheses at one place: errors of images last longer than modelled
_SAME_PLACE = 36.0  # squared Mahalanobis distance: hypotheses so near a place are at it
_LOG_WIDE = 6 * np.log(2.0)  # log volume: innovations twice as wide as the ordinary error, on all axes, are usual
UNUSUAL = 1.25
"""Factor of the variance from which on an error is taken as one of its own."""


class Pairs(NamedTuple):
    """p pairs of a hypothesis and a place, the places of one source.

    Attributes:
        hypothesis, place: Indices, (p,).
        difference: Of the place from the hypothesis, in the tangent at it, (p, 6).
        measurement: The place as a measurement of the hypothesis's state.
        predicted: The measurement as the hypothesis predicts it.
        squared: Squared Mahalanobis distance by the ordinary error, (p,).
        log_density: Of the place, as the hypothesis expects it, (p,).
        log_width: Log of the volume of the innovation's covariance over that of the error of the place, or of an
            ordinary image's if that is larger, (p,).
    """

    hypothesis: Int64[np.ndarray, " p"]
    place: Int64[np.ndarray, " p"]
    difference: Float64[np.ndarray, "p 6"]
    measurement: Measurement
    predicted: PredictedMeasurement
    squared: Float64[np.ndarray, " p"]
    log_density: Float64[np.ndarray, " p"]
    log_width: Float64[np.ndarray, " p"]


class Correlation(NamedTuple):
    """With which earlier error the error of a source of places is correlated, and over which distance.

    Attributes:
        number: Of its correlated error in the state of a hypothesis.
        normalized_distance: Of the camera since the last place of that source.
    """

    number: int
    normalized_distance: float


class Evidence(NamedTuple):
    """The likelihood of the hypotheses, given an image.

    Attributes:
        log_likelihood: Of each hypothesis, from the log of the probability of an outlier to 0, (n,).
        outlier: Probability that, if it is right, no place of the image is the true one, (n,).
        agreement: The fraction of the belief that fits the image, in [0, 1].
    """

    log_likelihood: Float64[np.ndarray, " n"]
    outlier: Float64[np.ndarray, " n"]
    agreement: float


def gate(belief: Hypotheses, posterior: PosePosterior, correlations: Sequence[Correlation]) -> list[Pairs]:
    """Pairs of hypotheses and places that are near each other, for each source of places.

    Args:
        belief: n hypotheses.
        posterior: Of the image.
        correlations: Of the camera's network, and of its landmarks where there is a map.
    """
    return [
        _near_pairs(belief, posterior, source, correlation)
        for source, correlation in enumerate(correlations)
        if source == 0 or len(posterior.sources[source])
    ]


def evidence(belief: Hypotheses, posterior: PosePosterior, pairs: Sequence[Pairs], outlier_places: float) -> Evidence:
    """Which place: a hypothesis is as possible as the places near it.

    The network's posterior serves as a likelihood: the training images count as spread evenly over the map. A
    hypothesis for which odometry fails is near many places where it is wider than they are, so each says less for it.
    """
    hypothesis, place, squared, log_width = (
        _joined(pairs, name) for name in ("hypothesis", "place", "squared", "log_width")
    )
    near = posterior.possible[place] * posterior.noise.nearness(squared)
    fits = np.minimum(np.bincount(hypothesis, near, minlength=len(belief)), 1.0)
    fails = belief.regime[hypothesis] != RIGHT
    near = np.where(fails, near * np.exp(np.minimum(_LOG_WIDE - log_width, 0.0)), near)
    possible = np.minimum(np.bincount(hypothesis, near, minlength=len(belief)), 1.0)
    excuse = posterior.excuse(belief.poses)
    log_likelihood = posterior.log_likelihood(possible, excuse, outlier_places)
    return Evidence(log_likelihood, posterior.outliers(excuse), float(belief.weights @ fits))


def correct(
    belief: Hypotheses, posterior: PosePosterior, pairs: Sequence[Pairs], outlier: Float64[np.ndarray, " n"]
) -> Hypotheses:
    """Where in the place: a hypothesis goes on as several, one for each place it may see, and one that sees none.

    Each is weighted by how likely that is, and corrected by its place like a Kalman filter; weights are not normalised.
    Hypotheses at one place share their weight by how likely each makes the image.
    A place that differs by more than usual has an error of its own, which is taken to be that large, independent of
    earlier images, and correlated over as long a distance as any.

    Args:
        belief: n hypotheses, whose weights need not be normalised.
        posterior: Of the image.
        pairs: Near pairs of each source.
        outlier: Of each hypothesis, see `Evidence`.
    """
    hypothesis, place, log_density = (_joined(pairs, name) for name in ("hypothesis", "place", "log_density"))
    log_place = np.log(np.maximum(posterior.weights, 1e-300))
    log_seen = np.log1p(-outlier)[hypothesis] + log_place[place] + log_density
    log_unseen = np.log(outlier) + posterior.noise.log_clutter_density
    log_total = _log_total(log_seen, hypothesis, log_unseen)
    belief = _shared_by_density(belief, posterior, pairs, log_seen, log_total)
    unseen, log_fraction = np.exp(log_unseen - log_total), log_seen - log_total[hypothesis]
    unseen[unseen <= _LEAST] = 0.0
    log_fraction[log_fraction <= np.log(_LEAST)] = -np.inf
    kept = unseen + np.bincount(hypothesis, np.exp(log_fraction), minlength=len(belief))
    aside = unseen.nonzero()[0]
    parts = [belief[aside].reweighted(np.log(unseen[aside] / kept[aside]))]
    log_fraction, begin = log_fraction - np.log(kept)[hypothesis], 0
    for each in pairs:
        own = log_fraction[begin : begin + len(each.place)]
        begin += len(each.place)
        taken = (own > -np.inf).nonzero()[0]
        if len(taken):
            parts.append(_corrected(belief, posterior.means, each, taken, own[taken]))
    return concatenate(parts)


def _shared_by_density(
    belief: Hypotheses,
    posterior: PosePosterior,
    pairs: Sequence[Pairs],
    log_seen: Float64[np.ndarray, " p"],
    log_total: Float64[np.ndarray, " n"],
) -> Hypotheses:
    """The same with the weight of all hypotheses at one place shared by how likely each makes the image.

    So of two hypotheses at a place the one wins whose odometry, or whose errors, explain the image; slowly, as where
    errors last longer than modelled, odometry that fails would explain them as well. Between places the densities do
    not count.

    Args:
        log_seen: Of each pair, the log likelihood of the place.
        log_total: Of each hypothesis, of the image.
    """
    hypothesis, place, squared = (_joined(pairs, name) for name in ("hypothesis", "place", "squared"))
    near = (squared < _SAME_PLACE).nonzero()[0]
    if len(near) < 2 or np.bincount(place[near]).max() < 2:
        return belief
    at = np.full(len(belief), -1)
    likely = near[np.argsort(log_seen[near], kind="stable")]
    at[hypothesis[likely]] = place[likely]  # the most likely one comes last
    own = (at >= 0).nonzero()[0]
    none, count = np.full(len(posterior.weights), -1e300), at[own]
    before = _log_total(belief.log_weights[own], count, none)
    after = _log_total(belief.log_weights[own] + _DENSITY * log_total[own], count, none)
    log_weights = belief.log_weights.copy()
    log_weights[own] += _DENSITY * log_total[own] + (before - after)[count]
    return unchecked_replace(belief, log_weights=log_weights)


def pair(
    belief: Hypotheses,
    posterior: PosePosterior,
    source: int,
    correlation: Correlation,
    hypothesis: Int64[np.ndarray, " p"],
    place: Int64[np.ndarray, " p"],
) -> Pairs:
    """Pairs of hypotheses and places of one source: each place as a measurement of the hypothesis's state.

    The measured value is error of the pose + factor · correlated error + noise.

    Args:
        belief: n hypotheses.
        posterior: Of the image.
        source: Of the places, see `PosePosterior.sources`.
        correlation: Of the source.
        hypothesis, place: Indices, (p,).
    """
    of_source, own = posterior.noise_of(source), correlated_error(correlation.number)
    difference = belief.poses[hypothesis].between(posterior.means[place]).log()
    correlated = belief.mean[:, slice(own.start - 6, own.stop - 6)][hypothesis]
    factors = along_map(posterior.factors[place], belief.poses.rotation[hypothesis])
    factor = math.sqrt(of_source.correlated_fraction) * factors
    noise = (1.0 - of_source.correlated_fraction) * posterior.covariances[place]
    innovation = difference - (factor @ correlated[:, :, None])[:, :, 0]
    jacobian = ((POSE, None), (own, factor))
    cross, information = predict_measurement(belief.covariance, hypothesis, jacobian, noise)
    squared = np.maximum(np.vecdot(innovation, (information @ innovation[:, :, None])[:, :, 0]), 0.0)
    log_det = -np.linalg.slogdet(information)[1]
    # Verified places are much finer than a belief by the network alone, which is no wider than usual.
    ordinary = 2.0 * np.log(posterior.noise.typical_std).sum()
    log_width = 0.5 * (log_det - np.maximum(np.linalg.slogdet(posterior.covariances)[1], ordinary)[place])
    nu = of_source.degrees_of_freedom
    log_peak = math.lgamma((nu + 6) / 2) - math.lgamma(nu / 2) - 3 * math.log(nu * math.pi) - 0.5 * log_det
    # However little is known about where the camera is, it is in the map.
    log_density = np.maximum(log_peak, posterior.noise.log_clutter_density) - (nu + 6) / 2 * np.log1p(squared / nu)
    larger = (nu + squared) / (nu + 6)
    far = (larger > UNUSUAL).nonzero()[0]
    if len(far):
        # Errors that are correlated over a distance of 2 are worth one image: those of an Ornstein-Uhlenbeck process.
        lasts = max(1.0, 2.0 / max(correlation.normalized_distance, 1e-6))
        innovation[far], factor[far] = difference[far], 0.0  # in `jacobian`, too
        noise[far] = larger[far, None, None] * lasts * posterior.covariances[place[far]]
        cross[far], information[far] = predict_measurement(belief.covariance, hypothesis[far], jacobian[:1], noise[far])
    measurement = Measurement(innovation, jacobian, noise)
    predicted = PredictedMeasurement(cross, information)
    return Pairs(hypothesis, place, difference, measurement, predicted, squared, log_density, log_width)


def corrected_poses(
    poses: Poses, places: Poses, pairs: Pairs, taken: Int64[np.ndarray, " c"], change: Float64[np.ndarray, "c 6"]
) -> Poses:
    """Poses after a correction, from the pose before or from the place, whichever is nearer.

    To first order both are equal. The second order grows with the correction: a rotation of 0.01 rad that remains of
    it is 10 m a kilometre away.

    Args:
        poses: Of all hypotheses, batch (n,).
        places: Of the image, batch (k,).
        pairs: Pairs of these.
        taken: Indices of c pairs.
        change: The correction of each, in the tangent at its pose.
    """
    difference, information = pairs.difference[taken], pairs.predicted.innovation_precision[taken]
    before, seen = poses[pairs.hypothesis[taken]], places[pairs.place[taken]]
    left = change - difference
    left_squared, squared = (np.vecdot(each, (information @ each[:, :, None])[:, :, 0]) for each in (left, change))
    from_place = left_squared < squared
    start = Poses(
        np.where(from_place[:, None, None], seen.rotation, before.rotation),
        np.where(from_place[:, None], seen.translation, before.translation),
    )
    return start @ Poses.exp(np.where(from_place[:, None], left, change))


def _near_pairs(belief: Hypotheses, posterior: PosePosterior, source: int, correlation: Correlation) -> Pairs:
    places = posterior.sources[source]
    apart = belief.poses.squared_distances(posterior.means[places])
    variances = [each[places] for each in posterior.variances]
    metres, radians = zip(apart, belief.variances, variances, strict=True)
    hypothesis, k = np.nonzero(_within_gate(*metres) & _within_gate(*radians))
    place = places[k]
    parts = [
        pair(belief, posterior, source, correlation, hypothesis[block], place[block])
        for block in blocks(max(len(hypothesis), 1))
    ]
    return parts[0] if len(parts) == 1 else _concatenated(parts)


def _corrected(
    belief: Hypotheses,
    places: Poses,
    pairs: Pairs,
    taken: Int64[np.ndarray, " c"],
    log_fraction: Float64[np.ndarray, " c"],
) -> Hypotheses:
    """The hypotheses of some pairs, each corrected by its place, with its fraction of the weight."""
    parent = pairs.hypothesis[taken]
    change, covariance = kalman_update(
        belief.covariance, parent, _taken(pairs.measurement, taken), _taken(pairs.predicted, taken)
    )
    poses = corrected_poses(belief.poses, places, pairs, taken, change[:, POSE])
    mean, log_weights = belief.mean[parent] + change[:, 6:], belief.log_weights[parent] + log_fraction
    return Hypotheses(poses, mean, covariance, log_weights, belief.regime[parent])


def _within_gate(apart: np.ndarray, variance: np.ndarray, place_variance: np.ndarray) -> Bool[np.ndarray, "n k"]:
    return apart < _GATE * (variance[:, None] + place_variance)


def _joined(pairs: Sequence[Pairs], name: str) -> np.ndarray:
    return np.concatenate([getattr(each, name) for each in pairs])


def _concatenated(parts: Sequence[Of]) -> Of:
    """Tuples of arrays, and of tuples of them, joined along the first axis of each array."""
    first: Any = parts[0]
    if isinstance(first, np.ndarray):
        return cast(Of, np.concatenate(cast(Sequence[np.ndarray], parts)))
    if not isinstance(first, tuple):
        return first
    return _made_like(first, [_concatenated(each) for each in zip(*cast(Sequence[tuple], parts), strict=True)])


def _taken(of: Of, index: Int64[np.ndarray, " c"]) -> Of:
    """Some rows of each array in a tuple of arrays, and of tuples of them."""
    whole: Any = of
    if isinstance(whole, np.ndarray):
        return cast(Of, whole[index])
    return _made_like(whole, [_taken(each, index) for each in whole]) if isinstance(whole, tuple) else whole


def _made_like(first: Any, parts: list[Any]) -> Any:
    return type(first)(*parts) if hasattr(first, "_fields") else tuple(parts)


def _log_total(log_parts: np.ndarray, of: Int64[np.ndarray, " p"], log_rest: Float64[np.ndarray, " n"]) -> np.ndarray:
    """Log of what the parts of each of so many add up to with the rest of each."""
    largest = log_rest.copy()
    np.maximum.at(largest, of, log_parts)
    parts = np.bincount(of, np.exp(log_parts - largest[of]), minlength=len(log_rest))
    return largest + np.log(parts + np.exp(log_rest - largest))
