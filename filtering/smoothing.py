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
from jaxtyping import Bool, Float64, Int64

from filtering.errors import VaporTrackError, require_within
from filtering.estimate import Mode
from filtering.motion import Odometry
from filtering.se3 import Poses

SMOOTHED_MODES = 6
"""Of each image, the heaviest: enough for the smoother, and bounded in memory over a long sequence."""

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
        modes = _ImageModes(image_modes[start:stop], config)
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


class _ImageModes:
    """The modes of all images as arrays, k modes in all, to choose among them in one go."""

    def __init__(self, modes: Sequence[tuple[Mode, ...]], config: SmoothingConfig) -> None:
        flat = [mode for choices in modes for mode in choices]
        counts = np.array([len(choices) for choices in modes])
        self.poses = Poses.stack([mode.world_from_camera for mode in flat])
        # A tenth of a millimetre and of a milliradian keep modes of equal samples regular.
        self.covariance = config.correlation * (np.stack([mode.covariance for mode in flat]) + 1e-8 * np.eye(6))
        self._scale_sq = config.robust_scale**2
        self._image = np.repeat(np.arange(len(modes)), counts)
        self._first = np.cumsum(counts) - counts
        self._information = np.linalg.inv(self.covariance)
        log_weight = np.log([max(mode.weight, 1e-6) for mode in flat])
        self._cost = (0.5 * np.linalg.slogdet(self.covariance)[1] - log_weight) / config.correlation

    def choose(self, trajectory: Poses) -> tuple[Int64[np.ndarray, " n"], float]:
        """Index of the mode that explains each image best, and what these choices cost for weight and normaliser."""
        residual = (self.poses.inverse() @ trajectory[self._image]).log()
        squared = np.einsum("ki,kij,kj->k", residual, self._information, residual)
        error = 0.5 * self._scale_sq * np.log1p(squared / self._scale_sq) + self._cost
        chosen = np.lexsort((error, self._image))[self._first]
        return chosen, float(self._cost[chosen].sum())


def _optimise(
    guess: Poses, modes: _ImageModes, steps: Sequence[Odometry], config: SmoothingConfig
) -> tuple[Poses, float]:
    """Alternate between choosing each image's mode and solving the graph; returns the poses and their error."""
    odometry_graph = gtsam.NonlinearFactorGraph()
    for i, step in enumerate(steps):
        noise = _gaussian(step.covariance + 1e-8 * np.eye(6))  # exact odometry stays invertible
        odometry_graph.add(gtsam.BetweenFactorPose3(i, i + 1, _to_gtsam(step.previous_from_current), noise))
    kernel = gtsam.noiseModel.mEstimator.Cauchy.Create(config.robust_scale)
    poses, error = guess, np.inf
    for _ in range(config.rounds):
        chosen, cost = modes.choose(poses)
        graph = gtsam.NonlinearFactorGraph(odometry_graph)
        for i, k in enumerate(chosen):
            noise = gtsam.noiseModel.Robust.Create(kernel, _gaussian(modes.covariance[k]))
            graph.add(gtsam.PriorFactorPose3(i, _to_gtsam(modes.poses[k]), noise))
        values = gtsam.Values()
        for i in range(len(poses)):
            values.insert(i, _to_gtsam(poses[i]))
        optimiser = gtsam.LevenbergMarquardtOptimizer(graph, values)
        solved = optimiser.optimize()
        poses = Poses.from_matrix(np.stack([solved.atPose3(i).matrix() for i in range(len(guess))]))
        before, error = error, optimiser.error() + cost
        if before - error < 1e-3 * abs(before):
            break
    return poses, float(error)


def _gaussian(covariance: Float64[np.ndarray, "6 6"]) -> gtsam.noiseModel.Gaussian:
    return gtsam.noiseModel.Gaussian.Covariance(covariance[np.ix_(_ROTATION_FIRST, _ROTATION_FIRST)])


def _to_gtsam(pose: Poses) -> gtsam.Pose3:
    return gtsam.Pose3(gtsam.Rot3(pose.rotation), pose.translation)
