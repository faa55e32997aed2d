"""Which place at each image in hindsight, and where the camera was carried off: Viterbi's algorithm back through time.

Sources: Godsill, Doucet and West, "Maximum a posteriori sequence estimation using Monte Carlo particle filters", 2001
(Viterbi over the particles of a filter); Olson and Agarwal, "Inference on networks of mixtures", 2013 (the most
probable component counts: here odometry, or a camera that was carried off).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64, Int64

from filtering.config import GapConfig
from filtering.estimate import ModeConfig
from filtering.measurement_noise import PLACE, MeasurementNoise
from filtering.motion import Odometry
from filtering.posterior import PosePosterior
from filtering.se3 import Poses

_CANDIDATES = 12  # places of an image that the search goes on from
_LEAST_WEIGHT = 1e-3  # of a hypothesis that the camera may have been carried off from
_UNMATCHED = 1e-6  # weight, where the filter had no hypothesis
_LEAST_POWER = 3e-4  # of a likelihood: whether a view is new is seen by odometry, which does not show a kidnap
_MODES = ModeConfig()


@dataclass(frozen=True)
class SearchStep:
    """What the search knows of one image.

    Attributes:
        posterior: Of the image; uninformative where it has none.
        odometry: Motion since the image before, less the error of its scale; None where it is unknown.
        elapsed_s: Seconds since the image before.
        likelihood_power: Of the image's likelihood, as of the filter, in [0, 1].
        outlier_places: Of so many an outlier shows one, as of the filter.
        places: world_from_camera of the filter's hypotheses after the image, batch (p,), p ≥ 1.
        weights: Theirs, (p,).
    """

    posterior: PosePosterior
    odometry: Odometry | None
    elapsed_s: float
    likelihood_power: float
    outlier_places: float
    places: Poses
    weights: Float64[np.ndarray, " p"]


class Path(NamedTuple):
    """The most probable trajectory to an end.

    Attributes:
        poses: world_from_camera, to within the errors of the filter and of odometry, batch (n,).
        carried_off: Whether the camera was carried off before each image, (n,).
    """

    poses: Poses
    carried_off: Bool[np.ndarray, " n"]


class _Nodes(NamedTuple):
    """Candidates at one image.

    Attributes:
        poses: world_from_camera, batch (m,).
        log_value: Log probability of what follows each, (m,).
        following: The candidate at the next image that each leads to, (m,).
        carried_off: Whether the camera is carried off on the way there, (m,).
    """

    poses: Poses
    log_value: Float64[np.ndarray, " m"]
    following: Int64[np.ndarray, " m"]
    carried_off: Bool[np.ndarray, " m"]


def possible_at(posterior: PosePosterior, poses: Poses) -> Float64[np.ndarray, " n"]:
    """How possible poses (n,) are by an image, in [0, 1], by the places near.

    As in `filtering.association.evidence` for hypotheses no wider than the places.

    Args:
        posterior: Of the image.
        poses: world_from_camera, batch (n,).
    """
    squared = squared_distances(posterior, poses)
    near = posterior.noise.nearness(squared.ravel()).reshape(squared.shape)
    return np.minimum((near * posterior.possible).sum(axis=1), 1.0)


def most_probable_path(
    steps: Sequence[SearchStep], end: Poses, noise: MeasurementNoise, kidnap_rate: float, gap: GapConfig
) -> Path:
    """The most probable trajectory that ends at a pose.

    Candidates go back by odometry, each to the filter's hypothesis near it. Between two images the camera was carried
    off with a stated probability; the filter's hypotheses before are where it may have come from.

    Args:
        steps: Of n images, n ≥ 1.
        end: world_from_camera at the last, one pose.
        noise: Noise of the images, by which places are told apart.
        kidnap_rate: Probability that the camera was carried off.
        gap: Motion where odometry is missing.
    """
    last = np.zeros(1, np.int64)
    nodes = [_Nodes(Poses.stack([end]), np.zeros(1), last, last.astype(bool))]
    for before, after in zip(reversed(steps[:-1]), reversed(steps[1:]), strict=True):
        nodes.append(_step_back(nodes[-1], before, after, noise, kidnap_rate, gap))
    nodes.reverse()
    at = int(np.argmax(nodes[0].log_value + _log_likelihood(steps[0], nodes[0].poses, power=1.0)))
    poses, carried_off = [], np.zeros(len(steps), bool)
    for i, of_image in enumerate(nodes):
        poses.append(of_image.poses[at])
        if i + 1 < len(nodes):
            carried_off[i + 1], at = of_image.carried_off[at], int(of_image.following[at])
    return Path(Poses.stack(poses), carried_off)


def _step_back(
    after: _Nodes,
    step: SearchStep,
    following: SearchStep,
    noise: MeasurementNoise,
    kidnap_rate: float,
    gap: GapConfig,
) -> _Nodes:
    """Candidates at the image before."""
    log_value = after.log_value + _log_likelihood(following, after.poses)
    motion, log_rate, moved = following.odometry, float(np.log(kidnap_rate)), after.poses
    if motion is None:
        wider_m, wider_rad = (2.0 * each * following.elapsed_s for each in (gap.speed_m_per_s, gap.turn_rad_per_s))
        log_rate = 0.0 if gap.action == "forget" else log_rate
    else:
        variance = motion.covariance.diagonal()
        wider_m, wider_rad = (2.0 * float(np.sqrt(each.max())) for each in (variance[:3], variance[3:]))
        wider_m = wider_m if motion.knows_translation else 2.0 * gap.speed_m_per_s * motion.duration_s
        moved = moved @ motion.previous_from_current.inverse()
    target = int(np.argmax(log_value))
    jump = float(log_value[target]) + log_rate
    off = np.asarray(log_value < jump)
    if motion is None and gap.action == "forget":
        off[:] = True
    log_value, going_to = np.where(off, jump, log_value), np.where(off, target, np.arange(len(moved)))

    # Back to the filter's hypotheses, which know the images before.
    heavy = step.weights >= min(_LEAST_WEIGHT, step.weights.max())
    places, weights = step.places[heavy], step.weights[heavy]
    reach_m, reach_rad = _reach(noise)
    apart_m2, apart_rad2 = moved.squared_distances(places)
    apart = np.maximum(apart_m2 / (reach_m + wider_m) ** 2, apart_rad2 / (reach_rad + wider_rad) ** 2)
    nearest, matched = apart.argmin(axis=1), np.asarray((apart <= 1.0).any(axis=1))
    poses = Poses(
        np.where(matched[:, None, None], places.rotation[nearest], moved.rotation),
        np.where(matched[:, None], places.translation[nearest], moved.translation),
    )
    reached = (apart <= 1.0).any(axis=0)
    others = np.flatnonzero(~reached)
    found = _Nodes(
        Poses.concatenate([poses, places[others]]),
        np.concatenate([log_value, np.full(len(others), jump)]),
        np.concatenate([going_to, np.full(len(others), target)]),
        np.concatenate([off, np.ones(len(others), bool)]),
    )
    prior = np.concatenate([np.where(matched, weights[nearest], _UNMATCHED), weights[others]])
    # Of candidates that go back to one hypothesis only the best goes on.
    identity = np.concatenate([np.where(matched, nearest, -1 - np.arange(len(moved))), others])
    order = np.lexsort((-found.log_value, identity))
    first = order[np.flatnonzero(np.diff(identity[order], prepend=identity[order[0]] - 1))]
    kept = first[np.argsort(-(found.log_value + np.log(prior))[first], kind="stable")[:_CANDIDATES]]
    return _Nodes(found.poses[kept], *(each[kept] for each in found[1:]))


def _log_likelihood(step: SearchStep, poses: Poses, power: float | None = None) -> Float64[np.ndarray, " m"]:
    if step.posterior.is_uninformative:
        return np.zeros(len(poses))
    power = max(step.likelihood_power, _LEAST_POWER) if power is None else power
    possible, excuse = possible_at(step.posterior, poses), step.posterior.excuse(poses)
    return power * step.posterior.log_likelihood(possible, excuse, step.outlier_places)


def squared_distances(posterior: PosePosterior, poses: Poses) -> Float64[np.ndarray, "n k"]:
    """Squared Mahalanobis distance of each of n poses from each of k places, (n, k); infinite where it is far."""
    squared = np.full((len(poses), len(posterior.weights)), np.inf)
    apart_m2, apart_rad2 = poses.squared_distances(posterior.means)
    variance_m, variance_rad = posterior.variances
    far = 30.0 * PLACE**2  # e⁻¹⁵
    which, place = np.nonzero((apart_m2 < far * variance_m) & (apart_rad2 < far * variance_rad))
    if len(which):
        residual = posterior.means[place].between(poses[which]).log()
        scaled = np.linalg.solve(posterior.covariances[place], residual[:, :, None])[:, :, 0]
        squared[which, place] = np.vecdot(residual, scaled)
    return squared


def _reach(noise: MeasurementNoise) -> tuple[float, float]:
    """How far apart poses of one place may be, metres and radians."""
    # As of modes. Errors of a network's own places may be metres, where landmarks tell storeys apart.
    reach = _MODES.reach(noise.finest, np.zeros((6, 6)))
    return float(reach[:3].max()), float(reach[3:].max())
