"""The belief as a kernel density: which particles become kernels, and how wide these are.

Sources: Milstein, Sánchez and Williamson, "Robust global localization using clustered particle filtering", 2002 (every
hypothesis keeps particles); Liu and West, "Combined parameter and state estimation in simulation-based filtering", 2001
(kernels that do not inflate what they smooth).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64

from filtering.errors import require_within
from filtering.moments import group_moments
from filtering.particles import Particles, log_sum
from filtering.resampling import systematic
from filtering.se3 import Poses


@dataclass(frozen=True)
class KernelConfig:
    """How the belief is carried from image to image: as a kernel density over some of its particles."""

    max_kernels: int = 1000
    """Kernels at most: bounds the cost of a step."""
    share_exponent: float = 0.3
    """A hypothesis gets kernels by its weight to this power: 1 for its share, 0 for as many as any other."""
    smoothing: float = 0.5
    """Kernel widths as a share of those that are best for Gaussian hypotheses; 0: the odometry's noise and jitter."""
    jitter_m: float = 0.01
    """Standard deviation in metres that separates duplicated particles, at least."""
    jitter_rad: float = 0.005
    """Standard deviation in radians that separates duplicated particles, at least."""

    def __post_init__(self) -> None:
        require_within(
            self,
            max_kernels=(1, 10**6),
            share_exponent=(0.0, 1.0),
            smoothing=(0.0, 1.0),
            jitter_m=(0.0, 1e3),
            jitter_rad=(0.0, 4.0),
        )


@dataclass(frozen=True)
class Kernels:
    """A belief that is ready to be carried on.

    Attributes:
        centres: world_from_camera, (k,).
        log_weights: Log weights, normalised, (k,).
        widths: Standard deviations along and about each axis, metres and radians, (k, 2); 0 for no width of its own.
    """

    centres: Poses
    log_weights: Float64[np.ndarray, " k"]
    widths: Float64[np.ndarray, "k 2"]


def belief_kernels(
    belief: Particles,
    label: Int64[np.ndarray, " n"],
    count: int,
    config: KernelConfig,
    *,
    rng: np.random.Generator,
) -> Kernels:
    """Kernels that stand for a belief, hypothesis by hypothesis.

    Args:
        belief: Particles (n,).
        label: Hypothesis of every particle, −1 where it belongs to none, (n,).
        count: How many kernels.
        config: Which particles become kernels, and how wide.
        rng: Source of the draw.
    """
    drawn, log_weights = spread_draw(belief, count, label=label, exponent=config.share_exponent, rng=rng)
    centres, widths = regularise(belief.poses[drawn], log_weights, label[drawn], drawn, scale=config.smoothing)
    return Kernels(centres, log_weights, widths)


def spread_draw(
    particles: Particles,
    count: int,
    *,
    label: Int64[np.ndarray, " n"] | None = None,
    exponent: float,
    rng: np.random.Generator,
) -> tuple[Int64[np.ndarray, " k"], Float64[np.ndarray, " k"]]:
    """Draw more particles of unlikely hypotheses than their weights ask for, with log weights that make up for it.

    A hypothesis gets draws by its weight to the power of `exponent`, its particles by the square root of theirs. A
    systematic draw gives every stretch of its input the right number, up to rounding: hypothesis by hypothesis, each
    keeps its share exactly; in any other order it would on average only.

    Args:
        particles: The belief, (n,).
        count: k, how many to draw.
        label: Hypothesis of every particle, −1 for those that belong to none, (n,). Without, each is its own.
        exponent: 1 for draws in proportion to the weights of the hypotheses, 0 for as many of each.
        rng: Source of the draw.

    Returns:
        Indices of the particles drawn (k,), hypothesis by hypothesis, and their log weights, normalised (k,).
    """
    relative = particles.log_weights - particles.log_weights.max()
    if label is None:
        draw = np.exp(exponent * relative)
        drawn = systematic(draw, count, rng=rng)
    else:
        draw = np.exp(0.5 * relative)
        own = np.bincount(label + 1, draw)
        target = np.bincount(label + 1, np.exp(relative)) ** exponent
        draw *= np.divide(target, own, out=np.zeros_like(own), where=own > 1e-200)[label + 1]
        order = np.argsort(label.astype(np.int32), kind="stable")
        drawn = order[systematic(draw[order], count, rng=rng)]
    log_weights = particles.log_weights[drawn] - np.log(draw[drawn])
    return drawn, log_weights - log_sum(log_weights)


def regularise(
    centres: Poses,
    log_weights: Float64[np.ndarray, " k"],
    label: Int64[np.ndarray, " k"],
    ancestor: Int64[np.ndarray, " k"],
    *,
    scale: float,
) -> tuple[Poses, Float64[np.ndarray, "k 2"]]:
    """Give the particles of each hypothesis kernels wide enough to cover it, and draw them together by as much.

    The width is `scale` times the optimal one for a Gaussian (Silverman 1986) as wide as the hypothesis along its
    narrowest axis, with its effective number of particles. Centres move towards the hypothesis' mean so that kernels
    added to them restore its mean and covariance; nothing is smoothed across hypotheses. Centres of no hypothesis stay,
    with the width of the narrowest one.

    Args:
        centres: world_from_camera, (k,).
        log_weights: Log weights, (k,).
        label: Hypothesis of every centre, −1 where it belongs to none, (k,).
        ancestor: The particle that each centre is, (k,): duplicates are one particle.
        scale: 0 for no smoothing, 1 for the optimum of a Gaussian.

    Returns:
        The centres, and their standard deviations along and about each axis, metres and radians, (k, 2).
    """
    own = np.flatnonzero(label >= 0)
    if scale <= 0.0 or len(own) == 0:
        return centres, np.zeros((len(label), 2))
    found, group = np.unique(label[own], return_inverse=True)
    largest = np.full(len(found), -np.inf)
    np.maximum.at(largest, group, log_weights[own])
    weights = np.exp(log_weights[own] - largest[group])
    means, covariance, tangent = group_moments(centres[own], weights, group, len(found))
    # In units of its mean spread in translation and in rotation, a hypothesis is as wide as its least eigenvalue says.
    variances = np.diagonal(covariance, axis1=1, axis2=2).reshape(-1, 2, 3).mean(axis=2)
    unit = np.repeat(np.sqrt(np.maximum(variances, 1e-18)), 3, axis=1)
    eigenvalues, axes = np.linalg.eigh(covariance / (unit[:, :, None] * unit[:, None, :]))
    silverman = (0.5 / _effective_numbers(weights, group, ancestor[own])) ** 0.1  # (4 / (d+2) n)^(1 / (d+4)) for d = 6
    added = (scale * silverman) ** 2 * np.maximum(eigenvalues[:, 0], 0.0)
    kept = np.sqrt(1.0 - added[:, None] / np.maximum(eigenvalues, added[:, None] + 1e-12))
    shrink = (axes * kept[:, None, :]) @ np.swapaxes(axes, 1, 2)
    moved = means[group] @ Poses.exp(np.einsum("nij,nj->ni", shrink[group], tangent / unit[group]) * unit[group])
    rotation, translation = centres.rotation.copy(), centres.translation.copy()
    rotation[own], translation[own] = moved.rotation, moved.translation
    group_widths = np.sqrt(added)[:, None] * unit[:, [0, 3]]
    widths = np.tile(group_widths.min(axis=0), (len(label), 1))
    widths[own] = group_widths[group]
    return Poses(rotation, translation), widths


def _effective_numbers(
    weights: Float64[np.ndarray, " k"], group: Int64[np.ndarray, " k"], ancestor: Int64[np.ndarray, " k"]
) -> Float64[np.ndarray, " g"]:
    """(Σ w)² / Σ w² of every group over its distinct ancestors (Kong et al. 1994)."""
    _, first, particle = np.unique(ancestor, return_index=True, return_inverse=True)
    together = np.bincount(particle, weights)
    return np.bincount(group, weights) ** 2 / np.bincount(group[first], together**2)
