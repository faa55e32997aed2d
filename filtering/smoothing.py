"""Estimates and odometry -> smoothed trajectory: a GTSAM factor graph that resolves the start in hindsight.

Per image the factor is a mixture over the modes of its posterior, handled as max-mixture (Olson and Agarwal, "Inference
on networks of mixtures", 2013): the mode that fits best counts, with the tails of the measurement noise. Images with
correlated errors share their information, and odometry bias widen its noise. GTSAM's Pose3 tangent is
rotation first; the one permutation lives here.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field

import gtsam
import numpy as np
from jaxtyping import Bool, Float64, Int64
from scipy.linalg import solveh_banded
from scipy.special import gammaln

from filtering.config import LocalizerConfig
from filtering.errors import VaporTrackError, require_within
from filtering.estimate import Mode
from filtering.hypotheses import BIAS, POSE
from filtering.measurement_noise import PLACE, MeasurementNoise
from filtering.motion import Odometry, OdometryBias
from filtering.prediction import motion_of_state
from filtering.se3 import Poses

SMOOTHED_MODES = 6
"""Number of modes of each image that the smoother takes, the heaviest."""

_ABOUT_NS, _ABOUT_IMAGES = 500_000_000, 5  # what is about an image, to each side
_REGULAR = 1e-8 * np.eye(6)  # a tenth of a millimetre and of a milliradian keep modes of equal samples regular
_FAR = 10.0
_STANDING = 1e-9  # lengths: no distance is shorter, which keeps correlations regular
_ROTATION_FIRST = np.array([3, 4, 5, 0, 1, 2])


@dataclass(frozen=True)
class SmoothingConfig:
    """Settings of the smoother."""

    rounds: int = 3
    """Largest number of alternations between choosing modes and solving."""
    odometry_bias: OdometryBias = field(default_factory=lambda: LocalizerConfig().odometry_bias)
    """Scale error and drift of the odometry; as of the particle filter."""
    cover_s: float = 10.0
    """Time over which the noise of odometry is widened to cover them, seconds."""

    def __post_init__(self) -> None:
        require_within(self, rounds=(1, 1000), cover_s=(0.0, 1e9))


def independence(distances: Float64[np.ndarray, " n"], correlated_fraction: float) -> Float64[np.ndarray, " n"]:
    """The fraction of an independent measurement that each image of a sequence is worth, in (0, 1].

    These are the weights K⁻¹ 1 of the best linear estimate of one pose, and their sum 1ᵀ K⁻¹ 1 is the number of
    independent images that all are worth. K are the correlations of their errors, `correlated_fraction` · exp(−distance
    between them). Images taken standing are worth 1 / correlated_fraction together. On a long path in even steps g
    each is worth 1 / (1 − correlated_fraction + correlated_fraction · coth(g/2)).

    Args:
        distances: Normalized distance that the camera moved since the image before, see `Estimate`; the first is not
            used.
        correlated_fraction: Fraction of the error's variance that is correlated, in [0, 1).
    """
    n = len(distances)
    if n < 2:
        return np.ones(n)
    # K = l C + (1 − l), where C⁻¹ has three diagonals: (l + (1 − l) C⁻¹) w = C⁻¹ 1.
    steps = np.maximum(distances[1:], _STANDING)
    kept, inverse = np.exp(-steps), -1.0 / np.expm1(-2.0 * steps)
    diagonal, alone = np.ones(n), np.ones(n)  # of C⁻¹, and C⁻¹ 1
    for part in (slice(1, None), slice(None, -1)):
        diagonal[part] += inverse - 1.0
        alone[part] += 1.0 / (1.0 + kept) - 1.0
    banded = np.zeros((2, n))
    banded[0, 1:] = -(1.0 - correlated_fraction) * kept * inverse
    banded[1] = correlated_fraction + (1.0 - correlated_fraction) * diagonal
    return np.clip(solveh_banded(banded, alone), 1e-9, 1.0)


def smooth(
    image_modes: Sequence[tuple[Mode, ...]],
    odometry: Sequence[Odometry | None],
    distances: Float64[np.ndarray, " n"],
    filtered: Poses,
    converged: Bool[np.ndarray, " n"],
    noise: MeasurementNoise,
    config: SmoothingConfig | None = None,
) -> Poses:
    """The most likely trajectory given all images and all odometry.

    Args:
        image_modes: For every image the modes of its own posterior, n of them; none for an uninformative one.
        odometry: Motion since the previous image, n; the first is not used. None splits the trajectory.
        distances: Normalized distance that the camera moved since the image before
            (`Estimate.normalized_distance`), (n,).
        filtered: Best modes of the filter, world_from_camera, batch (n,).
        converged: Whether the filter had converged, (n,).
        noise: Noise of the images.
        config: Settings.

    Returns:
        world_from_camera, batch (n,).

    Raises:
        VaporTrackError: the lengths differ.
    """
    config = config or SmoothingConfig()
    if not len(image_modes) == len(odometry) == len(distances) == len(filtered) == len(converged):
        raise VaporTrackError(
            "smoothing needs as many mode lists, odometry increments, distances, poses and flags, got "
            f"{len(image_modes)}, {len(odometry)}, {len(distances)}, {len(filtered)} and {len(converged)}"
        )
    if len(filtered) == 0:
        return filtered
    breaks = [0, *(i for i in range(1, len(filtered)) if odometry[i] is None), len(filtered)]
    parts = []
    for start, stop in itertools.pairwise(breaks):
        steps = [odom for odom in odometry[start + 1 : stop] if odom is not None]
        modes = _ImageModes(image_modes[start:stop], distances[start:stop], noise)
        guesses = _initial_guesses(filtered[start:stop], steps, converged[start:stop])
        solutions = [_optimise(guess, modes, steps, config) for guess in guesses]
        parts.append(min(solutions, key=lambda solution: solution[1])[0])
    return Poses.concatenate(parts)


def trajectory_agreement(
    trajectory: Poses,
    times_ns: Int64[np.ndarray, " n"],
    image_modes: Sequence[tuple[Mode, ...]],
    noise: MeasurementNoise,
) -> Float64[np.ndarray, " n"]:
    """How well each pose of a trajectory fits the images about it, like the filter's agreement for a belief.

    A pose is as possible as the places near it (see `filtering.association`), here relative to the image's most
    possible place. This is averaged over the images within half a second, and five to each side at least. It is small
    where wrong odometry pulls a smoothed trajectory away from its images.

    Args:
        trajectory: world_from_camera, batch (n,).
        times_ns: Stamps, increasing, (n,).
        image_modes: For every image the heaviest modes of its own posterior, n of them; none for an uninformative one.
        noise: Noise of the images.

    Returns:
        From 0 to 1, (n,); 0 where no image about a pose is informative.
    """
    n = len(trajectory)
    fits, informative = np.zeros(n), np.array([len(modes) > 0 for modes in image_modes], bool)
    in_map = _within_map(trajectory, [mode for modes in image_modes for mode in modes], noise)
    for i in np.flatnonzero(informative).tolist():
        modes = image_modes[i]
        residual = (Poses.stack([mode.world_from_camera for mode in modes]).inverse() @ trajectory[i]).log()
        information = np.linalg.inv(np.stack([mode.covariance for mode in modes]) + _REGULAR)
        near = np.exp(-0.5 * np.einsum("ki,kij,kj->k", residual, information, residual) / PLACE**2)
        weight = np.array([mode.weight for mode in modes])
        rest = max(1.0 - weight.sum(), 0.0)  # of modes that were left out, one of which may be near within the map
        sums = weight @ near + in_map[i] * rest, weight.max() + rest
        possible, most = (s / (s + noise.possible_fraction) for s in sums)
        fits[i] = min(possible / most, 1.0)
    at = np.arange(n)
    first = np.minimum(np.searchsorted(times_ns, times_ns - _ABOUT_NS), np.maximum(at - _ABOUT_IMAGES, 0))
    last = np.maximum(
        np.searchsorted(times_ns, times_ns + _ABOUT_NS, side="right"), np.minimum(at + _ABOUT_IMAGES + 1, n)
    )
    summed, count = (np.concatenate([[0.0], np.cumsum(values)]) for values in (fits, informative))
    return (summed[last] - summed[first]) / np.maximum(count[last] - count[first], 1.0)


def _within_map(trajectory: Poses, modes: Sequence[Mode], noise: MeasurementNoise) -> Bool[np.ndarray, " n"]:
    """Whether poses are near enough for a mode beyond those given: within ten times the extent of all modes."""
    if not modes:
        return np.zeros(len(trajectory), bool)
    positions = np.stack([mode.world_from_camera.translation for mode in modes])
    middle = positions.mean(axis=0)
    furthest_m = np.linalg.norm(positions - middle, axis=1).max() + noise.map_size_m
    return np.linalg.norm(trajectory.translation - middle, axis=1) <= _FAR * furthest_m


def _initial_guesses(filtered: Poses, steps: Sequence[Odometry], converged: np.ndarray) -> list[Poses]:
    """Two trajectories that follow odometry where the filter had not converged: from each pose where it had, and from
    the last one alone."""
    n = len(filtered)
    anchored = converged.copy()
    if not anchored.any():
        anchored[-1] = True
    from_segments = _chain(filtered, steps, anchored)
    last_sure = np.zeros(n, bool)
    last_sure[np.flatnonzero(anchored)[-1]] = True
    return [from_segments, _chain(filtered, steps, last_sure)]


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
    """The modes of all images as arrays, k modes in all.

    A mode's cost is the negative log density of a Student t distribution, by how independent its image is: a Cauchy
    kernel on the residual by a covariance that is narrower than the mode's at the middle.
    """

    def __init__(
        self, modes: Sequence[tuple[Mode, ...]], distances: Float64[np.ndarray, " n"], noise: MeasurementNoise
    ) -> None:
        flat = [mode for choices in modes for mode in choices]
        counts = np.array([len(choices) for choices in modes])
        self.images = np.flatnonzero(counts)
        self._image = np.repeat(np.arange(len(modes)), counts)
        self._first = (np.cumsum(counts) - counts)[self.images]
        self.poses = Poses.stack([mode.world_from_camera for mode in flat]) if flat else Poses.identity(0)
        stated = np.stack([mode.covariance for mode in flat]) + _REGULAR if flat else np.zeros((0, 6, 6))
        verified = np.array([mode.verified for mode in flat], bool)
        degrees_of_freedom = np.where(verified, noise.finest.degrees_of_freedom, noise.degrees_of_freedom)
        of_image = np.ones(len(modes))
        travelled = np.cumsum(distances)
        since = np.diff(travelled[self.images], prepend=0.0)
        of_image[self.images] = independence(since, noise.correlated_fraction)
        exact = np.unique(self._image[verified])  # images with verified modes
        # Distances are in lengths of the network's errors; landmarks have others.
        ratios = noise.length_m / noise.finest.length_m, noise.length_rad / noise.finest.length_rad
        since = np.diff(travelled[exact], prepend=0.0) * min(ratios)  # moved or turned
        of_image[exact] = independence(since, noise.finest.correlated_fraction)
        worth = of_image[self._image]
        self.kernel = np.sqrt((degrees_of_freedom + 6.0) * worth)
        self.covariance = stated * (degrees_of_freedom / np.square(self.kernel))[:, None, None]
        self._information = np.linalg.inv(self.covariance)
        log_weight = np.log([max(mode.weight, 1e-6) for mode in flat])
        log_peak = (
            gammaln((degrees_of_freedom + 6.0) / 2.0)
            - gammaln(degrees_of_freedom / 2.0)
            - 3.0 * np.log(degrees_of_freedom * np.pi)
        )
        self._cost = worth * (0.5 * np.linalg.slogdet(stated)[1] - log_peak - log_weight)

    def choose(self, trajectory: Poses) -> tuple[Int64[np.ndarray, " c"], float]:
        """Index of the best mode for each of `images`, and the cost of these for weight and normaliser."""
        residual = (self.poses.inverse() @ trajectory[self._image]).log()
        squared = np.einsum("ki,kij,kj->k", residual, self._information, residual)
        error = 0.5 * self.kernel**2 * np.log1p(squared / self.kernel**2) + self._cost
        chosen = np.lexsort((error, self._image))[self._first]
        return chosen, float(self._cost[chosen].sum())


def _optimise(
    guess: Poses, modes: _ImageModes, steps: Sequence[Odometry], config: SmoothingConfig
) -> tuple[Poses, float]:
    """Poses and their error after alternating between choosing each image's mode and solving the graph."""
    odometry_graph = gtsam.NonlinearFactorGraph()
    for i, step in enumerate(steps):
        noise = _gaussian(_widened(step, config) + 1e-8 * np.eye(6))  # exact odometry stays invertible
        odometry_graph.add(gtsam.BetweenFactorPose3(i, i + 1, _to_gtsam(step.previous_from_current), noise))
    poses, error = guess, np.inf
    for _ in range(config.rounds):
        chosen, cost = modes.choose(poses)
        graph = gtsam.NonlinearFactorGraph(odometry_graph)
        if len(chosen) == 0:
            graph.add(gtsam.PriorFactorPose3(0, _to_gtsam(guess[0]), _gaussian(np.eye(6))))
        for i, k in zip(modes.images.tolist(), chosen.tolist(), strict=True):
            kernel = gtsam.noiseModel.mEstimator.Cauchy.Create(float(modes.kernel[k]))
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


def _widened(step: Odometry, config: SmoothingConfig) -> Float64[np.ndarray, "6 6"]:
    """Covariance of white noise that equals noise and odometry bias of an increment over `cover_s`."""
    odometry_bias = config.odometry_bias
    errs = motion_of_state(step, odometry_bias, [])[0][POSE, BIAS] * np.array([odometry_bias.scale, *6 * [1.0]])
    return step.noise + config.cover_s / max(step.duration_s, 1e-9) * (errs @ errs.T)


def _gaussian(covariance: Float64[np.ndarray, "6 6"]) -> gtsam.noiseModel.Gaussian:
    return gtsam.noiseModel.Gaussian.Covariance(covariance[np.ix_(_ROTATION_FIRST, _ROTATION_FIRST)])


def _to_gtsam(pose: Poses) -> gtsam.Pose3:
    return gtsam.Pose3(gtsam.Rot3(pose.rotation), pose.translation)
