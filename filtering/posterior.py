"""What one image says about the camera's pose: two protocols, and the samples that fulfil them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol, TypeVar, runtime_checkable

import numpy as np
from jaxtyping import Float64

from filtering.density import KernelDensity
from filtering.errors import VaporTrackError
from filtering.se3 import Poses


@runtime_checkable
class PosePosterior(Protocol):
    """The distribution of camera poses for one image."""

    def sample(self, num_samples: int, *, rng: np.random.Generator) -> Poses:
        """Draw world_from_camera poses, batch (num_samples,), from p(pose | image)."""
        ...

    def log_density(self, poses: Poses) -> Float64[np.ndarray, " n"]:
        """Log p(pose | image) of poses (n,), per m³ rad³, normalised."""
        ...

    def log_prior(self, poses: Poses) -> Float64[np.ndarray, " n"]:
        """Log π(pose) of poses (n,), per m³ rad³: where a camera can be before any image is seen."""
        ...

    def log_likelihood(self, poses: Poses) -> Float64[np.ndarray, " n"]:
        """Log p(image | pose) of poses (n,), up to a constant of the image."""
        ...


Posterior = TypeVar("Posterior", bound=PosePosterior, covariant=True)


@runtime_checkable
class ObservationModel(Protocol[Posterior]):
    """Maps an image to its posterior: one network call per image."""

    def observe(self, image: np.ndarray, *, rng: np.random.Generator) -> Posterior:
        """The posterior of one image, (H, W, 3) uint8 RGB."""
        ...


@dataclass(frozen=True)
class LikelihoodModel:
    """How a posterior becomes a likelihood: L(y) = [(1 − ε) p̂(y|x)/max(π(y), π_min) + ε]^β, divided by ε^β.

    Attributes:
        prior: π, the mean of the posteriors over many images; None where it is unknown and taken as flat, π_min.
        outlier_floor: ε of an image that says nothing, in units of the ratio p̂/π.
        temper: β ≤ 1: neighbouring images share their errors, and samples of the network are not calibrated. (A trained
            model brings its own, lower one.)
        prior_floor: π_min, per m³ rad³.
    """

    prior: KernelDensity | None = None
    outlier_floor: float = 0.05
    temper: float = 0.3
    prior_floor: float = 1e-4

    def log_prior(self, poses: Poses) -> Float64[np.ndarray, " n"]:
        """Log of max(π, π_min) at poses (n,)."""
        log_floor = float(np.log(self.prior_floor))
        if self.prior is None:
            return np.full(len(poses), log_floor)
        return np.maximum(log_floor, self.prior.log_density(poses, log_floor=log_floor))

    def log_likelihood(
        self, log_density: Float64[np.ndarray, " n"], log_prior: Float64[np.ndarray, " n"]
    ) -> Float64[np.ndarray, " n"]:
        """Log L from log p̂ and log π at the same poses, (n,); 0 where only the outlier floor is left."""
        ratio = np.log1p(-self.outlier_floor) - np.log(self.outlier_floor) + log_density - log_prior
        return self.temper * np.logaddexp(ratio, 0.0)


@dataclass(frozen=True)
class PosteriorSamples:
    """A posterior given by samples: their kernel density, and the likelihood it implies.

    Attributes:
        density: Kernel density over the samples, p̂.
        likelihood: How p̂ becomes a likelihood.
    """

    density: KernelDensity
    likelihood: LikelihoodModel = field(default_factory=LikelihoodModel)
    _evaluated: list[tuple[Poses, np.ndarray, np.ndarray]] = field(default_factory=list, repr=False, compare=False)

    @staticmethod
    def from_estimates(
        estimates: Poses,
        std_m: float | Float64[np.ndarray, " m"],
        std_rad: float | Float64[np.ndarray, " m"],
        *,
        outlier_share: float,
        outlier_spread: float,
        likelihood: LikelihoodModel,
    ) -> PosteriorSamples:
        """The posterior of an image of which some methods give one pose each: one of them is right, any as likely.

        Each estimate is a kernel of its stated uncertainty and, as the errors of pose estimators have heavy tails, a
        wide one beside it. Estimates that agree make no narrower a posterior: they see the same image.

        Args:
            estimates: world_from_camera, batch (m,), m ≥ 1.
            std_m: Stated standard deviation along each axis, metres; of all estimates or of each.
            std_rad: Stated standard deviation about each axis, radians; of all estimates or of each.
            outlier_share: Share of the wide kernels, inside (0, 1).
            outlier_spread: How many times wider they are, at least 1.
            likelihood: How the density becomes a likelihood.

        Raises:
            VaporTrackError: no estimate, or a number out of its range.
        """
        if not 0.0 < outlier_share < 1.0 or not outlier_spread >= 1.0:
            raise VaporTrackError(
                f"outlier share {outlier_share} and spread {outlier_spread}, expected inside (0, 1) and at least 1"
            )
        m = len(estimates)
        spread = np.repeat([1.0, outlier_spread], m)
        weights = np.repeat([1.0 - outlier_share, outlier_share], m) / m
        density = KernelDensity(
            Poses.concatenate([estimates, estimates]),
            spread * np.tile(np.broadcast_to(std_m, m), 2),
            spread * np.tile(np.broadcast_to(std_rad, m), 2),
            np.log(weights),
        )
        return PosteriorSamples(density, likelihood)

    @property
    def poses(self) -> Poses:
        """The samples themselves, world_from_camera, batch (m,)."""
        return self.density.centres

    def sample(self, num_samples: int, *, rng: np.random.Generator) -> Poses:
        """Draw poses (num_samples,) from the kernel density."""
        return self.density.sample(num_samples, rng=rng)

    def log_density(self, poses: Poses) -> Float64[np.ndarray, " n"]:
        """Log p̂(pose | image) of poses (n,), per m³ rad³."""
        return self._evaluate(poses)[0]

    def log_prior(self, poses: Poses) -> Float64[np.ndarray, " n"]:
        """Log π(pose) of poses (n,), per m³ rad³."""
        return self._evaluate(poses)[1]

    def log_likelihood(self, poses: Poses) -> Float64[np.ndarray, " n"]:
        """Log p(image | pose) of poses (n,), 0 where only the outlier floor is left."""
        return self.likelihood.log_likelihood(*self._evaluate(poses))

    def _evaluate(self, poses: Poses) -> tuple[np.ndarray, np.ndarray]:
        """Log p̂ and log π; the filter asks all three densities of the same poses, the kernels are summed once."""
        if not self._evaluated or self._evaluated[0][0] is not poses:
            values = self.density.log_density(poses), self.likelihood.log_prior(poses)
            self._evaluated[:] = [(poses, *values)]
        return self._evaluated[0][1:]
