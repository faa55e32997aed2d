"""Particles -> Estimate: the hypotheses, with weight and covariance, and how sure they are."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float64, Int64

from filtering.errors import require_within
from filtering.particles import Particles
from filtering.posterior import KernelDensity
from filtering.resampling import systematic
from filtering.se3 import Poses

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
    """Peaks are sought among this many particles, drawn by weight."""

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


@dataclass(frozen=True)
class Estimate:
    """What the filter believes after one image.

    Attributes:
        modes: Hypotheses; the first is the best one reported, the others follow by falling weight.
        status: "converged" when one mode holds most of the belief, "ambiguous" when several share it,
            "lost" when the images no longer fit the belief.
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


def find_modes(particles: Particles, config: ModeConfig, *, rng: np.random.Generator) -> tuple[Mode, ...]:
    """Split particles into hypotheses, by falling weight; at least one.

    Peaks of the kernel density are taken greedily from the highest down, each claiming its neighbourhood, and every
    particle then belongs to the nearest peak within reach. Mean and covariance are over a mode's own particles only,
    never across modes.
    """
    chosen = systematic(particles.weights, min(config.num_representatives, 4 * len(particles)), rng=rng)
    representatives = particles.poses[chosen]
    height = KernelDensity(representatives, config.bandwidth_m, config.bandwidth_rad).log_density(representatives)
    peaks = _greedy_peaks(representatives, height, config)
    label = _nearest_peak(particles.poses, representatives[peaks], config)
    weights = particles.weights
    modes = [
        _mode_of(particles.poses[label == k], weights[label == k]) for k in range(len(peaks)) if (label == k).any()
    ]
    modes.sort(key=lambda mode: -mode.weight)
    kept = [mode for mode in modes if mode.weight >= config.min_weight]
    return tuple(kept or modes[:1])[: config.max_modes]


def posterior_modes(poses: Poses, config: ModeConfig, *, rng: np.random.Generator) -> tuple[Mode, ...]:
    """Hypotheses of equally weighted posterior samples (m,), by falling weight."""
    return find_modes(Particles(poses, np.full(len(poses), -np.log(len(poses)))), config, rng=rng)


def _greedy_peaks(poses: Poses, height: np.ndarray, config: ModeConfig) -> Int64[np.ndarray, " k"]:
    free = np.ones(len(poses), bool)
    peaks: list[int] = []
    # One more than are reported, so that the last reported mode does not swallow what lies beyond it.
    while free.any() and len(peaks) < 2 * config.max_modes:
        peak = int(np.argmax(np.where(free, height, -np.inf)))
        peaks.append(peak)
        free &= _scaled_distance(poses, poses[peak], config) > 1.0
    return np.array(peaks, np.int64)


def _nearest_peak(poses: Poses, peaks: Poses, config: ModeConfig) -> Int64[np.ndarray, " n"]:
    """Index of the nearest peak, −1 where none is within reach."""
    distance = np.stack([_scaled_distance(poses, peaks[k], config) for k in range(len(peaks))], axis=1)
    nearest = np.argmin(distance, axis=1)
    return np.where(distance[np.arange(len(nearest)), nearest] <= 1.0, nearest, -1).astype(np.int64)


def _scaled_distance(poses: Poses, centre: Poses, config: ModeConfig) -> np.ndarray:
    translation_m, rotation_rad = poses.distance(centre)
    return np.maximum(translation_m / config.radius_m, rotation_rad / config.radius_rad)


def _mode_of(poses: Poses, weights: np.ndarray) -> Mode:
    total = float(weights.sum())
    share = weights / total if total > 0 else np.full(len(weights), 1.0 / len(weights))
    mean = poses.mean(share)
    tangent = (mean.inverse() @ poses).log()
    return Mode(mean, (tangent * share[:, None]).T @ tangent, total)
