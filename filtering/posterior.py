"""What one image says about the camera's pose: two protocols, and the kernel density that fulfils them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from typing import Protocol, TypeVar, runtime_checkable

import numpy as np
from jaxtyping import Float64
from scipy.spatial.distance import cdist
from scipy.special import ive

from filtering.errors import VaporTrackError
from filtering.se3 import Poses

_BLOCK = 128  # kernel rows at a time: 128 × 1000 float32 fit a core's second-level cache and need no BLAS threads
_REACH = 9.0  # kernel widths: what lies beyond weighs less than e^−40 of a kernel's peak
_LEAST_TOTAL = 1e-11  # so that what is left out is below float32's precision


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
class KernelDensity:
    """Mixture of equal kernels on SE(3), one at each centre, in the chordal metric.

    The kernel is Gaussian in translation and isotropic matrix-Fisher in rotation, exp((cos θ − 1)/h_r²). Both are
    −½ of a squared Euclidean distance between embeddings [t/h_t, vec(R)/(√2 h_r)] ∈ R¹², so a kernel matrix is one
    matrix product. Near its centre the rotation kernel is a Gaussian of width h_r in the rotation vector.

    Attributes:
        centres: Batch (m,), m ≥ 1.
        bandwidth_translation_m: h_t, metres, one standard deviation along each axis.
        bandwidth_rotation_rad: h_r, radians, one standard deviation about each axis.
        log_weights: Log weights of the centres, normalised, (m,); None for equal weights.
    """

    centres: Poses
    bandwidth_translation_m: float
    bandwidth_rotation_rad: float
    log_weights: Float64[np.ndarray, " m"] | None = field(default=None)

    def __post_init__(self) -> None:
        if len(self.centres) == 0:
            raise VaporTrackError("a kernel density needs at least one centre, got an empty batch of poses")
        if not (self.bandwidth_translation_m > 0 and self.bandwidth_rotation_rad > 0):
            raise VaporTrackError(
                f"kernel bandwidths must be positive, got {self.bandwidth_translation_m} m"
                f" and {self.bandwidth_rotation_rad} rad"
            )

    @cached_property
    def log_normaliser(self) -> float:
        """Log of the kernel's integral over R³ × SO(3), with rotation volume 8π² (Lebesgue at the identity)."""
        k = 1.0 / self.bandwidth_rotation_rad**2
        rotation = 8 * np.pi**2 * (ive(0, k) - ive(1, k))
        return float(1.5 * np.log(2 * np.pi * self.bandwidth_translation_m**2) + np.log(rotation))

    def log_density(self, poses: Poses) -> Float64[np.ndarray, " n"]:
        """Log density of poses (n,), per m³ rad³.

        Poses are taken in blocks of neighbours; each block leaves out the kernels that are too far away to count. The
        kernel matrix is float32. A pose so far from every centre that too little is left of its kernels is computed
        again with all of them, relative to its largest exponent: it gets its true log density rather than −∞.
        """
        if len(poses) == 0:
            return np.empty(0)
        origin = self.centres.translation.mean(axis=0)
        centres, half_norm = self._embed(self.centres, origin)
        log_weights = -np.log(len(half_norm)) if self.log_weights is None else self.log_weights
        rows, row_half_norm = self._embed(poses, origin)
        # log kernel = a·c − ½|c|² − ½|a|²: the norms enter the product as two more columns. They cancel, so where they
        # are large against the kernel (narrow kernels, wide scenes) the product is taken in double precision.
        precision = np.float32 if max(half_norm.max(), row_half_norm.max()) < 4000.0 else np.float64
        right = np.column_stack([centres, log_weights - half_norm, np.ones(len(half_norm))]).astype(precision)
        left = np.column_stack([rows, np.ones(len(rows)), -row_half_norm]).astype(precision)
        total, top = np.empty(len(left), np.float32), np.zeros(len(left), np.float32)
        for block, near in _neighbourhoods(rows, centres):
            exponent = (left[block] @ right[near].T).astype(np.float32, copy=False)
            total[block] = np.exp(exponent, out=exponent).sum(axis=1)
        (far,) = np.nonzero(total < _LEAST_TOTAL)
        for start in range(0, len(far), _BLOCK):
            block = far[start : start + _BLOCK]
            exponent = (left[block] @ right.T).astype(np.float32, copy=False)
            top[block] = exponent.max(axis=1)
            exponent -= top[block, None]
            total[block] = np.exp(exponent, out=exponent).sum(axis=1)
        return np.log(total, dtype=np.float64) + top - self.log_normaliser

    def sample(self, num_samples: int, *, rng: np.random.Generator) -> Poses:
        """Draw poses (num_samples,) exactly from the density."""
        p = None if self.log_weights is None else np.exp(self.log_weights)
        centres = self.centres[rng.choice(len(self.centres), size=num_samples, p=p)]
        return self.perturb(centres, rng=rng)

    def perturb(self, poses: Poses, *, rng: np.random.Generator) -> Poses:
        """Draw from the kernel around each of the poses (n,)."""
        n = len(poses)
        axis = rng.standard_normal((n, 3))
        axis /= np.linalg.norm(axis, axis=1, keepdims=True)
        angle = np.interp(rng.random(n), *self._angle_quantiles)
        rotation = Poses.exp(np.concatenate([np.zeros((n, 3)), angle[:, None] * axis], axis=1)).rotation
        shift = self.bandwidth_translation_m * rng.standard_normal((n, 3))
        return Poses(poses.rotation @ rotation, poses.translation + shift)

    @cached_property
    def _angle_quantiles(self) -> tuple[np.ndarray, np.ndarray]:
        """Cumulative distribution of the rotation kernel's angle, p(θ) ∝ exp((cos θ − 1)/h²)(1 − cos θ)."""
        k = 1.0 / self.bandwidth_rotation_rad**2
        angle = np.linspace(0.0, min(np.pi, 9.0 * self.bandwidth_rotation_rad), 2049)
        density = np.exp(k * (np.cos(angle) - 1)) * (1 - np.cos(angle))
        cumulative = np.concatenate([[0.0], np.cumsum((density[1:] + density[:-1]) / 2)])
        return cumulative / cumulative[-1], angle

    def _embed(self, poses: Poses, origin: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """[t/h_t, vec(R)/(√2 h_r)] (n, 12) and half its squared norm (n,); an origin near by keeps float32 exact."""
        embedding = np.empty((len(poses), 12))
        embedding[:, :3] = (poses.translation - origin) / self.bandwidth_translation_m
        embedding[:, 3:] = poses.rotation.reshape(-1, 9) / (np.sqrt(2.0) * self.bandwidth_rotation_rad)
        return embedding, 0.5 * np.einsum("ij,ij->i", embedding, embedding)


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
        floor = np.full(len(poses), np.log(self.prior_floor))
        return floor if self.prior is None else np.maximum(floor, self.prior.log_density(poses))

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


def _neighbourhoods(
    rows: Float64[np.ndarray, "n d"], centres: Float64[np.ndarray, "m d"]
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Blocks of rows that lie together, each with the centres within reach of any of them: indices (b,) and (k,).

    Args:
        rows: Embedded poses, in kernel widths.
        centres: Embedded centres, likewise.
    """
    offset = rows - rows.mean(axis=0)
    _, axes = np.linalg.eigh(offset.T @ offset)
    order = np.argsort(offset @ axes[:, -1])
    blocks = [order[start : start + _BLOCK] for start in range(0, len(order), _BLOCK)]
    middles = np.stack([rows[block].mean(axis=0) for block in blocks])
    for block, middle, distance in zip(blocks, middles, cdist(middles, centres), strict=True):
        radius = np.sqrt(((rows[block] - middle) ** 2).sum(axis=1).max())
        yield block, np.flatnonzero(distance < radius + _REACH)
