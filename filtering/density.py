"""Kernel density on SE(3): many narrow or wide kernels, evaluated fast and exactly."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from jaxtyping import Float, Float32, Float64, Int64
from scipy.spatial.distance import cdist
from scipy.special import ive

from filtering.errors import VaporTrackError
from filtering.se3 import Poses, rotation_from_rotvec

_BLOCK = 128  # kernel rows at a time: 128 × 1000 float32 fit a core's second-level cache and need no BLAS threads
_PRECISION = 1e-5  # of a density: what is left out weighs less than that fraction of it
_GAUSSIAN_FROM = 1e6  # 1/h_r² from which on the rotation kernel's integral is a Gaussian's, to 4e-7
_LEAST_TOTAL = 1e-9  # of kernel peaks: where less is within reach, all kernels are summed


@dataclass(frozen=True)
class KernelDensity:
    """Mixture of kernels on SE(3), one at each centre, in the chordal metric.

    The kernel is Gaussian in translation and isotropic matrix-Fisher in rotation, exp((cos θ − 1)/h_r²). Both are
    −½ of a squared Euclidean distance between embeddings, t/h_t and vec(R)/(√2 h_r), so a kernel matrix is one matrix
    product. Near its centre the rotation kernel is a Gaussian of width h_r in the rotation vector.

    Attributes:
        centres: Batch (m,), m ≥ 1.
        bandwidth_translation_m: h_t, metres, one standard deviation along each axis; of all kernels or of each, (m,).
        bandwidth_rotation_rad: h_r, radians, one standard deviation about each axis; of all kernels or of each, (m,).
        log_weights: Log weights of the centres, normalised, (m,); None for equal weights.
    """

    centres: Poses
    bandwidth_translation_m: float | Float64[np.ndarray, " m"]
    bandwidth_rotation_rad: float | Float64[np.ndarray, " m"]
    log_weights: Float64[np.ndarray, " m"] | None = field(default=None)

    def __post_init__(self) -> None:
        if len(self.centres) == 0:
            raise VaporTrackError("a kernel density needs at least one centre, got an empty batch of poses")
        least_m, least_rad = np.min(self.bandwidth_translation_m), np.min(self.bandwidth_rotation_rad)
        if not (least_m > 0 and least_rad > 0):
            raise VaporTrackError(f"kernel bandwidths must be positive, got {least_m} m and {least_rad} rad")
        finite = self.centres.is_finite()
        if not finite.all():
            first = int(np.argmin(finite))
            raise VaporTrackError(
                f"kernel centre {first} of {len(finite)} is not finite: {self.centres[first].as_matrix()[:3].tolist()}"
            )
        if self.log_weights is not None and not (self.log_weights <= 1e-6).all():  # NaN compares as false
            first = int(np.argmin(self.log_weights <= 1e-6))
            raise VaporTrackError(
                f"log weight of kernel {first} of {len(finite)} is {self.log_weights[first]}, expected at most 0"
            )

    @cached_property
    def log_normaliser(self) -> Float64[np.ndarray, " m"]:
        """Log of each kernel's integral over R³ × SO(3), with rotation volume 8π² (Lebesgue at the identity), (m,)."""
        k = 1.0 / np.square(self.bandwidth_rotation_rad)
        # The difference of Bessel functions cancels for narrow kernels, where it is that of a Gaussian.
        wide = np.minimum(k, _GAUSSIAN_FROM)
        log_rotation = np.log(8 * np.pi**2 * (ive(0, wide) - ive(1, wide))) - 1.5 * np.log(k / wide)
        log_translation = 1.5 * np.log(2 * np.pi * np.square(self.bandwidth_translation_m))
        return np.broadcast_to(log_translation + log_rotation, len(self.centres))

    def log_density(
        self, poses: Poses, *, log_floor: float = -np.inf, near_only: bool = False
    ) -> Float64[np.ndarray, " n"]:
        """Log density of poses (n,), per m³ rad³.

        Args:
            poses: Where to evaluate, (n,).
            log_floor: Log of a density below which it does not matter: there it may come out anything lower, −∞ too.
            near_only: Whether a pose may come out −∞ that is more than about eight widths from every centre, or near
                such ones only as weigh less than 1e-38 of the largest.
        """
        equal = np.full(len(self.centres), -np.log(len(self.centres)))
        log_weights = equal if self.log_weights is None else self.log_weights
        return self.log_densities(poses, log_weights, log_floor=log_floor, near_only=near_only)[0]

    def log_densities(
        self,
        poses: Poses,
        *log_weights: Float64[np.ndarray, " m"],
        log_floor: float = -np.inf,
        near_only: bool = False,
    ) -> tuple[Float64[np.ndarray, " n"], ...]:
        """Log densities (n,) of poses (n,), per m³ rad³, one for each way to weigh the centres; the kernels cost once.

        Poses are taken in blocks, and each block leaves out the kernels that are too far away to count: poses that lie
        together should stand together (`neighbour_order`). The kernel matrix is float32. A pose so far from every
        centre that too little is left of its kernels is computed again with all of them, relative to its largest
        exponent: it gets its true log density rather than −∞.

        Args:
            poses: Where to evaluate, (n,).
            log_weights: Log weights of the centres, normalised, (m,) each. The density's own do not count here.
            log_floor: As of `log_density`.
            near_only: As of `log_density`.
        """
        if len(poses) == 0:
            return tuple(np.empty(0) for _ in log_weights)
        rows, left, right = self._factors(poses)
        log_peak = -self.log_normaliser.min()  # of the narrowest kernel; sums are relative to it
        log_scales = np.column_stack(log_weights) - (self.log_normaliser + log_peak)[:, None]
        scales = np.exp(log_scales).astype(np.float32)
        floor = np.exp(min(log_floor - log_peak, 0.0))
        least = max(floor, _LEAST_TOTAL)
        total = np.empty((len(rows), len(log_weights)), np.float32)
        for block, near in self._neighbourhoods(rows, reach=np.sqrt(-2 * np.log(_PRECISION * least))):
            exponent = _product(left[block], right[near])
            total[block] = np.exp(exponent, out=exponent) @ scales[near]
        with np.errstate(divide="ignore"):
            log_total = np.log(total.T, dtype=np.float64)
        for column, found, log_scale in zip(log_total, total.T, log_scales.T.astype(np.float32), strict=True):
            far = np.flatnonzero(found < (least if floor < least and not near_only else 0.0))
            for block in (far[start : start + _BLOCK] for start in range(0, len(far), _BLOCK)):
                column[block] = _log_sum_exp(_product(left[block], right) + log_scale)
        return tuple(log_total + log_peak)

    def sample(self, num_samples: int, *, rng: np.random.Generator) -> Poses:
        """Draw poses (num_samples,) exactly from the density."""
        p = None if self.log_weights is None else np.exp(self.log_weights)
        return self.draw(rng.choice(len(self.centres), size=num_samples, p=p), rng=rng)

    def draw(self, kernels: Int64[np.ndarray, " n"], *, rng: np.random.Generator) -> Poses:
        """Draw one pose from each of the kernels with these indices (n,)."""
        n = len(kernels)
        axis = rng.standard_normal((n, 3))
        axis /= np.linalg.norm(axis, axis=1, keepdims=True)
        width_m, width_rad = (width[kernels] for width in self._widths)
        angle, uniform = np.empty(n), rng.random(n)
        widths, which = np.unique(width_rad, return_inverse=True)
        for k, quantiles in enumerate(_angle_quantiles(widths)):
            own = which == k
            angle[own] = np.interp(uniform[own], *quantiles)
        rotation = rotation_from_rotvec(angle[:, None] * axis)
        shift = width_m[:, None] * rng.standard_normal((n, 3))
        centres = self.centres[kernels]
        return Poses(centres.rotation @ rotation, centres.translation + shift)

    @cached_property
    def _widths(self) -> tuple[np.ndarray, np.ndarray]:
        """h_t and h_r of every kernel, (m,) each."""
        m = len(self.centres)
        return np.broadcast_to(self.bandwidth_translation_m, m), np.broadcast_to(self.bandwidth_rotation_rad, m)

    def _factors(self, poses: Poses) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Embedded poses (n, 12), and factors (n, 15) and (m, 15) whose product is −½ squared distance in widths.

        −½|a − c|² p = a·c p − ½|c|² p − |a|² ½p: the last two are three more columns. They cancel, so where they are
        large (narrow kernels, wide scenes) the factors are in double precision.
        """
        rows, centres = poses.chordal, self.centres.chordal
        origin = centres.mean(axis=0)
        precision = np.stack([1 / np.square(width) for width in self._widths], axis=1)
        row_offsets, centre_offsets = rows - origin, centres - origin
        row_squares, centre_squares = _squares(row_offsets), _squares(centre_offsets)
        half = -0.5 * np.einsum("ij,ij->i", centre_squares, precision)
        largest = max(-half.min(), 0.5 * float(row_squares.max(axis=0) @ precision.max(axis=0)))
        dtype = np.float32 if largest < 4000.0 else np.float64
        left, right = np.empty((len(rows), 15), dtype), np.empty((len(centres), 15), dtype)
        left[:, :12], left[:, 12:14], left[:, 14] = row_offsets, row_squares, 1.0
        right[:, :12] = centre_offsets * np.repeat(precision, [3, 9], axis=1)
        right[:, 12:14], right[:, 14] = -0.5 * precision, half
        return rows, left, right

    def _neighbourhoods(
        self, rows: Float64[np.ndarray, "n 12"], reach: float
    ) -> Iterator[tuple[slice, Int64[np.ndarray, " k"]]]:
        """Blocks of consecutive rows, each with the kernels within `reach` widths of any of them: slice and indices."""
        starts = np.arange(0, len(rows), _BLOCK)
        sizes = np.diff(starts, append=len(rows))
        middles = np.add.reduceat(rows, starts) / sizes[:, None]
        radii = np.sqrt(np.maximum.reduceat(_squares(rows - np.repeat(middles, sizes, axis=0)), starts))
        distance_squared = np.zeros((len(starts), len(self.centres)))
        for part, radius, width in zip((slice(3), slice(3, 12)), radii.T, self._widths, strict=True):
            distance = cdist(middles[:, part], self.centres.chordal[:, part])
            distance_squared += np.square(np.maximum(distance - radius[:, None], 0.0) / width)
        for start, within in zip(starts, distance_squared < reach**2, strict=True):
            yield slice(start, start + _BLOCK), np.flatnonzero(within)


def neighbour_order(poses: Poses) -> Int64[np.ndarray, " n"]:
    """Indices of poses (n,) in an order in which poses that lie together stand together, one metre worth one radian.

    Halves the poses along their widest axis again and again. In this order a kernel density is evaluated fastest.
    """
    columns = np.ascontiguousarray(poses.chordal.T, dtype=np.float32)
    return np.concatenate(list(_halve(columns, np.arange(len(poses)))))


def _halve(columns: Float32[np.ndarray, "12 n"], indices: Int64[np.ndarray, " k"]) -> Iterator[np.ndarray]:
    """The indices in groups of at most `_BLOCK` neighbours, whole blocks on the left of every cut."""
    if len(indices) <= _BLOCK:
        yield indices
        return
    here = columns[:, indices]
    axis = np.argmax(here.max(axis=1) - here.min(axis=1))
    half = _BLOCK * (-(-len(indices) // _BLOCK) // 2)
    order = np.argpartition(here[axis], half)
    yield from _halve(columns, indices[order[:half]])
    yield from _halve(columns, indices[order[half:]])


def _squares(embedded: Float64[np.ndarray, "n 12"]) -> Float64[np.ndarray, "n 2"]:
    """Squared norms of the parts of translation and rotation."""
    squares = np.empty((len(embedded), 2))
    for column, part in zip(squares.T, (embedded[:, :3], embedded[:, 3:]), strict=True):
        np.einsum("ij,ij->i", part, part, out=column)
    return squares


def _product(left: Float[np.ndarray, "n 15"], right: Float[np.ndarray, "k 15"]) -> Float32[np.ndarray, "n k"]:
    """Log kernels, in the precision of the factors, as float32."""
    return (left @ right.T).astype(np.float32, copy=False)


def _log_sum_exp(exponent: Float32[np.ndarray, "n k"]) -> Float64[np.ndarray, " n"]:
    """Over the last axis; overwrites its input."""
    top = exponent.max(axis=1, keepdims=True)
    exponent -= top
    return top[:, 0] + np.log(np.exp(exponent, out=exponent).sum(axis=1), dtype=np.float64)


def _angle_quantiles(widths_rad: Float64[np.ndarray, " k"]) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Per width the cumulative distribution of the rotation kernel's angle, p(θ) ∝ exp((cos θ − 1)/h²)(1 − cos θ)."""
    angle = np.minimum(np.pi, 9.0 * widths_rad)[:, None] * np.linspace(0.0, 1.0, 513)
    versine = 1.0 - np.cos(angle)
    density = np.exp(-versine / np.square(widths_rad)[:, None]) * versine
    cumulative = np.zeros_like(angle)
    np.cumsum(density[:, 1:] + density[:, :-1], axis=1, out=cumulative[:, 1:])
    return zip(cumulative / cumulative[:, -1:], angle, strict=True)
