"""How wide the kernels of a posterior's density are, by maximum likelihood on held-out images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Float64
from scipy.optimize import minimize

from filtering.density import KernelDensity
from filtering.error_model import Six
from filtering.se3 import Poses
from vapor.calibration.change import Change
from vapor.calibration.image_errors import LEAST_OUTLIERS
from vapor.checkpoints.scene_scale import flat_log_density, scene_extent

_NARROWEST, _WIDEST = (5e-4, 3e-3), (0.1, 1.0)  # kernels: extents, radians
_BLOCK = 50  # images at a time: 50 × 2000 float32 fit the cache


def fit_widths(
    samples: Sequence[Poses], truth: Poses, scene: Poses, before: tuple[float, float]
) -> tuple[tuple[float, float], Change]:
    """Kernel widths of the samples' density, metres and radians, of highest mean log likelihood.

    Args:
        samples: Posterior samples of each image, world_from_camera, (m,) each.
        truth: True poses, world_from_camera, (n,).
        scene: Poses that outline the scene.
        before: Widths to start from.
    """
    distances = _Distances.between(samples, truth)
    extent, log_flat = scene_extent(scene), np.log(LEAST_OUTLIERS) + flat_log_density(scene)

    def score(widths: tuple[float, float]) -> float:
        log_density = distances.log_density(*widths) + np.log1p(-LEAST_OUTLIERS)
        return float(np.logaddexp(log_flat, log_density).mean())

    bounds = [(low * unit, high * unit) for low, high, unit in zip(_NARROWEST, _WIDEST, (extent, 1.0), strict=True)]
    found = minimize(
        lambda x: -score((float(np.exp(x[0])), float(np.exp(x[1])))),
        np.log([np.clip(value, *bound) for value, bound in zip(before, bounds, strict=True)]),
        method="Nelder-Mead",
        bounds=np.log(bounds),
        options={"xatol": 0.01, "fatol": 1e-4},
    )
    width_m, width_rad = (float(width) for width in np.exp(found.x))
    names = "bandwidth_translation_m", "bandwidth_rotation_rad"
    formerly: dict[str, float | Six] = dict(zip(names, before, strict=True))
    values: dict[str, float | Six] = dict(zip(names, (width_m, width_rad), strict=True))
    return (width_m, width_rad), Change("kernel widths", formerly, values, score((width_m, width_rad)) - score(before))


@dataclass(frozen=True)
class _Distances:
    """Squared distances of true poses (n,) from the samples (n, m) of their images: computed once.

    Attributes:
        squared_m2: Of translation.
        squared_chord: 2 − 2 cos of the angle.
    """

    squared_m2: Float32[np.ndarray, "n m"]
    squared_chord: Float32[np.ndarray, "n m"]

    @staticmethod
    def between(samples: Sequence[Poses], truth: Poses) -> _Distances:
        apart = [poses.distance(truth[i]) for i, poses in enumerate(samples)]
        squared_m2 = np.array([np.square(metres) for metres, _ in apart], np.float32)
        return _Distances(squared_m2, np.array([2 - 2 * np.cos(radians) for _, radians in apart], np.float32))

    def log_density(self, width_m: float, width_rad: float) -> Float64[np.ndarray, " n"]:
        """Log of the kernel density at each true pose, (n,), per m³ rad³."""
        n, m = self.squared_m2.shape
        log_sum = np.empty(n)
        scale_m, scale_rad = np.float32(-0.5 / width_m**2), np.float32(-0.5 / width_rad**2)
        for start in range(0, n, _BLOCK):
            rows = slice(start, start + _BLOCK)
            exponent = self.squared_m2[rows] * scale_m
            exponent += self.squared_chord[rows] * scale_rad
            top = exponent.max(axis=1, keepdims=True)
            log_sum[rows] = top[:, 0] + np.log(np.exp(exponent - top).sum(axis=1), dtype=np.float64)
        kernel = KernelDensity(Poses.identity(1), width_m, width_rad)
        return log_sum - np.log(m) - kernel.log_normaliser[0]
