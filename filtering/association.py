"""An image meets the belief: which hypothesis sees which of the image's places, and what each learns from it.

Sources: Chen and Liu, "Mixture Kalman filters", 2000 (particles that carry Gaussians); Roth, Özkan and Gustafsson, "A
Student's t filter for heavy tailed process and measurement noise", 2013; Plummer, "Cuts in Bayesian graphical models",
2015 (what an image says of details is cut off from the question which place it is).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64, Int64
from scipy.special import gammaln

from filtering.error_model import ErrorModel
from filtering.hypotheses import POSE, Hypotheses, bias, blocks, concatenate, corrected_poses
from filtering.moments import settle
from filtering.posterior import PosePosterior

_GATE = 36.0  # squared, in standard deviations: what is further apart is not looked at
PLACE = 3.0
"""Standard deviations of the error: details finer than that do not tell one place from another."""
_LEAST = 1e-3  # fraction of a hypothesis that goes on as one of its own
UNUSUAL = 1.25
"""An image whose error has a variance by so much larger than an ordinary one errs in a way of its own."""


@dataclass(frozen=True)
class Association:
    """What an image makes of a belief.

    Attributes:
        hypotheses: Each hypothesis once for every place that it may see, corrected by it, and once as it was; their log
            weights add up to those of the belief after the image, not normalised.
        log_evidence: Log of how well each hypothesis of the belief fits the image, from the log of the
            probability of an outlier to 0, (n,).
        agreement: The fraction of the belief that the image fits, in [0, 1].
    """

    hypotheses: Hypotheses
    log_evidence: Float64[np.ndarray, " n"]
    agreement: float


class _Pairs(NamedTuple):
    """p pairs of a hypothesis and a place that are near each other, the places of one source.

    Attributes:
        bias: Where in a state the lasting error of that source is.
        hypothesis, place: Indices, (p,).
        difference: Of the place from the hypothesis, (p, 6).
        innovation: The same from what the hypothesis expects, (p, 6).
        covariance: Of state and innovation, (p, d, 6).
        factor: By which the lasting error of the camera's images is in the innovation, (p, 6, 6).
        noise: Covariance of what is new in the innovation, (p, 6, 6).
        information: Inverse covariance of the innovation, (p, 6, 6).
        squared: Squared Mahalanobis distance by the ordinary error, (p,).
        log_density: Of the place, as the hypothesis expects it, (p,).
    """

    bias: slice
    hypothesis: Int64[np.ndarray, " p"]
    place: Int64[np.ndarray, " p"]
    difference: Float64[np.ndarray, "p 6"]
    innovation: Float64[np.ndarray, "p 6"]
    covariance: Float64[np.ndarray, "p d 6"]
    factor: Float64[np.ndarray, "p 6 6"]
    noise: Float64[np.ndarray, "p 6 6"]
    information: Float64[np.ndarray, "p 6 6"]
    squared: Float64[np.ndarray, " p"]
    log_density: Float64[np.ndarray, " p"]


def associate(
    belief: Hypotheses,
    posterior: PosePosterior,
    camera: int,
    *,
    novelty: float,
    way: float,
    landmarks: tuple[int, float] | None = None,
) -> Association:
    """Weigh and correct a belief by an image that says something.

    *Which place.* A hypothesis is as possible as the places near it are, where near leaves details aside; its weight
    is multiplied by that to the power of how new the view is: an image that shows what others have shown says nothing
    more.

    *Where in the place.* A hypothesis goes on as several, one for each place that it may see and one that sees none,
    weighted by how likely each is; each is corrected by its place like a Kalman filter, the lasting part of the
    image's error being a part of the state. A place that differs by more than images usually err is an image that errs
    in a way of its own: its error is taken to be as large as that says, to have nothing to do with that of the images
    before, and to last as long as any other.

    Args:
        belief: n hypotheses.
        posterior: Of the image.
        camera: Which camera took it, by the number of its lasting error in the state.
        novelty: How new the view is, in [0, 1].
        way: How far the camera came since its last image, in lengths over which the errors of its images change.
        landmarks: The same two of the places that landmarks have verified; None where the posterior has none.
    """
    errors, count = posterior.errors, len(belief)
    of_sources = [(camera, way), landmarks or (camera, way)]
    parts_of = [
        _near_pairs(belief, posterior, source, *of_sources[source])
        for source in (0, 1)
        if source == 0 or len(posterior.sources[source])
    ]
    hypothesis, place, squared, log_density = (
        np.concatenate([getattr(pairs, name) for pairs in parts_of])
        for name in ("hypothesis", "place", "squared", "log_density")
    )
    near = posterior.support[place] * np.exp(-0.5 * squared / PLACE**2)
    support = np.bincount(hypothesis, near, minlength=count)
    excuse, outlier = posterior.excuse(belief.poses), posterior.outlier_probability
    possible = support / (support + errors.possible_fraction)
    outliers = outlier + (1.0 - outlier) * excuse
    log_evidence = np.log(outliers + (1.0 - outliers) * possible)

    log_place_weights = np.log(np.maximum(posterior.weights, 1e-300))
    log_seen = np.log1p(-outliers)[hypothesis] + log_place_weights[place] + log_density
    log_unseen = np.log(outliers) + errors.flat_log_density
    log_total = _log_total(log_seen, hypothesis, log_unseen)
    log_weights = belief.log_weights + novelty * log_evidence
    unseen = np.exp(log_unseen - log_total)
    aside = np.flatnonzero(unseen > _LEAST)
    as_they_were = belief[aside]
    parts = [
        Hypotheses(
            as_they_were.poses,
            as_they_were.mean,
            as_they_were.covariance,
            log_weights[aside] + np.log(unseen[aside]),
        )
    ]
    log_fraction = log_seen - log_total[hypothesis]
    begin = 0
    for pairs in parts_of:
        own = slice(begin, begin + len(pairs.place))
        begin = own.stop
        taken = np.flatnonzero(log_fraction[own] > np.log(_LEAST))
        if len(taken):
            part = log_weights[pairs.hypothesis[taken]] + log_fraction[own][taken]
            parts.append(_corrected(belief, posterior, pairs, taken, part))
    agreement = float(belief.weights @ possible)
    return Association(concatenate(parts), log_evidence, agreement)


def _near_pairs(belief: Hypotheses, posterior: PosePosterior, source: int, number: int, way: float) -> _Pairs:
    places, errors = posterior.sources[source], posterior.errors_of(source)
    means, variances = posterior.means[places], [each[places] for each in posterior.variances]
    apart = belief.poses.squared_distances(means)
    metres, radians = zip(apart, belief.variances, variances, strict=True)
    h, k = np.nonzero(_within_gate(*metres) & _within_gate(*radians))
    k = places[k]
    pairs = [
        _paired(belief, posterior, errors, bias(number), way, h[block], k[block]) for block in blocks(max(len(h), 1))
    ]
    if len(pairs) == 1:
        return pairs[0]
    return _Pairs(bias(number), *(np.concatenate(parts) for parts in list(zip(*pairs, strict=True))[1:]))


def _paired(
    belief: Hypotheses,
    posterior: PosePosterior,
    errors: ErrorModel,
    own: slice,
    way: float,
    h: Int64[np.ndarray, " p"],
    k: Int64[np.ndarray, " p"],
) -> _Pairs:
    difference = belief.poses[h].between(posterior.means[k]).log()
    with_pose, with_bias = belief.covariance[:, :, POSE][h], belief.covariance[:, :, own][h]
    lasting = belief.mean[:, _without_pose(own)][h]
    factor = np.sqrt(errors.lasting_fraction) * posterior.factors[k]
    noise = (1.0 - errors.lasting_fraction) * posterior.covariances[k]
    # What is measured is error of the pose + factor · bias + noise.
    innovation = difference - (factor @ lasting[:, :, None])[:, :, 0]
    joint = with_pose + with_bias @ np.swapaxes(factor, 1, 2)
    information = np.linalg.inv(joint[:, POSE] + factor @ joint[:, own] + noise)
    squared = np.maximum(np.vecdot(innovation, (information @ innovation[:, :, None])[:, :, 0]), 0.0)
    log_det = -np.linalg.slogdet(information)[1]
    nu = errors.tail
    log_peak = gammaln((nu + 6) / 2) - gammaln(nu / 2) - 3 * np.log(nu * np.pi) - 0.5 * log_det
    # However little is known about where the camera is, it is in the map.
    log_density = np.maximum(log_peak, posterior.errors.flat_log_density) - (nu + 6) / 2 * np.log1p(squared / nu)
    larger = (nu + squared) / (nu + 6)
    far = np.flatnonzero(larger > UNUSUAL)
    if len(far):
        # Errors that last over a way of 2 are worth one image: those of an Ornstein-Uhlenbeck process.
        error = larger[far, None, None] * max(1.0, 2.0 / max(way, 1e-6)) * posterior.covariances[k[far]]
        innovation[far] = difference[far]
        joint[far], factor[far], noise[far] = with_pose[far], 0.0, error
        information[far] = np.linalg.inv(with_pose[far][:, POSE] + error)
    return _Pairs(own, h, k, difference, innovation, joint, factor, noise, information, squared, log_density)


def _corrected(
    belief: Hypotheses,
    posterior: PosePosterior,
    pairs: _Pairs,
    taken: Int64[np.ndarray, " c"],
    log_weights: Float64[np.ndarray, " c"],
) -> Hypotheses:
    """Hypotheses corrected by the places that they are taken to see, as by a Kalman filter in Joseph's form.

    P − K Jᵀ loses all digits of an image that is some 10⁷ times more precise than the belief. (I − K H) P (I − K H)ᵀ +
    K R Kᵀ does not; that is U − (U Hᵀ − K R) Kᵀ with U = P − K Jᵀ, of which the product in brackets is what rounding
    left in U.
    """
    parent, joint = pairs.hypothesis[taken], pairs.covariance[taken]
    gain = joint @ pairs.information[taken]
    change = (gain @ pairs.innovation[taken][:, :, None])[:, :, 0]
    factor, noise = pairs.factor[taken], pairs.noise[taken]
    covariance = np.empty((len(taken), *belief.covariance.shape[1:]))
    for block in blocks(len(taken)):
        before, transposed = belief.covariance[parent[block]], np.swapaxes(gain[block], 1, 2)
        plain = before - gain[block] @ np.swapaxes(joint[block], 1, 2)
        left = plain[:, :, POSE] + plain[:, :, pairs.bias] @ np.swapaxes(factor[block], 1, 2)
        left -= gain[block] @ noise[block]
        np.subtract(plain, left @ transposed, out=covariance[block])
        settle(covariance[block], np.einsum("nii->ni", before))
    places = posterior.means[pairs.place[taken]]
    difference, information = pairs.difference[taken], pairs.information[taken]
    poses = corrected_poses(belief.poses[parent], places, difference, change[:, POSE], information)
    return Hypotheses(poses, belief.mean[parent] + change[:, 6:], covariance, log_weights)


def _within_gate(apart: np.ndarray, variance: np.ndarray, place_variance: np.ndarray) -> Bool[np.ndarray, "n k"]:
    return apart < _GATE * (variance[:, None] + place_variance)


def _log_total(log_parts: np.ndarray, of: Int64[np.ndarray, " p"], log_rest: Float64[np.ndarray, " n"]) -> np.ndarray:
    """Log of what the parts of each of so many add up to with the rest of each."""
    largest = log_rest.copy()
    np.maximum.at(largest, of, log_parts)
    parts = np.bincount(of, np.exp(log_parts - largest[of]), minlength=len(log_rest))
    return largest + np.log(parts + np.exp(log_rest - largest))


def _without_pose(own: slice) -> slice:
    return slice(own.start - 6, own.stop - 6)
