"""Mixture reduction: hypotheses pruned, merged, resampled.

Sources: Salmond, "Mixture reduction algorithms for target tracking in clutter", 1990 (greedy clusters about the
heaviest component); Runnalls, "Kullback-Leibler approach to Gaussian mixture reduction", 2007; Fearnhead and Clifford,
"On-line inference for hidden Markov models via particle filters", 2003.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float64, Int64

from filtering.hypotheses import POSE, Hypotheses
from filtering.moments import mixture_moments
from filtering.resampling import RESAMPLING, Resampling
from filtering.se3 import Poses

_NEAR = 4.0  # squared, in standard deviations: hypotheses further apart are not merged


def reduce_mixture(
    hypotheses: Hypotheses,
    *,
    divergence: float,
    least_weight: float,
    most: int,
    resampling: Resampling,
    rng: np.random.Generator,
) -> Hypotheses:
    """Prune, merge and resample hypotheses; the result is sorted by falling weight.

    A hypothesis is merged into a heavier one that describes its pose as well: the Kullback-Leibler divergence of its
    Gaussian from the other's is small, and odometry has one regime in both. Merging keeps mean and covariance.
    Hypotheses lighter than `least_weight` are pruned. If more than `most` are left, they are resampled.

    Args:
        hypotheses: With normalised weights, (n,).
        divergence: Largest one of a merge, nats.
        least_weight: As a fraction of all weight.
        most: Largest number of hypotheses.
        resampling: Name of a way to resample, see `RESAMPLING`.
        rng: Source of its draws.
    """
    h, order = hypotheses, _by_falling_weight(hypotheses.log_weights)
    least = np.log(least_weight) if least_weight > 0.0 else -np.inf
    order = order[h.log_weights[order] > min(least, h.log_weights[order[0]] - 1.0)]  # the heaviest always stays
    if divergence > 0.0:
        h = h[order]
        h = _merged(h, _leaders(h, divergence))
        order = _by_falling_weight(h.log_weights)
    log_weights = h.log_weights[order]
    if len(order) > most:
        kept, log_weights = RESAMPLING[resampling](log_weights, most, rng=rng)
        again = _by_falling_weight(log_weights)
        order, log_weights = order[kept[again]], log_weights[again]
    return h[order].with_log_weights(log_weights)


def _by_falling_weight(log_weights: Float64[np.ndarray, " n"]) -> Int64[np.ndarray, " n"]:
    return np.argsort(-log_weights, kind="stable")


def _leaders(h: Hypotheses, divergence: float) -> Int64[np.ndarray, " n"]:
    """For every hypothesis, by falling weight, the heavier one that it is merged into, or itself."""
    count, covariance = len(h), h.pose_covariance
    leader = np.arange(count)
    # A divergence is at least half the squared distance.
    heavy, light = np.nonzero(np.triu(_near(h, min(_NEAR, 2.0 * divergence)), 1))
    if len(heavy) == 0:
        return leader
    information = np.linalg.inv(covariance)
    log_det = np.linalg.slogdet(covariance)[1]
    offset = h.poses[heavy].between(h.poses[light]).log()
    second_moment = covariance[light] + offset[:, :, None] * offset[:, None, :]
    trace = np.vecdot(information.reshape(-1, 36)[heavy], second_moment.reshape(-1, 36))
    close = 0.5 * (trace - 6.0 + log_det[heavy] - log_det[light]) < divergence
    close &= h.regime[heavy] == h.regime[light]
    described = np.zeros((count, count), bool)
    described[heavy[close], light[close]] = True
    free = np.ones(count, bool)
    for i in np.flatnonzero(described.any(axis=1)):
        if free[i]:
            members = described[i] & free
            leader[members] = i
            free &= ~members
    return leader


def _near(h: Hypotheses, reach: float) -> Bool[np.ndarray, "n n"]:
    """Of which hypotheses (rows) others (columns) may be within a squared distance, in standard deviations."""
    (variance_m, variance_rad), (apart_m, apart_rad) = h.variances, h.poses.squared_distances(h.poses)
    return (apart_m < reach * variance_m[:, None]) & (apart_rad < reach * variance_rad[:, None])


def _merged(h: Hypotheses, leader: Int64[np.ndarray, " n"]) -> Hypotheses:
    """One hypothesis for each leader, with the mean and covariance of those that it leads."""
    leads = leader == np.arange(len(h))
    if leads.all():
        return h
    members = np.flatnonzero(np.bincount(leader, minlength=len(h))[leader] > 1)
    members = members[np.argsort(leader[members], kind="stable")]  # group by group, the leader first
    starts = np.flatnonzero(np.diff(leader[members], prepend=-1))
    first = leader[members]
    offset = np.concatenate([h.poses[first].between(h.poses[members]).log(), h.mean[members] - h.mean[first]], axis=1)
    total, mean, covariance = mixture_moments(h.weights[members], offset, h.covariance[members], starts)
    poses = h.poses[first[starts]] @ Poses.exp(mean[:, POSE])

    merged = h[np.flatnonzero(leads)]
    at = (np.cumsum(leads) - 1)[first[starts]]
    merged.poses.rotation[at], merged.poses.translation[at] = poses.rotation, poses.translation
    merged.mean[at] += mean[:, 6:]
    merged.covariance[at], merged.log_weights[at] = covariance, np.log(total)
    return merged
