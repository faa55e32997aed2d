"""Mixture proposal: who is drawn from the motion model, who from the image, and their exact weights.

Source: Thrun, Fox, Burgard and Dellaert, "Robust Monte Carlo localization for mobile robots", 2001, with the
deterministic-mixture weight of Owen and Zhou, 2000.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64

from filtering.density import KernelDensity, neighbour_order
from filtering.motion import Odometry, isotropic_std
from filtering.particles import Particles, log_mean
from filtering.posterior import PosePosterior
from filtering.regularisation import KernelConfig, belief_kernels
from filtering.sample_size import SampleSizeConfig, draw_enough
from filtering.se3 import Poses


@dataclass(frozen=True)
class Proposal:
    """Particles before the image weighs them.

    Attributes:
        poses: world_from_camera, batch (n,): first those drawn from the motion model, then those from the image.
        num_from_motion: How many of them are drawn from the motion model.
        log_predicted: Log p⁻ at every pose, the belief carried here by odometry, per m³ rad³, (n,).
        log_moved: Log q at every pose, the density that the motion particles were drawn from, (n,).
        log_image: Log p̂ at every pose, the posterior of the image alone, (n,).
    """

    poses: Poses
    num_from_motion: int
    log_predicted: Float64[np.ndarray, " n"]
    log_moved: Float64[np.ndarray, " n"]
    log_image: Float64[np.ndarray, " n"]

    @property
    def injected_fraction(self) -> float:
        """φ as it came out: the share of particles that the image drew."""
        return 1.0 - self.num_from_motion / len(self.poses)

    def log_evidence(self, log_likelihood: Float64[np.ndarray, " n"]) -> float:
        """Log of the mean of L over the predicted belief, ∫ L p⁻, from log L at the poses (n,)."""
        moved = slice(self.num_from_motion)
        return log_mean(log_likelihood[moved], self.log_predicted[moved] - self.log_moved[moved])


def propose(
    belief: Particles,
    label: Int64[np.ndarray, " n"],
    odometry: Odometry,
    posterior: PosePosterior,
    *,
    sample_size: SampleSizeConfig,
    injection_fraction: float,
    kernels: KernelConfig,
    rng: np.random.Generator,
) -> Proposal:
    """Draw (1 − φ) n particles from the motion model, as many as these need, and φ n from the image's posterior.

    The predicted belief p⁻ is a kernel density: its centres are particles of the belief moved by the odometry, its
    kernels those of their hypothesis with the odometry's noise and the jitter added, made isotropic on the safe side.
    The particles are drawn from the same kernels in equal numbers, q, of centres drawn by powers of their weights below
    1 (`spread_draw`): a place that the images made unlikely keeps enough particles to come back, at its true weight.
    Both densities are evaluated exactly where any kernel reaches, so the mixture weights owe nothing to a bandwidth.
    (Evaluating a smoother density than the one drawn from makes large modes grow at the cost of small ones.)

    Args:
        belief: The belief after the previous image.
        label: Hypothesis of every particle of the belief, −1 where it belongs to none.
        odometry: The motion since.
        posterior: The posterior of the present image.
        sample_size: Of n, all particles together; the need is that of the motion particles.
        injection_fraction: φ, the share drawn from the image, in [0, 1).
        kernels: Which particles become centres of p⁻, and how wide its kernels are.
        rng: Source of all draws.

    Raises:
        VaporTrackError: the odometry covariance is no covariance.
    """
    fewest_moved = sample_size.min_particles - _num_injected(sample_size.min_particles, injection_fraction)
    num_kernels = min(fewest_moved, kernels.max_kernels)
    carried = belief_kernels(belief, label, num_kernels, kernels, rng=rng)
    widths = np.hypot(carried.widths, isotropic_std(odometry.covariance, (kernels.jitter_m, kernels.jitter_rad)))
    density = KernelDensity(carried.centres @ odometry.previous_from_current, *widths.T)

    def move(num_particles: int) -> Poses:
        # Every kernel gives as many particles as any other, up to rounding: stratified draws from the density.
        count = num_particles - _num_injected(num_particles, injection_fraction)
        stratum = (np.arange(count) + rng.random()) * (num_kernels / count)
        return density.draw(np.minimum(stratum.astype(np.int64), num_kernels - 1), rng=rng)

    poses, size = draw_enough(move, sample_size)
    num_from_motion = len(poses)
    num_injected = size - num_from_motion
    if num_injected:
        injected = posterior.sample(num_injected, rng=rng)
        poses = Poses.concatenate([poses, injected[neighbour_order(injected)]])
    log_predicted, log_moved = density.log_densities(
        poses,
        carried.log_weights,
        np.full(num_kernels, -np.log(num_kernels)),
        near_only=True,  # far from the belief: a weight of nothing, beside κ or alone
    )
    return Proposal(poses, num_from_motion, log_predicted, log_moved, posterior.log_density(poses))


def _num_injected(num_particles: int, injection_fraction: float) -> int:
    """How many of all particles the image draws: at least one is left to the motion model."""
    return min(round(injection_fraction * num_particles), num_particles - 1)


def mixture_log_weights(
    proposal: Proposal, log_likelihood: Float64[np.ndarray, " n"], *, kidnap_probability: float
) -> Float64[np.ndarray, " n"]:
    """Log weight of every particle, wherever it was drawn: target over mixture.

    The mixture is (1 − φ) q + φ p̂. The target is (1 − κ) L p⁻ / ∫ L p⁻ + κ p̂: either odometry carried the belief here
    and the image weighs it, or the camera is elsewhere and this image is the first one there, whose posterior is the
    belief as it is at a start. Where no particle is drawn from the image there is only the former.

    Args:
        proposal: Where the particles came from.
        log_likelihood: Log L at the particles.
        kidnap_probability: κ, the chance that the camera is not where the belief was carried, however well this image
            fits there.
    """
    if proposal.num_from_motion == len(proposal.poses):
        kidnap_probability = 0.0
    drawn = _log_mix(proposal.log_moved, proposal.log_image, proposal.injected_fraction)
    carried = log_likelihood + proposal.log_predicted
    log_evidence = proposal.log_evidence(log_likelihood)
    if log_evidence == -np.inf:  # the carried belief is impossible: whatever κ, its share is none
        return (carried if kidnap_probability <= 0.0 else proposal.log_image) - drawn
    return _log_mix(carried - log_evidence, proposal.log_image, kidnap_probability) - drawn


def _log_mix(first: np.ndarray, second: np.ndarray, share_of_second: float) -> np.ndarray:
    """Log of (1 − s) exp(first) + s exp(second); a share of 0 or 1 leaves one of them exactly."""
    if share_of_second <= 0.0:
        return first
    if share_of_second >= 1.0:
        return second
    return np.logaddexp(np.log1p(-share_of_second) + first, np.log(share_of_second) + second)
