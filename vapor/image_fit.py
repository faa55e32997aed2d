"""Kernel widths, prior and outlier floor from single held-out images, by likelihood."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float32, Float64
from scipy.optimize import minimize, minimize_scalar
from scipy.special import expit, logit

from filtering.density import KernelDensity
from filtering.regularisation import KernelConfig
from filtering.se3 import Poses
from vapor.checkpoint import Calibration

_WIDEST_KERNEL = 1.0, 1.0  # metres, radians
_WIDEST_PRIOR = 3.0, 2.0
_FLOOR_BOUNDS = (0.01, 0.5)  # neighbouring images err alike: no outlier in 500 does not say that there are none
_BLOCK = 50  # images at a time: 50 × 2000 float32 fit the cache


@dataclass(frozen=True)
class Change:
    """What one fit changed.

    Attributes:
        what: In words.
        before: Values by the name of their setting.
        after: Likewise.
        gain: Log likelihood gained, nats per held-out image.
        error: Standard error of the gain over stretches; None where it is over single images.
        preferred: The value of highest mean log density where another was taken, else None.
    """

    what: str
    before: dict[str, float]
    after: dict[str, float]
    gain: float
    error: float | None = None
    preferred: float | None = None


def fit_images(
    samples: Sequence[Poses], truth: Poses, prior_poses: Poses, calibration: Calibration
) -> tuple[Calibration, tuple[Change, ...]]:
    """Widths of π, widths of p̂ and the outlier floor, from posterior samples of n images and their true poses (n,)."""
    prior_distances = _Distances.between([prior_poses], truth)
    before = calibration.prior_bandwidth_translation_m, calibration.prior_bandwidth_rotation_rad
    # A ratio p̂/π of a smooth density and a spiky one says little: π is never narrower than what it divides.
    least = calibration.place_bandwidth_translation_m, calibration.place_bandwidth_rotation_rad
    bounds = tuple((low, max(low, high)) for low, high in zip(least, _WIDEST_PRIOR, strict=True))
    widths = _likeliest_widths(lambda w: prior_distances.log_density(w[0], w[1]).mean(), before, bounds)
    log_prior_before, log_prior = (prior_distances.log_density(*pair) for pair in (before, widths))
    names = "prior_bandwidth_translation_m", "prior_bandwidth_rotation_rad"
    changes = [_change("prior π", names, before, widths, float((log_prior - log_prior_before).mean()))]
    calibration = replace(calibration, **changes[-1].after)

    distances = _Distances.between(samples, truth)

    def floored(h_t: float, h_r: float) -> float:
        return _best_floor(distances.log_density(h_t, h_r), log_prior)[1]

    before = calibration.bandwidth_translation_m, calibration.bandwidth_rotation_rad
    jitter = KernelConfig()  # details finer than the filter's own jitter are none to it
    bounds = tuple(zip((jitter.jitter_m, jitter.jitter_rad), _WIDEST_KERNEL, strict=True))
    widths = _likeliest_widths(lambda w: floored(w[0], w[1]), before, bounds)
    names = "bandwidth_translation_m", "bandwidth_rotation_rad"
    changes.append(_change("kernel widths", names, before, widths, floored(*widths) - floored(*before)))
    calibration = replace(calibration, **changes[-1].after)

    # The floor that is stored is the one of the likelihood that tells places apart.
    likelihood = calibration.likelihood(prior_poses)
    places = [calibration.posterior(poses, likelihood).places for poses in samples]
    log_places = np.array([p.log_density(truth[[i]])[0] for i, p in enumerate(places) if p is not None])
    floor, best = _best_floor(log_places, log_prior)
    before = calibration.outlier_floor
    gain = best - _with_floor(before, log_places, log_prior)
    changes.append(_change("outlier floor ε", ("outlier_floor",), (before,), (floor,), gain))
    return replace(calibration, **changes[-1].after), tuple(changes)


@dataclass(frozen=True)
class _Distances:
    """Squared distances of true poses (n,) from kernel centres (n, m), or the same (m,) for all: computed once.

    Attributes:
        squared_m2: Of translation.
        squared_chord: 2 − 2 cos of the angle.
    """

    squared_m2: Float32[np.ndarray, "n m"]
    squared_chord: Float32[np.ndarray, "n m"]

    @staticmethod
    def between(centres: Sequence[Poses], poses: Poses) -> _Distances:
        apart = [centres[i if len(centres) > 1 else 0].distance(poses[i]) for i in range(len(poses))]
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


def _likeliest_widths(
    mean_log: Callable[[np.ndarray], float],
    start: tuple[float, float],
    bounds: Sequence[tuple[float, float]],
) -> tuple[float, float]:
    """Widths of highest mean log likelihood."""
    found = minimize(
        lambda x: -mean_log(np.exp(x)),
        np.log([np.clip(value, *bound) for value, bound in zip(start, bounds, strict=True)]),
        method="Nelder-Mead",
        bounds=np.log(bounds),
        options={"xatol": 0.01, "fatol": 1e-4},
    )
    width_m, width_rad = np.exp(found.x)
    return float(width_m), float(width_rad)


def _best_floor(log_density: Float64[np.ndarray, " n"], log_prior: Float64[np.ndarray, " n"]) -> tuple[float, float]:
    """ε of highest mean log likelihood, and that."""
    found = minimize_scalar(
        lambda x: -_with_floor(expit(x), log_density, log_prior), bounds=logit(_FLOOR_BOUNDS), method="bounded"
    )
    return float(expit(found.x)), -float(found.fun)


def _with_floor(floor: float, log_density: Float64[np.ndarray, " n"], log_prior: Float64[np.ndarray, " n"]) -> float:
    """Mean of log[(1 − ε) p̂ + ε π] over images: an image is an outlier with probability ε."""
    return float(np.logaddexp(np.log1p(-floor) + log_density, np.log(floor) + log_prior).mean())


def _change(
    what: str, names: tuple[str, ...], before: tuple[float, ...], after: tuple[float, ...], gain: float
) -> Change:
    return Change(what, dict(zip(names, before, strict=True)), dict(zip(names, after, strict=True)), gain)
