"""Particles -> Estimate: the hypotheses, with weight and covariance, and how sure they are."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float64, Int64
from scipy.spatial.distance import cdist

from filtering.density import KernelDensity
from filtering.errors import require_within
from filtering.moments import group_moments
from filtering.particles import Particles
from filtering.regularisation import spread_draw
from filtering.se3 import Poses

_SPREAD = 0.25  # power of the weights by which representatives are drawn: a new place weighs next to nothing

Status = Literal["converged", "ambiguous", "lost"]


@dataclass(frozen=True)
class Mode:
    """One hypothesis of where the camera is.

    Attributes:
        world_from_camera: One pose, the mean of the mode.
        covariance: Covariance of ξ = (v, ω), metres and radians, in the tangent at the mode (camera frame).
        weight: Share of the belief, in [0, 1].
    """

    world_from_camera: Poses
    covariance: Float64[np.ndarray, "6 6"]
    weight: float

    @property
    def widest_std_m(self) -> float:
        """Standard deviation of the position along its widest axis, metres."""
        return float(np.sqrt(np.linalg.eigvalsh(self.covariance[:3, :3])[-1]))


@dataclass(frozen=True)
class ModeConfig:
    """What counts as one hypothesis."""

    radius_m: float = 0.6
    """Particles within this distance of a mode's peak, in metres, belong to it."""
    radius_rad: float = 0.6
    """And within this angle, in radians."""
    bandwidth_m: float = 0.15
    """Kernel width in metres with which peaks are found."""
    bandwidth_rad: float = 0.15
    """Kernel width in radians with which peaks are found."""
    max_modes: int = 12
    """No more hypotheses than this are reported."""
    min_weight: float = 0.02
    """Hypotheses with a smaller share of the belief are not reported."""
    num_representatives: int = 400
    """Peaks are sought among this many particles, drawn by the fourth root of their weights."""

    def __post_init__(self) -> None:
        require_within(
            self,
            radius_m=(1e-6, 1e6),
            radius_rad=(1e-6, 4.0),
            bandwidth_m=(1e-6, 1e6),
            bandwidth_rad=(1e-3, 10.0),
            max_modes=(1, 10**6),
            min_weight=(0.0, 1.0),
            num_representatives=(1, 10**5),
        )

    def same_place(self, one: Poses, other: Poses) -> bool:
        """Whether one pose lies within the reach of a mode at another."""
        translation_m, rotation_rad = one.distance(other)
        return bool(translation_m <= self.radius_m and rotation_rad <= self.radius_rad)


@dataclass(frozen=True)
class Estimate:
    """What the filter believes after one image.

    Attributes:
        modes: Hypotheses; the first is the best one reported, the others follow by falling weight.
        status: "converged" when one narrow mode holds most of the belief and the images do not contradict it, "lost"
            when they have long been outliers to all of it, "ambiguous" otherwise.
        particles: All particles, world_from_camera, batch (n,).
        log_weights: Their normalised log weights, (n,).
        effective_sample_size: 1 / Σ w², before resampling, in particles.
        log_evidence: Log of the mean likelihood of the image under the predicted belief, 0 where the image is an
            outlier to all of it; low when the image is unlike what was expected.
    """

    modes: tuple[Mode, ...]
    status: Status
    particles: Poses
    log_weights: Float64[np.ndarray, " n"]
    effective_sample_size: float
    log_evidence: float


def find_hypotheses(particles: Particles, config: ModeConfig, *, rng: np.random.Generator) -> Int64[np.ndarray, " n"]:
    """Split particles into hypotheses: the label of every particle, from 0, −1 where it belongs to none, (n,).

    Peaks of the kernel density are taken greedily from the highest down, each claiming its neighbourhood, and every
    particle then belongs to the nearest peak within reach.
    """
    count = min(config.num_representatives, 4 * len(particles))
    chosen, log_weights = spread_draw(particles, count, exponent=_SPREAD, rng=rng)
    representatives = particles.poses[chosen]
    density = KernelDensity(representatives, config.bandwidth_m, config.bandwidth_rad, log_weights)
    peaks = _greedy_peaks(representatives, density.log_density(representatives), config)
    nearest = _nearest_peak(particles.poses, representatives[peaks], config)
    claimed = np.bincount(nearest + 1, minlength=len(peaks) + 1)[1:] > 0
    renumbered = np.where(claimed, np.cumsum(claimed) - 1, -1)
    return np.where(nearest >= 0, renumbered[nearest], -1)


def describe_modes(particles: Particles, label: Int64[np.ndarray, " n"], config: ModeConfig) -> tuple[Mode, ...]:
    """The hypotheses that count, by falling weight; at least one.

    Mean and covariance are over a hypothesis' own particles only, never across hypotheses.

    Args:
        particles: The belief, (n,).
        label: Of `find_hypotheses`.
        config: How many modes and how small ones are reported.
    """
    own = np.flatnonzero(label >= 0)
    weight = np.bincount(label[own], particles.weights[own])
    order = np.argsort(-weight, kind="stable")[: config.max_modes]
    order = order[weight[order] >= min(config.min_weight, weight[order[0]])]
    rank = np.full(len(weight), -1)
    rank[order] = np.arange(len(order))
    own = own[rank[label[own]] >= 0]
    group = rank[label[own]]
    means, covariances, _ = group_moments(particles.poses[own], particles.weights[own], group, len(order))
    return tuple(Mode(means[k], covariances[k], float(weight[order[k]])) for k in range(len(order)))


def posterior_modes(poses: Poses, config: ModeConfig, *, rng: np.random.Generator) -> tuple[Mode, ...]:
    """Hypotheses of equally weighted posterior samples (m,), by falling weight."""
    particles = Particles(poses, np.full(len(poses), -np.log(len(poses))))
    return describe_modes(particles, find_hypotheses(particles, config, rng=rng), config)


def _greedy_peaks(poses: Poses, height: np.ndarray, config: ModeConfig) -> Int64[np.ndarray, " k"]:
    free = np.ones(len(poses), bool)
    peaks: list[int] = []
    # More than are reported, so that the last reported mode does not swallow what lies beyond it.
    while free.any() and len(peaks) < 2 * config.max_modes:
        peak = int(np.argmax(np.where(free, height, -np.inf)))
        peaks.append(peak)
        free &= _scaled_squares(poses, poses[[peak]], config)[:, 0] > 1.0
    return np.array(peaks, np.int64)


def _nearest_peak(poses: Poses, peaks: Poses, config: ModeConfig) -> Int64[np.ndarray, " n"]:
    """Index of the nearest peak, −1 where none is within reach."""
    distance = _scaled_squares(poses, peaks, config)
    nearest = np.argmin(distance, axis=1)
    return np.where(distance[np.arange(len(nearest)), nearest] <= 1.0, nearest, -1).astype(np.int64)


def _scaled_squares(poses: Poses, centres: Poses, config: ModeConfig) -> Float64[np.ndarray, "n k"]:
    """Squared distance, 1 at the radius of a mode, in translation or in rotation (by the chord), the larger one."""
    translation = cdist(poses.translation, centres.translation, "sqeuclidean")
    translation /= config.radius_m**2
    # ‖R − S‖² is 6 − 2 tr RᵀS, and that of a rotation by θ is 8 sin² θ/2.
    rotation = poses.chordal[:, 3:] @ centres.chordal[:, 3:].T
    rotation *= -4.0
    rotation += 6.0
    rotation /= 8.0 * np.sin(min(config.radius_rad, np.pi) / 2) ** 2
    return np.maximum(translation, rotation, out=translation)
