"""Mixture reduction: hypotheses pruned, merged, resampled.

Sources: Salmond, "Mixture reduction algorithms for target tracking in clutter", 1990 (greedy clusters about the
heaviest component); Runnalls, "Kullback-Leibler approach to Gaussian mixture reduction", 2007; Fearnhead and Clifford,
"On-line inference for hidden Markov models via particle filters", 2003.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float64, Int64

from filtering.hypotheses import POSE, Hypotheses
from filtering.moments import mixture_moments
from filtering.resampling import RESAMPLING, Resampling
from filtering.se3 import Poses

_NEAR = 4.0  # squared, in standard deviations: hypotheses further apart are not merged


def reduce_mixture(hypotheses: Hypotheses, *, divergence: float, least_weight: float) -> Hypotheses:
    """Prune and merge hypotheses; the result is sorted by falling weight.

    A hypothesis is merged into a heavier one that describes its pose as well: the Kullback-Leibler divergence of its
    Gaussian from the other's is small, and odometry has one regime in both. Merging keeps mean and covariance.

    Args:
        hypotheses: With normalised weights, (n,).
        divergence: Largest one of a merge, nats.
        least_weight: As a fraction of all weight; lighter hypotheses are pruned.
    """
    order = _by_falling_weight(hypotheses.log_weights)
    log_weights = hypotheses.log_weights[order]
    least = np.log(least_weight) if least_weight > 0.0 else -np.inf
    h = hypotheses[order[log_weights > min(least, log_weights[0] - 1.0)]]  # the heaviest always stays
    if divergence > 0.0:
        h = _merged(h, _leaders(h, divergence))
    return h.normalized()


def resample(hypotheses: Hypotheses, count: int, resampling: Resampling, *, rng: np.random.Generator) -> Hypotheses:
    """Fewer hypotheses, sorted by falling weight.

    Args:
        hypotheses: With normalised weights, more than `count`.
        count: How many are left.
        resampling: Name of a way to resample, see `RESAMPLING`.
        rng: Source of its draws.
    """
    kept, log_weights = RESAMPLING[resampling](hypotheses.log_weights, count, rng=rng)
    order = _by_falling_weight(log_weights)
    return hypotheses[kept[order]].with_log_weights(log_weights[order])


def _by_falling_weight(log_weights: Float64[np.ndarray, " n"]) -> Int64[np.ndarray, " n"]:
    return (-log_weights).argsort(kind="stable")


def _leaders(h: Hypotheses, divergence: float) -> Int64[np.ndarray, " n"]:
    """For every hypothesis, by falling weight, the heavier one that it is merged into, or itself."""
    leader, covariance = list(range(len(h))), h.pose_covariance
    # A divergence is at least half the squared distance.
    heavy, light = _near(h, min(_NEAR, 2.0 * divergence)).nonzero()
    alike = (heavy < light) & (h.regime[heavy] == h.regime[light])
    heavy, light = heavy[alike], light[alike]
    if len(heavy) == 0:
        return np.array(leader)
    leads = np.bincount(heavy).nonzero()[0]
    information = np.linalg.inv(covariance[leads]).reshape(-1, 36)
    log_det = np.linalg.slogdet(covariance)[1]
    offset = h.poses[heavy].between(h.poses[light]).log()
    second_moment = covariance[light] + offset[:, :, None] * offset[:, None, :]
    trace = np.vecdot(information[leads.searchsorted(heavy)], second_moment.reshape(-1, 36))
    close = 0.5 * (trace - 6.0 + log_det[heavy] - log_det[light]) < divergence
    heavy, light = heavy[close], light[close]
    starts = np.diff(heavy, prepend=-1).nonzero()[0]
    for i, (begin, end) in zip(heavy[starts].tolist(), pairwise([*starts.tolist(), len(heavy)]), strict=True):
        if leader[i] == i:  # the heaviest come first
            for j in light[begin:end].tolist():
                leader[j] = i if leader[j] == j else leader[j]
    return np.array(leader)


def _near(h: Hypotheses, reach: float) -> Bool[np.ndarray, "n n"]:
    """Of which hypotheses (rows) others (columns) may be within a squared distance, in standard deviations."""
    (variance_m, variance_rad), (apart_m, apart_rad) = h.variances, h.poses.squared_distances(h.poses)
    return (apart_m < reach * variance_m[:, None]) & (apart_rad < reach * variance_rad[:, None])


def _merged(h: Hypotheses, leader: Int64[np.ndarray, " n"]) -> Hypotheses:
    """One hypothesis for each leader, with the mean and covariance of those that it leads, by falling weight."""
    members = (np.bincount(leader, minlength=len(h))[leader] > 1).nonzero()[0]
    if len(members) == 0:
        return h
    members = members[leader[members].argsort(kind="stable")]  # group by group, the leader first
    first = leader[members]
    starts = np.diff(first, prepend=-1).nonzero()[0]
    offset = np.concatenate([h.poses[first].between(h.poses[members]).log(), h.mean[members] - h.mean[first]], axis=1)
    total, mean, covariance = mixture_moments(h.weights[members], offset, h.covariance[members], starts)
    leads = first[starts]
    poses = h.poses[leads] @ Poses.exp(mean[:, POSE])

    log_weights = h.log_weights.copy()
    log_weights[leads] = np.log(total)
    kept = (leader == np.arange(len(h))).nonzero()[0]
    kept = kept[_by_falling_weight(log_weights[kept])]
    position = np.empty(len(h), np.int64)
    position[kept] = np.arange(len(kept))
    merged, at = h[kept], position[leads]
    merged.poses.rotation[at], merged.poses.translation[at] = poses.rotation, poses.translation
    merged.mean[at] += mean[:, 6:]
    merged.covariance[at], merged.log_weights[at] = covariance, np.log(total)
    return merged
