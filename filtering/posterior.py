"""What one image says about the camera's pose: two protocols, and the samples that fulfil them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol, TypeVar, runtime_checkable

import numpy as np
from jaxtyping import Float64

from filtering.density import KernelDensity
from filtering.errors import VaporTrackError, require_within
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

    def log_likelihood(self, poses: Poses) -> Float64[np.ndarray, " n"]:
        """Log p(image | pose) of poses (n,), at least 0, and 0 where only the chance of an outlier is left.

        That constant matters: by how far the likelihood rises above 0 the filter tells a fitting image from one that
        fits nowhere (status "lost", recovery). One that stays below 0 says that nothing fits: the belief is not doubted
        for another place, and the status becomes lost.
        """
        ...


@runtime_checkable
class DetailedPosterior(PosePosterior, Protocol):
    """A posterior that trusts itself about where in a place the camera is, but not about which place it is."""

    def log_detail(self, poses: Poses) -> Float64[np.ndarray, " n"] | None:
        """Log of a further factor of p(image | pose) at poses (n,), which counts within a hypothesis only.

        None where `log_likelihood` says all.
        """
        ...


@runtime_checkable
class PoseDensity(Protocol):
    """A density over poses that can be drawn from and evaluated, both exactly: kernels, or a network's own."""

    @property
    def centres(self) -> Poses:
        """Poses that stand for it, world_from_camera, batch (m,)."""
        ...

    def sample(self, num_samples: int, *, rng: np.random.Generator) -> Poses:
        """Draw poses (num_samples,)."""
        ...

    def log_density(self, poses: Poses, *, near_only: bool = False) -> Float64[np.ndarray, " n"]:
        """Log density of poses (n,), per m³ rad³; `near_only`: −∞ will do where it is next to nothing."""
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
    """How a posterior becomes a likelihood, in two factors.

    Which place: log L(y) = β [min(e, c) + γ max(e − c, 0)], e(y) = log(1 + (1 − ε)/ε · p̂(y|x)/max(π(y), π_min)).
    It is 0 where only the outlier floor is left. A network trained on its best samples only (winners take all) knows
    which places are possible, but not how likely each is, and it errs alike on neighbouring images. So from the
    saturation c on a place is possible, and by how much it is preferred counts little.

    Where in the place: log D(y) = β_d (1 − exp(−e)) log(1 + r(y)/δ), r the posterior's density over the same one
    smoothed to the size of a place. What the image says of a place's details is cut off from the question which place
    it is (Plummer, "Cuts in Bayesian graphical models", 2015): see `Particles.keep_shares`.

    Attributes:
        prior: π, the mean of the posteriors over many images; None where it is unknown and taken as flat, π_min.
        outlier_floor: ε of an image that says nothing, in units of the ratio p̂/π.
        temper: β ≤ 1: neighbouring images share their errors, and samples of the network are not calibrated. (A trained
            model brings its own, lower one.)
        prior_floor: π_min, per m³ rad³.
        saturation: c, in units of e; ∞ where the posterior's shares can be trusted.
        preference: γ ≤ 1, how much of e counts beyond c.
        detail_temper: β_d ≤ 1.
        detail_floor: δ: how much of D is left where a place has no sample nearby.
    """

    prior: KernelDensity | None = None
    outlier_floor: float = 0.05
    temper: float = 0.3
    prior_floor: float = 1e-4
    saturation: float = np.inf
    preference: float = 0.0
    detail_temper: float = 0.2
    detail_floor: float = 0.05

    def __post_init__(self) -> None:
        require_within(
            self,
            outlier_floor=(1e-12, 1.0 - 1e-12),
            temper=(0.0, 1.0),
            prior_floor=(1e-300, 1e300),
            saturation=(0.0, np.inf),
            preference=(0.0, 1.0),
            detail_temper=(0.0, 1.0),
            detail_floor=(1e-12, 1e12),
        )

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
        evidence = self._evidence(log_density, log_prior)
        beyond = np.maximum(evidence - self.saturation, 0.0)
        return self.temper * (np.minimum(evidence, self.saturation) + self.preference * beyond)

    def log_detail(
        self,
        log_density: Float64[np.ndarray, " n"],
        log_place_density: Float64[np.ndarray, " n"],
        log_prior: Float64[np.ndarray, " n"],
    ) -> Float64[np.ndarray, " n"]:
        """Log D from log p̂, the same smoothed to the size of a place, and log π, at the same poses, (n,)."""
        log_ratio = log_density - log_place_density - np.log(self.detail_floor)
        possible = -np.expm1(-self._evidence(log_place_density, log_prior))
        return self.detail_temper * possible * np.logaddexp(log_ratio, 0.0)

    def _evidence(self, log_density: np.ndarray, log_prior: np.ndarray) -> np.ndarray:
        """e ≥ 0."""
        ratio = np.log1p(-self.outlier_floor) - np.log(self.outlier_floor) + log_density - log_prior
        return np.logaddexp(ratio, 0.0)


@dataclass(frozen=True)
class PosteriorSamples:
    """A posterior given by samples and their density, and the likelihood it implies.

    Attributes:
        density: p̂: the kernel density over the samples, or the exact one that they were drawn from.
        likelihood: How p̂ becomes a likelihood.
        places: The same smoothed to the size of a place, over some of the samples: it tells places apart, and p̂ tells
            where in a place. None where p̂ does both.
    """

    density: PoseDensity
    likelihood: LikelihoodModel = field(default_factory=LikelihoodModel)
    places: KernelDensity | None = None
    _evaluated: list[tuple[Poses, np.ndarray, np.ndarray, np.ndarray]] = field(
        init=False, default_factory=list, repr=False, compare=False
    )

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
        for name, std in (("std_m", std_m), ("std_rad", std_rad)):
            if np.shape(std) not in ((), (m,)):
                raise VaporTrackError(f"{name} has shape {np.shape(std)}, expected one number or ({m},)")
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
        """Draw poses (num_samples,) from p̂."""
        return self.density.sample(num_samples, rng=rng)

    def log_density(self, poses: Poses) -> Float64[np.ndarray, " n"]:
        """Log p̂(pose | image) of poses (n,), per m³ rad³; −∞ where it is 0 or, with `places`, next to that."""
        return self._evaluate(poses)[0]

    def log_likelihood(self, poses: Poses) -> Float64[np.ndarray, " n"]:
        """Log p(image | pose) of poses (n,), which place; 0 where only the outlier floor is left."""
        _, log_place_density, log_prior = self._evaluate(poses)
        return self.likelihood.log_likelihood(log_place_density, log_prior)

    def log_detail(self, poses: Poses) -> Float64[np.ndarray, " n"] | None:
        """Log p(image | pose) of poses (n,), where in a place; None without `places`."""
        return None if self.places is None else self.likelihood.log_detail(*self._evaluate(poses))

    def _evaluate(self, poses: Poses) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Log p̂, the same smoothed, log π; the filter asks for all at the same poses, the kernels are summed once."""
        if not self._evaluated or self._evaluated[0][0] is not poses:
            if self.places is None:
                log_density = log_place_density = self.density.log_density(poses)
            else:  # p̂ only tells where in a place, and what the image draws: far from all samples it may be nothing
                log_density = self.density.log_density(poses, near_only=True)
                log_place_density = self.places.log_density(poses)
            self._evaluated[:] = [(poses, log_density, log_place_density, self.likelihood.log_prior(poses))]
        return self._evaluated[0][1:]
