"""Kernel density on SE(3)."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from jaxtyping import Float, Float64
from scipy.special import ive

from filtering.errors import VaporTrackError
from filtering.se3 import Poses

_GAUSSIAN_FROM = 1e6  # 1/h_r² from which on the rotation kernel's integral is a Gaussian's, to 4e-7
_LARGE = 8000.0  # squared distance in widths, beyond which float32 loses more than 1e-3


@dataclass(frozen=True)
class KernelDensity:
    """Mixture of kernels on SE(3), one at each centre, in the chordal metric.

    The kernel is Gaussian in translation and isotropic matrix-Fisher in rotation, exp((cos θ − 1)/h_r²). Near its
    centre the rotation kernel is a Gaussian of width h_r in the rotation vector.

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

    def log_density(self, poses: Poses) -> Float64[np.ndarray, " n"]:
        """Log density of poses (n,), per m³ rad³."""
        exponent = self._log_kernels(poses)
        largest = exponent.max(axis=1, keepdims=True)
        exponent -= largest
        return largest[:, 0] + np.log(np.exp(exponent, out=exponent).sum(axis=1), dtype=np.float64)

    def _log_kernels(self, poses: Poses) -> Float[np.ndarray, "n m"]:
        """Log of each weighted kernel at each pose: −½|a − c|² p = a·c p − ½|a|² p − ½|c|² p as one product.

        The terms cancel, so where they are large (narrow kernels, wide scenes) they are in double precision.
        """
        origin = self.centres.chordal.mean(axis=0)
        rows, centres = poses.chordal - origin, self.centres.chordal - origin
        widths = np.broadcast_arrays(self.bandwidth_translation_m, self.bandwidth_rotation_rad, np.empty(len(centres)))
        precision = np.repeat(np.square(1.0 / np.stack(widths[:2], axis=1)), [3, 9], axis=1)
        squared = np.einsum("mi,mi,mi->m", centres, centres, precision)
        log_weights = -np.log(len(centres)) if self.log_weights is None else self.log_weights
        constant = log_weights - self.log_normaliser - 0.5 * squared
        left = np.hstack([rows, np.square(rows), np.ones((len(rows), 1))])
        right = np.hstack([centres * precision, -0.5 * precision, constant[:, None]])
        largest = max(squared.max(), float((np.square(rows) @ precision.max(axis=0)).max()))
        dtype = np.float32 if largest < _LARGE else np.float64
        return left.astype(dtype) @ right.astype(dtype).T
