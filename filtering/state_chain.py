"""A chain of the filter's states over the images of a trajectory: priors, transitions and measurements of them.

A state is that of a hypothesis (the error of the pose, odometry bias, and the correlated error of each source of
places) and the constant error of the images, which is one more that never fades. Transitions and measurements are the
filter's, so that both have one model. `filtering.chain_solver` solves for the states.

Source: Olson and Agarwal, "Inference on networks of mixtures", 2013 (max-mixture: the most probable place counts).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int64
from scipy.linalg import solve_triangular
from scipy.special import gammaln

from filtering.association import UNUSUAL
from filtering.hypotheses import BIAS, DRIFT, POSE, along_map, correlated_error
from filtering.measurement_noise import MeasurementNoise
from filtering.motion import Odometry, OdometryBias
from filtering.posterior import PosePosterior
from filtering.prediction import motion_of_state
from filtering.se3 import Poses
from filtering.unchecked import unchecked_replace
from filtering.vertical import Vertical, VerticalMemory, whitened

_EXACT = 1e-5  # of a variance: what is known exactly keeps so much
_LEAST_SCALE = 1e-2  # standard deviation of the scale error of odometry, below which the unit is this
_UNKNOWN = 1e4  # ordinary variances of an image: a pose before its first
_LOOSE, _LEVER = 1e3, 1e5  # ordinary standard deviations of an image


class Transition(NamedTuple):
    """The transition of a state from an image to the next.

    Attributes:
        previous_from_current: The motion of the pose, one pose.
        matrix: Of the rest: the state after it is matrix · state + noise, (d, d).
        root_information: A matrix W with WᵀW the inverse covariance of the noise, (d, d).
        is_loose: Whether the motion says next to nothing of where the camera is afterwards.
    """

    previous_from_current: Poses
    matrix: Float64[np.ndarray, "d d"]
    root_information: Float64[np.ndarray, "d d"]
    is_loose: bool


class Prior(NamedTuple):
    """A Gaussian over a state: W (ξ, m − mean) = rest, with a unit covariance.

    Attributes:
        pose: world_from_camera, from which ξ is the error, one pose.
        mean: Of the other parts of the state, (d − 6,).
        root_information: W, (d, d).
        rest: (d,).
        units: See `Chain`.
    """

    pose: Poses
    mean: Float64[np.ndarray, " m"]
    root_information: Float64[np.ndarray, "d d"]
    rest: Float64[np.ndarray, " d"]
    units: Float64[np.ndarray, " d"]


@dataclass(frozen=True)
class Chain:
    """The estimated states of n images.

    Attributes:
        poses: world_from_camera, batch (n,).
        mean: Of the other parts of the states, (n, d − 6).
        units: Of the change of a state in factors, in which all parts are about 1, (d,): GTSAM squares them.
    """

    poses: Poses
    mean: Float64[np.ndarray, "n m"]
    units: Float64[np.ndarray, " d"]

    @staticmethod
    def from_prior(prior: Prior, poses: Poses) -> Chain:
        """States at given poses, batch (n,), with the prior's mean of the rest."""
        return Chain(poses, np.tile(prior.mean, (len(poses), 1)), prior.units)

    def part(self, which: slice) -> Chain:
        """Some of the states."""
        return Chain(self.poses[which], self.mean[which], self.units)


def unknown_prior(pose: Poses, noise: MeasurementNoise, odometry_bias: OdometryBias, num_sources: int) -> Prior:
    """The state at the first image, before it: the pose is as good as unknown.

    Args:
        pose: About which the pose is sought, one pose.
        noise: Noise of the images.
        odometry_bias: Of the odometry.
        num_sources: Number of the sources of places.
    """
    size = 13 + 6 * (num_sources + 1)
    units = np.ones(size)
    units[POSE] = noise.finest.typical_std
    units[BIAS.start] = max(odometry_bias.scale, _LEAST_SCALE)
    std = units.copy()
    std[POSE] = np.sqrt(_UNKNOWN) * np.asarray(noise.typical_std)
    std[BIAS.start] = max(odometry_bias.scale, 1e-2 * _LEAST_SCALE)
    return Prior(pose, np.zeros(size - 6), np.diag(1.0 / std), np.zeros(size), units)


def transition(
    odometry: Odometry,
    odometry_bias: OdometryBias,
    distances: Sequence[float],
    noise: MeasurementNoise,
    *,
    new_drift: bool = False,
) -> Transition:
    """The transition of a state by a motion, see `motion_of_state`.

    Args:
        odometry: The motion.
        odometry_bias: Its bias.
        distances: Normalized distance that the camera of each source moved.
        noise: Noise of the images.
        new_drift: Whether the drift is another one from here on, as at both ends of a gap in the odometry.
    """
    motion = motion_of_state(odometry, odometry_bias, [*distances, 0.0])
    matrix, covariance = motion.transition, motion.noise
    if new_drift:  # the drift of this motion is independent of the one before
        own = matrix[:, DRIFT].copy()
        covariance = covariance + own @ own.T
        matrix[:, DRIFT] = 0.0
    exact = np.full(len(matrix), _EXACT)
    exact[POSE] *= np.square(noise.finest.typical_std)
    exact[BIAS.start] *= max(odometry_bias.scale, _LEAST_SCALE) ** 2
    covariance[np.arange(len(matrix)), np.arange(len(matrix))] += exact
    factor = np.linalg.cholesky(covariance)
    root = solve_triangular(factor, np.eye(len(matrix)), lower=True, check_finite=False)
    ordinary = np.asarray(noise.typical_std)
    loose = np.sqrt(covariance.diagonal()[POSE]).max() > _LOOSE * ordinary.max()
    loose |= np.linalg.norm(odometry.tangent[:3]) > _LEVER * ordinary[:3].max()
    return Transition(odometry.previous_from_current, matrix, root, bool(loose))


class Places:
    """The places of n images as arrays, k places in all, and the verticals measured with them.

    Args:
        posteriors: Of the images.
        moved: Normalized distance that the camera moved since the image before, by source, (n, s).
        noise: Of each image, n; for its constant errors.
        first_source: Number of the first source of the camera of each image, (n,).
        verticals: Of each image, n, whose lasting error is the last source; empty for none.
        since: Lengths of that error from the vertical before to each image, (n,), where earlier ones came before these
            images; None where the first is one of these.
    """

    def __init__(
        self,
        posteriors: Sequence[PosePosterior],
        moved: Float64[np.ndarray, "n s"],
        noise: Sequence[MeasurementNoise],
        first_source: Int64[np.ndarray, " n"],
        verticals: Sequence[Vertical | None] = (),
        since: Float64[np.ndarray, " n"] | None = None,
    ) -> None:
        self._verticals: list[tuple[int, Vertical, VerticalMemory]] = []
        memory: VerticalMemory | None = None
        for i, vertical in enumerate(verticals):
            memory = None if memory is None else unchecked_replace(memory, since=memory.since + float(moved[i, -1]))
            if vertical is not None and vertical.degrees_of_freedom:
                memory = memory or VerticalMemory(moved.shape[1] - 1, vertical.lengths)
                memory = memory if since is None else unchecked_replace(memory, since=float(since[i]))
                self._verticals.append((i, vertical, memory))
                memory = memory.observe(vertical)
        images, sources, parts, constants = [], [], [], []
        self._constant = correlated_error(moved.shape[1])
        for i, posterior in enumerate(posteriors):
            if posterior.is_uninformative:
                continue
            for source, own in enumerate(posterior.sources):
                if len(own):
                    images.append(np.full(len(own), i))
                    sources.append(np.full(len(own), first_source[i] + source))
                    of_source = posterior.noise_of(source)
                    constants.append(noise[i].constant_covariance(posterior.covariances[own]))
                    numbers = [of_source.degrees_of_freedom, of_source.correlated_fraction]
                    numbers += [posterior.outlier_probability, posterior.noise.log_clutter_density]
                    parts.append((posterior.means[own], posterior.covariances[own], posterior.factors[own],
                                  posterior.weights[own], np.tile(numbers, (len(own), 1))))  # fmt: skip
        self.image = np.concatenate(images) if images else np.zeros(0, np.int64)
        self.source = np.concatenate(sources) if sources else np.zeros(0, np.int64)
        self._kept = np.exp(-moved)
        if not parts:
            self.poses = Poses.identity(0)
            return
        along = np.cumsum(moved, axis=0)
        self._since = moved.copy()  # since the last image with places of the source
        for source in range(moved.shape[1]):
            own = np.unique(self.image[self.source == source])
            self._since[own[1:], source] = np.diff(along[own, source])
        means, covariances, factors, weights, numbers = zip(*parts, strict=True)
        self.poses = Poses.concatenate(list(means))
        self.covariance, weight = np.concatenate(covariances), np.concatenate(weights)
        self.degrees_of_freedom, self.fraction, outlier, self._log_clutter = np.concatenate(numbers).T
        self._constant_factor = np.sqrt(np.concatenate(constants))  # diagonal
        self.factor = np.sqrt(self.fraction)[:, None, None] * np.concatenate(factors)
        self._information = np.linalg.inv(self.covariance)
        nu = self.degrees_of_freedom
        self._log_peak = (
            gammaln((nu + 6) / 2)
            - gammaln(nu / 2)
            - 3 * np.log(nu * np.pi)
            - 0.5 * np.linalg.slogdet(self.covariance)[1]
        )
        self._log_weight = np.log(np.maximum(weight, 1e-300)) + np.log1p(-outlier)
        self._log_outlier = np.log(outlier) + self._log_clutter
        self._first = np.flatnonzero(np.diff(self.image, prepend=-1))

    def choose(self, chain: Chain) -> Int64[np.ndarray, " c"]:
        """The most probable place of each image, where any is more probable than none of them."""
        if len(self.poses) == 0:
            return np.zeros(0, np.int64)
        residual = chain.poses[self.image].between(self.poses).log()
        nu, squared = self.degrees_of_freedom, np.einsum("ki,kij,kj->k", residual, self._information, residual)
        log_density = np.maximum(self._log_peak, self._log_clutter) - (nu + 6) / 2 * np.log1p(squared / nu)
        log_seen = self._log_weight + log_density
        chosen = np.lexsort((-log_seen, self.image))[self._first]
        return chosen[log_seen[chosen] > self._log_outlier[chosen]]

    def enlarged(self, chain: Chain, chosen: Int64[np.ndarray, " c"]) -> Float64[np.ndarray, " c"]:
        """Factor of the variance of the error of each place chosen: 1 of a usual one, see `filtering.association`."""
        if len(chosen) == 0:
            return np.ones(0)
        image, source = self.image[chosen], self.source[chosen]
        residual = chain.poses[image].between(self.poses[chosen]).log()
        own = (7 + 6 * source)[:, None] + np.arange(6)
        known = self._kept[image, source][:, None] * chain.mean[np.maximum(image - 1, 0)[:, None], own]
        first = image == 0
        known[first] = 0.0
        constant = chain.mean[image][:, slice(self._constant.start - 6, self._constant.stop - 6), None]
        rotations = chain.poses.rotation[image]
        of_errors = along_map(self.factor[chosen], rotations) @ known[:, :, None]
        of_errors += along_map(self._constant_factor[chosen], rotations) @ constant
        innovation = residual - of_errors[:, :, 0]
        lasting = np.where(first, 0.0, np.exp(-2.0 * self._since[image, source]))
        variance = 1.0 - self.fraction[chosen] * lasting
        squared = np.einsum("ki,kij,kj->k", innovation, self._information[chosen], innovation) / variance
        nu = self.degrees_of_freedom[chosen]
        larger = (nu + squared) / (nu + 6)
        return np.where(larger > UNUSUAL, larger, 1.0)

    def measurements(
        self, chain: Chain, chosen: Int64[np.ndarray, " c"], larger: Float64[np.ndarray, " c"]
    ) -> tuple[Float64[np.ndarray, "c 6 d"], Float64[np.ndarray, "c 6"]]:
        """Jacobian and value of each place chosen as a measurement of the state, in units of its error."""
        image, source = self.image[chosen], self.source[chosen]
        residual = chain.poses[image].between(self.poses[chosen]).log()
        jacobian = np.zeros((len(chosen), 6, 6 + chain.mean.shape[1]))
        jacobian[:, :, POSE] = np.eye(6)
        rotations = chain.poses.rotation[image]
        jacobian[:, :, self._constant] = along_map(self._constant_factor[chosen], rotations)
        usual = larger == 1.0
        for number in np.unique(source).tolist():
            of = np.flatnonzero(usual & (source == number))
            factors = along_map(self.factor[chosen[of]], rotations[of])
            jacobian[of, :, correlated_error(number)] = factors
        # Errors that are correlated over a distance of 2 are worth one image: those of an Ornstein-Uhlenbeck process.
        lasts = np.maximum(1.0, 2.0 / np.maximum(self._since[image, source], 1e-6))
        scale = np.where(usual, 1.0 - self.fraction[chosen], larger * lasts)
        whiten = np.linalg.inv(np.linalg.cholesky(scale[:, None, None] * self.covariance[chosen]))
        return whiten @ jacobian, (whiten @ residual[:, :, None])[:, :, 0]

    def vertical_measurements(
        self, chain: Chain
    ) -> Iterator[tuple[int, Float64[np.ndarray, "k d"], Float64[np.ndarray, " k"]]]:
        """Image, Jacobian and value of each vertical as a measurement of the state's change, in units of its error."""
        for i, vertical, memory in self._verticals:
            yield i, *whitened(vertical, chain.poses[i], chain.mean[i], memory)
