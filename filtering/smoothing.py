"""Estimates and odometry -> smoothed trajectory: a GTSAM factor graph that resolves the start in hindsight.

Per image the factor is a mixture over the modes of its posterior, handled as max-mixture (Olson and Agarwal, "Inference
on networks of mixtures", 2013): the mode that fits best speaks, through a robust kernel. GTSAM's Pose3 tangent is
rotation first; the one permutation lives here.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import gtsam
import numpy as np
from jaxtyping import Bool, Float64

from filtering.errors import VaporTrackError, require_within
from filtering.estimate import Mode
from filtering.motion import Odometry
from filtering.se3 import Poses

_ROTATION_FIRST = np.array([3, 4, 5, 0, 1, 2])


@dataclass(frozen=True)
class SmoothingConfig:
    """Settings of the smoother."""

    robust_scale: float = 2.0
    """Scale of the Cauchy kernel on a mode's residual, in standard deviations."""
    correlation: float = 5.0
    """Neighbouring images share their errors: this many count as one independent measurement."""
    rounds: int = 3
    """How often modes are chosen anew for the trajectory found."""

    def __post_init__(self) -> None:
        require_within(
            self,
            robust_scale=(1e-3, 1e6),
            correlation=(1.0, 1e6),
            rounds=(1, 1000),
        )


def smooth(
    image_modes: Sequence[tuple[Mode, ...]],
    odometry: Sequence[Odometry | None],
    filtered: Poses,
    converged: Bool[np.ndarray, " n"],
    config: SmoothingConfig | None = None,
) -> Poses:
    """The most likely trajectory given all images and all odometry.

    Args:
        image_modes: For every image the modes of its own posterior, n of them.
        odometry: Motion since the previous image, n; the first is not used. None splits the trajectory.
        filtered: Best modes of the filter, world_from_camera, batch (n,).
        converged: Which of them the filter was sure of, (n,).
        config: Settings.

    Returns:
        world_from_camera, batch (n,).

    Raises:
        VaporTrackError: the lengths differ.
    """
    config = config or SmoothingConfig()
    if not len(image_modes) == len(odometry) == len(filtered) == len(converged):
        raise VaporTrackError(
            f"smoothing needs as many mode lists, odometry increments, poses and flags, got {len(image_modes)}, "
            f"{len(odometry)}, {len(filtered)} and {len(converged)}"
        )
    if len(filtered) == 0:
        return filtered
    breaks = [0, *(i for i in range(1, len(filtered)) if odometry[i] is None), len(filtered)]
    parts = []
    for start, stop in itertools.pairwise(breaks):
        steps = [odom for odom in odometry[start + 1 : stop] if odom is not None]
        modes = image_modes[start:stop]
        guesses = _initial_guesses(filtered[start:stop], steps, converged[start:stop])
        solutions = [_optimise(guess, modes, steps, config) for guess in guesses]
        parts.append(min(solutions, key=lambda solution: solution[1])[0])
    return Poses.concatenate(parts)


def _initial_guesses(filtered: Poses, steps: Sequence[Odometry], converged: np.ndarray) -> list[Poses]:
    """Whole trajectories that obey odometry where the filter was unsure: from its last, and from its sure stretches."""
    n = len(filtered)
    anchored = converged.copy()
    if not anchored.any():
        anchored[-1] = True
    from_stretches = _chain(filtered, steps, anchored)
    last_sure = np.zeros(n, bool)
    last_sure[np.flatnonzero(anchored)[-1]] = True
    return [from_stretches, _chain(filtered, steps, last_sure)]


def _chain(filtered: Poses, steps: Sequence[Odometry], anchored: np.ndarray) -> Poses:
    """Keep the anchored poses; fill backward by odometry from the next anchor, and forward behind the last."""
    poses = [filtered[i] for i in range(len(filtered))]
    last = int(np.flatnonzero(anchored)[-1])
    for i in range(last + 1, len(poses)):
        poses[i] = poses[i - 1] @ steps[i - 1].previous_from_current
    for i in range(last - 1, -1, -1):
        if not anchored[i]:
            poses[i] = poses[i + 1] @ steps[i].previous_from_current.inverse()
    return Poses.stack(poses)


def _optimise(
    guess: Poses, modes: Sequence[tuple[Mode, ...]], steps: Sequence[Odometry], config: SmoothingConfig
) -> tuple[Poses, float]:
    """Alternate between choosing each image's mode and solving the graph; returns the poses and their error."""
    odometry_factors = [
        gtsam.BetweenFactorPose3(i, i + 1, _to_gtsam(step.previous_from_current), _gaussian(step.covariance))
        for i, step in enumerate(steps)
    ]
    mode_factors = [[_mode_factor(i, mode, config) for mode in choices] for i, choices in enumerate(modes)]
    values = gtsam.Values()
    for i in range(len(guess)):
        values.insert(i, _to_gtsam(guess[i]))
    error = np.inf
    for _ in range(config.rounds):
        graph, choice_cost = gtsam.NonlinearFactorGraph(), 0.0
        for factor in odometry_factors:
            graph.add(factor)
        for factors in mode_factors:
            chosen, cost = min(factors, key=lambda factor: factor[1] + factor[0].error(values))
            graph.add(chosen)
            choice_cost += cost
        optimiser = gtsam.LevenbergMarquardtOptimizer(graph, values)
        values = optimiser.optimize()
        before, error = error, optimiser.error() + choice_cost
        if before - error < 1e-3 * abs(before):
            break
    poses = Poses.from_matrix(np.stack([values.atPose3(i).matrix() for i in range(len(guess))]))
    return poses, float(error)


def _mode_factor(key: int, mode: Mode, config: SmoothingConfig) -> tuple[gtsam.NonlinearFactor, float]:
    """A robust factor towards one mode, and what choosing this mode costs: −log of its weight and of its normaliser."""
    gaussian = _gaussian(config.correlation * mode.covariance)
    kernel = gtsam.noiseModel.mEstimator.Cauchy.Create(config.robust_scale)
    factor = gtsam.PriorFactorPose3(
        key, _to_gtsam(mode.world_from_camera), gtsam.noiseModel.Robust.Create(kernel, gaussian)
    )
    half_log_det = 0.5 * float(np.linalg.slogdet(mode.covariance + 1e-8 * np.eye(6))[1])
    return factor, (half_log_det - float(np.log(max(mode.weight, 1e-6)))) / config.correlation


def _gaussian(covariance: Float64[np.ndarray, "6 6"]) -> gtsam.noiseModel.Gaussian:
    # A tenth of a millimetre and of a milliradian keep exact odometry and modes of one sample invertible.
    regular = covariance + 1e-8 * np.eye(6)
    return gtsam.noiseModel.Gaussian.Covariance(regular[np.ix_(_ROTATION_FIRST, _ROTATION_FIRST)])


def _to_gtsam(pose: Poses) -> gtsam.Pose3:
    return gtsam.Pose3(gtsam.Rot3(pose.rotation), pose.translation)
