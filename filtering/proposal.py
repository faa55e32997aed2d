"""Mixture proposal: who is drawn from the motion model, who from the image, and their exact weights.

Source: Thrun, Fox, Burgard and Dellaert, "Robust Monte Carlo localization for mobile robots", 2001, with the
deterministic-mixture weight of Owen and Zhou, 2000.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from filtering.motion import Odometry, propagate
from filtering.particles import Particles
from filtering.posterior import KernelDensity, PosePosterior
from filtering.resampling import systematic
from filtering.se3 import Poses


@dataclass(frozen=True)
class Proposal:
    """Particles before the image weighs them.

    Attributes:
        poses: world_from_camera, batch (n,): first those drawn from the motion model, then those from the image.
        num_from_motion: How many of them are drawn from the motion model.
        log_predicted: Log p⁻ at every pose, the belief carried here by odometry, per m³ rad³, (n,).
        log_image: Log p̂ at every pose, the posterior of the image alone, (n,).
    """

    poses: Poses
    num_from_motion: int
    log_predicted: Float64[np.ndarray, " n"]
    log_image: Float64[np.ndarray, " n"]


def propose(
    belief: Particles,
    odometry: Odometry,
    posterior: PosePosterior,
    *,
    num_particles: int,
    injection_fraction: float,
    jitter_std: tuple[float, float],
    predicted_bandwidth: tuple[float, float],
    num_predicted_centres: int,
    rng: np.random.Generator,
) -> Proposal:
    """Draw (1 − φ) n particles from the motion model and φ n from the image's posterior.

    Args:
        belief: The belief after the previous image.
        odometry: The motion since.
        posterior: The posterior of the present image.
        num_particles: n, all particles together.
        injection_fraction: φ, the share drawn from the image, in [0, 1).
        jitter_std: Regularisation of duplicated particles, metres and radians.
        predicted_bandwidth: Kernel widths, metres and radians, with which p⁻ is evaluated.
        num_predicted_centres: How many of the propagated particles p⁻ is evaluated from, at most.
        rng: Source of all draws.
    """
    num_injected = round(injection_fraction * num_particles)
    num_from_motion = num_particles - num_injected
    ancestors = systematic(belief.weights, num_from_motion, rng=rng)
    moved = propagate(belief.poses[ancestors], odometry, rng=rng, jitter_std=jitter_std)
    poses = Poses.concatenate([moved, posterior.sample(num_injected, rng=rng)]) if num_injected else moved
    # Ancestors are sorted, so equal steps through them are a stratified subsample.
    stride = max(1, -(-num_from_motion // num_predicted_centres))
    predicted = KernelDensity(moved[rng.integers(stride) :: stride], *predicted_bandwidth)
    return Proposal(poses, num_from_motion, predicted.log_density(poses), posterior.log_density(poses))


def mixture_log_weights(
    log_likelihood: Float64[np.ndarray, " n"],
    log_predicted: Float64[np.ndarray, " n"],
    log_image: Float64[np.ndarray, " n"],
    log_prior: Float64[np.ndarray, " n"],
    *,
    injection_fraction: float,
    kidnap_probability: float,
) -> Float64[np.ndarray, " n"]:
    """Log of L · [(1 − κ) p⁻ + κ π] / [(1 − φ) p⁻ + φ p̂], the weight of every particle, wherever it was drawn.

    Args:
        log_likelihood: Log L at the particles.
        log_predicted: Log p⁻ at the particles.
        log_image: Log p̂ at the particles.
        log_prior: Log π at the particles, the density of where a camera can be at all.
        injection_fraction: φ.
        kidnap_probability: κ, the chance that the camera was carried away since the previous image.
    """
    target = _log_mix(log_predicted, log_prior, kidnap_probability)
    return log_likelihood + target - _log_mix(log_predicted, log_image, injection_fraction)


def _log_mix(first: np.ndarray, second: np.ndarray, share_of_second: float) -> np.ndarray:
    """Log of (1 − s) exp(first) + s exp(second); a share of 0 or 1 leaves one of them exactly."""
    if share_of_second <= 0.0:
        return first
    if share_of_second >= 1.0:
        return second
    return np.logaddexp(np.log1p(-share_of_second) + first, np.log(share_of_second) + second)
