"""The belief: Rao-Blackwellised particles, each a hypothesis with a Gaussian over all that is uncertain about it.

Sources: Doucet, de Freitas, Murphy and Russell, "Rao-Blackwellised particle filtering for dynamic Bayesian networks",
2000; Solà, Deray and Atchuthan, "A micro Lie theory for state estimation in robotics", 2018 (error states on SE(3));
Runnalls, "Kullback-Leibler approach to Gaussian mixture reduction", 2007.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float64, Int64

from filtering.errors import VaporTrackError
from filtering.moments import mixture_moments, settle
from filtering.motion import Odometry, SlowErrors
from filtering.posterior import PosePosterior
from filtering.resampling import thin_out
from filtering.se3 import Poses

POSE, SLOW = slice(0, 6), slice(6, 13)
"""Where in a state the error of the pose is, and where the slow errors of odometry: scale, and drift of each axis."""

_NEAR = 4.0  # squared, in standard deviations: further apart no two hypotheses are one
_BLOCK = 256
_WIDEST_RAD = 2.0  # standard deviation: all directions
_LONGEST_S = 1e10  # three centuries, after which nothing more is forgotten


def bias(source: int) -> slice:
    """Where in a state the lasting error of a source of places is, in units of the error's own square root."""
    return slice(13 + 6 * source, 19 + 6 * source)


def blocks(count: int) -> Iterator[slice]:
    """So many hypotheses in blocks whose covariances fit into a processor's cache: many are faster one by one."""
    return (slice(start, start + _BLOCK) for start in range(0, count, _BLOCK))


def log_sum(log_values: Float64[np.ndarray, " n"]) -> float:
    """Log of the sum of exp(values) (n,), n ≥ 1."""
    largest = float(log_values.max())
    if not np.isfinite(largest):
        return largest
    return largest + float(np.log(np.exp(log_values - largest).sum()))


@dataclass(frozen=True)
class Hypotheses:
    """n hypotheses. A state is the error of the pose (6), slow errors of odometry (7), and of each source the bias (6).

    Attributes:
        poses: world_from_camera, batch (n,). The true pose is `poses @ exp(ξ)`, ξ the error of the pose, of mean 0.
        mean: Mean of the other parts of the state, (n, d − 6).
        covariance: Of the state, (n, d, d).
        log_weights: Log weights, normalised, (n,).
    """

    poses: Poses
    mean: Float64[np.ndarray, "n m"]
    covariance: Float64[np.ndarray, "n d d"]
    log_weights: Float64[np.ndarray, " n"]

    def __len__(self) -> int:
        return len(self.log_weights)

    def __getitem__(self, index: slice | Int64[np.ndarray, " k"] | np.ndarray) -> Hypotheses:
        return Hypotheses(self.poses[index], self.mean[index], self.covariance[index], self.log_weights[index])

    @property
    def weights(self) -> Float64[np.ndarray, " n"]:
        """Normalised weights, (n,)."""
        return np.exp(self.log_weights)

    @cached_property
    def variances(self) -> tuple[Float64[np.ndarray, " n"], Float64[np.ndarray, " n"]]:
        """Of the pose, all axes together, m² and rad², (n,) each."""
        position, rotation = (np.einsum("nii->n", self.covariance[:, part, part]) for part in (slice(3), slice(3, 6)))
        return position, rotation

    @property
    def pose_covariance(self) -> Float64[np.ndarray, "n 6 6"]:
        """Of ξ = (v, ω), metres and radians, in the tangent at each pose."""
        return self.covariance[:, POSE, POSE]

    def with_log_weights(self, log_weights: Float64[np.ndarray, " n"]) -> Hypotheses:
        """The same with other weights (n,), which need not be normalised.

        Raises:
            VaporTrackError: a weight is NaN or +∞, or all are zero.
        """
        total = log_sum(log_weights)
        if total == -np.inf:
            raise VaporTrackError(f"all {len(log_weights)} weights are zero, expected at least one positive")
        if not np.isfinite(total):
            bad = np.isnan(log_weights) | (log_weights == np.inf)
            first = int(np.argmax(bad))
            raise VaporTrackError(
                f"log weight of hypothesis {first} is {log_weights[first]}, expected a finite number or −∞ "
                f"({int(bad.sum())} of {len(bad)} are so)"
            )
        return replace(self, log_weights=log_weights - total)


def concatenate(parts: Sequence[Hypotheses]) -> Hypotheses:
    """Join hypotheses along their first axis; the weights stay as they are."""
    return Hypotheses(
        Poses.concatenate([part.poses for part in parts]),
        np.concatenate([part.mean for part in parts]),
        np.concatenate([part.covariance for part in parts]),
        np.concatenate([part.log_weights for part in parts]),
    )


def born(
    posterior: PosePosterior,
    camera: int,
    num_sources: int,
    slow: SlowErrors,
    belief: Hypotheses | None,
    landmarks: int | None = None,
) -> Hypotheses:
    """A hypothesis for each place of a posterior, as if nothing else were known about where the camera is.

    What is known of the odometry's errors comes from the heaviest hypothesis of the belief, if there is one: they do
    not depend on where the camera is. Weights are in proportion to how possible the places are.

    Args:
        posterior: Of an image.
        camera: The number of the lasting error of the camera that took it.
        num_sources: How many lasting errors a state has.
        slow: Of the odometry.
        belief: Of before; None where there is none.
        landmarks: The number of the lasting error of verified places; None where there are none.
    """
    count, size = len(posterior.weights), 13 + 6 * num_sources
    covariance = np.zeros((count, size, size))
    mean = np.zeros((count, size - 6))
    diagonal = np.arange(6, size)
    covariance[:, diagonal, diagonal] = 1.0
    covariance[:, 6, 6] = slow.scale**2
    if belief is not None:
        heaviest = int(np.argmax(belief.log_weights))
        mean[:, :7] = belief.mean[heaviest, :7]
        covariance[:, SLOW, SLOW] = belief.covariance[heaviest, SLOW, SLOW]
    covariance[:, POSE, POSE] = posterior.covariances
    for source, number in enumerate((camera, camera if landmarks is None else landmarks)):
        places, own = posterior.sources[source], bias(number)
        shared = -np.sqrt(posterior.errors_of(source).lasting_fraction) * posterior.factors[places]
        covariance[places, POSE, own] = shared
        covariance[places, own, POSE] = np.swapaxes(shared, 1, 2)
    possible = np.maximum(posterior.possible, 1e-300)
    log_weights = np.log(possible / possible.sum())
    return Hypotheses(posterior.means, mean, covariance, log_weights)


def without_bias(covariance: Float64[np.ndarray, "n d d"], camera: int) -> Float64[np.ndarray, "n d d"]:
    """Covariances of states whose poses do not err as the images of a camera do."""
    apart = covariance.copy()
    apart[:, POSE, bias(camera)] = apart[:, bias(camera), POSE] = 0.0
    return apart


def with_source(hypotheses: Hypotheses) -> Hypotheses:
    """The same with the lasting error of one more source, of which nothing is known, at the end of the state."""
    count, size = hypotheses.covariance.shape[:2]
    covariance = np.zeros((count, size + 6, size + 6))
    covariance[:, :size, :size] = hypotheses.covariance
    covariance[:, range(size, size + 6), range(size, size + 6)] = 1.0
    mean = np.concatenate([hypotheses.mean, np.zeros((count, 6))], axis=1)
    return replace(hypotheses, mean=mean, covariance=covariance)


def motion_of_state(
    odometry: Odometry, slow: SlowErrors, ways: Sequence[float]
) -> tuple[Float64[np.ndarray, "d d"], Float64[np.ndarray, "d d"]]:
    """What a motion does to the state of a hypothesis: its linear transition, and the covariance of the noise it adds.

    The pose itself moves by the increment; the error of the pose that the transition gives is relative to that.

    Args:
        odometry: The motion.
        slow: What slow errors it may have.
        ways: How far the camera of each source came, in lengths over which its errors change.
    """
    size = 13 + 6 * len(ways)
    duration_s = min(odometry.duration_s, _LONGEST_S)
    errs = np.zeros((6, 7))  # of the increment, by scale error and drift; what is reported too long is made shorter
    errs[:3, 0] = -odometry.tangent[:3]
    if slow.drift is None:
        drift = slow.relative_drift * np.sqrt(np.diag(odometry.covariance) * duration_s)
    else:
        drift = np.asarray(slow.drift) * duration_s
    errs[:, 1:] = -np.diag(drift)
    kept = np.ones(size - 6)
    kept[1:7] = np.exp(-duration_s / slow.time_s)
    for source, way in enumerate(ways):
        kept[7 + 6 * source : 13 + 6 * source] = np.exp(-way)
    transition = np.zeros((size, size))
    transition[POSE, POSE] = odometry.carry
    transition[POSE, SLOW] = errs
    rest = np.arange(6, size)
    transition[rest, rest] = kept
    noise = np.zeros((size, size))
    noise[POSE, POSE] = odometry.noise
    noise[rest, rest] = 1.0 - kept**2
    return transition, noise


def moved(hypotheses: Hypotheses, odometry: Odometry, slow: SlowErrors, ways: Sequence[float]) -> Hypotheses:
    """Hypotheses after a motion: poses carried on, slow errors corrected for, uncertainty grown.

    Args:
        hypotheses: Before.
        odometry: The motion.
        slow: What slow errors it may have.
        ways: How far the camera of each source came, in lengths over which its errors change.
    """
    transition, noise = motion_of_state(odometry, slow, ways)
    step = odometry.previous_from_current
    kept = np.diag(transition)[6:]
    poses = hypotheses.poses @ (step @ Poses.exp(hypotheses.mean[:, :7] @ transition[POSE, SLOW].T))
    covariance = _carried(hypotheses.covariance, transition[POSE, :13], kept)
    covariance[:, POSE, POSE] += noise[POSE, POSE]
    rest = np.arange(6, len(noise))
    covariance[:, rest, rest] += np.diag(noise)[6:]
    return Hypotheses(poses.orthonormal(), hypotheses.mean * kept, covariance, hypotheses.log_weights)


def corrected_poses(
    poses: Poses,
    places: Poses,
    difference: Float64[np.ndarray, "n 6"],
    change: Float64[np.ndarray, "n 6"],
    information: Float64[np.ndarray, "n 6 6"],
) -> Poses:
    """Poses after a correction, from the pose before or from the place that was seen, whichever is nearer.

    To first order both are one. The second order grows with how far the correction goes: a rotation of 0.01 rad that is
    left of it, a kilometre away, is 10 m.

    Args:
        poses: Before, batch (n,).
        places: Seen, batch (n,).
        difference: Of the places from the poses, in the tangent at the poses.
        change: The correction, in the tangent at the poses.
        information: Inverse covariance of the difference, by which nearer is meant.
    """
    left = change - difference
    left_squared, squared = (np.einsum("ni,nij,nj->n", each, information, each) for each in (left, change))
    from_place = left_squared < squared
    start = Poses(
        np.where(from_place[:, None, None], places.rotation, poses.rotation),
        np.where(from_place[:, None], places.translation, poses.translation),
    )
    return start @ Poses.exp(np.where(from_place[:, None], left, change))


def _carried(
    covariance: Float64[np.ndarray, "n d d"], pose: Float64[np.ndarray, "6 13"], kept: Float64[np.ndarray, " m"]
) -> Float64[np.ndarray, "n d d"]:
    """F C Fᵀ for a transition F that leads to the pose from pose and slow errors, and scales all else."""
    size = covariance.shape[1]
    scale = np.concatenate([np.ones(6), kept])
    scales = np.multiply.outer(scale, scale)
    carried = np.empty_like(covariance)
    for block in blocks(len(covariance)):
        before, after = covariance[block], carried[block]
        half = (before.reshape(-1, size)[:, :13] @ pose.T).reshape(-1, size, 6)
        np.multiply(before, scales, out=after)
        after[:, POSE, POSE] = pose @ half[:, :13]
        after[:, 6:, POSE] = across = half[:, 6:] * kept[:, None]
        after[:, POSE, 6:] = np.swapaxes(across, 1, 2)
        settle(after[:, POSE, POSE])
    return carried


def widened(hypotheses: Hypotheses, covariance: Float64[np.ndarray, "6 6"]) -> Hypotheses:
    """Hypotheses after a motion of which only the covariance of ξ = (v, ω) is known; all directions may be open."""
    grown = hypotheses.covariance.copy()
    grown[:, POSE, POSE] += covariance
    turned = np.arange(3, 6)
    scale = np.ones(grown.shape[:2])
    scale[:, turned] = np.minimum(1.0, _WIDEST_RAD / np.sqrt(grown[:, turned, turned]))
    grown *= scale[:, :, None] * scale[:, None, :]
    return replace(hypotheses, covariance=grown)


def reduced(
    hypotheses: Hypotheses, *, divergence: float, least_weight: float, most: int, rng: np.random.Generator
) -> Hypotheses:
    """Fewer hypotheses that say the same, by falling weight.

    A hypothesis is merged into a heavier one that describes its pose as well: the Kullback-Leibler divergence of its
    Gaussian from the other's is small. Merging keeps mean and covariance. What is lighter than `least_weight` is
    dropped; if then there are more than `most`, they are thinned out at random without bias (`thin_out`).

    Args:
        hypotheses: With normalised weights, (n,).
        divergence: At most, nats.
        least_weight: As a fraction of all weight.
        most: How many at most.
        rng: Source of the choice among the light ones.
    """
    h, order = hypotheses, _by_falling_weight(hypotheses.log_weights)
    least = np.log(least_weight) if least_weight > 0.0 else -np.inf
    order = order[h.log_weights[order] > min(least, h.log_weights[order[0]] - 1.0)]
    if divergence > 0.0:
        h = h[order]
        h = _merged(h, _leaders(h, divergence))
        order = _by_falling_weight(h.log_weights)
    log_weights = h.log_weights[order]
    if len(order) > most:
        kept, log_weights = thin_out(log_weights, most, rng=rng)
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
