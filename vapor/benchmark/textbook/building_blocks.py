"""What both textbook filters are made of: point particles on SE(3), moved, and weighed by a kernel density.

Source: Thrun, Burgard and Fox, "Probabilistic Robotics", 2005, §4.3 (the filter), §8.3.5 (particles drawn from the
image, so that it can recover); Gordon, Salmond and Smith, 1993 (roughening).
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float32, Float64

from filtering.density import KernelDensity
from filtering.errors import require_within
from filtering.motion import Odometry, covariance_factor
from filtering.se3 import Poses

SURE = 0.9
"""A textbook filter says `converged` from this weight on, within `REACH_M` and `REACH_RAD` of its best pose."""
REACH_M, REACH_RAD = 0.3, 0.5

_BLOCK = 256  # particles at a time

_HASH = np.array([1, 1_000_003, 998_244_353, 1_000_000_007, 2_147_483_647, 67_867_979])  # of cells


@dataclass(frozen=True)
class TextbookSettings:
    """Settings of the textbook filters; the defaults were tuned on other walks than those that are reported."""

    kernel_m: float = 0.1
    """Standard deviation of the kernels along each axis, metres."""
    kernel_rad: float = 0.1
    """And about each axis, radians."""
    power: float = 0.1
    """Images ten times a second are not independent: of the likelihood, this power is taken."""
    outlier_probability: float = 0.05
    """Probability that an image says nothing about where the camera is."""
    injected: float = 0.005
    """Fraction of the particles that every image draws anew from its samples."""
    rough_m: float = 0.01
    """Noise along each axis that is added to that of the odometry for every image, metres."""
    rough_rad: float = 0.005
    """And about each axis, radians."""

    def __post_init__(self) -> None:
        require_within(
            self,
            **dict.fromkeys(("kernel_m", "kernel_rad"), (1e-6, 1e6)),
            **dict.fromkeys(("rough_m", "rough_rad"), (0.0, 1e6)),
            power=(0.0, 1.0),
            outlier_probability=(1e-9, 0.999),
            injected=(0.0, 1.0),
        )


@runtime_checkable
class TextbookFilter(Protocol):
    """A filter as the benchmark sees it."""

    def update(self, samples: Poses, odometry: Odometry) -> tuple[Poses, float]:
        """Take one image.

        Args:
            samples: Of the image's posterior, batch (m,).
            odometry: Motion since the previous image, not used on the first one.

        Returns:
            The best pose, and the weight around it, see `heaviest_place`.
        """
        ...


def drawn(samples: Poses, count: int, settings: TextbookSettings, rng: np.random.Generator) -> Poses:
    """Poses (count,) from the kernel density over samples (m,)."""
    return KernelDensity(samples, settings.kernel_m, settings.kernel_rad).sample(count, rng=rng)


def moved(
    poses: Poses, odometry: Odometry, samples: Poses, settings: TextbookSettings, rng: np.random.Generator
) -> Poses:
    """Particles (n,) after a motion with its noise and roughening; a few are drawn anew from the image's samples."""
    rough = np.repeat(np.square([settings.rough_m, settings.rough_rad]), 3)
    factor = covariance_factor(odometry.covariance + np.diag(rough))
    noise = Poses.exp(rng.standard_normal((len(poses), 6)) @ factor.T)
    after = poses @ (odometry.previous_from_current @ noise)
    anew = rng.random(len(poses)) < settings.injected
    if anew.any():
        fresh = drawn(samples, int(anew.sum()), settings, rng)
        after.rotation[anew], after.translation[anew] = fresh.rotation, fresh.translation
    return after


def log_likelihood(
    samples: Poses, poses: Poses, settings: TextbookSettings, flat_log_density: float
) -> Float64[np.ndarray, " n"]:
    """How well an image's samples (m,) fit each of the poses (n,): their kernel density, or that of an outlier.

    Args:
        samples: Of the image.
        poses: Where the camera may be.
        settings: Of the filter.
        flat_log_density: Log density of poses spread evenly over the map, per m³ rad³.
    """
    log_outlier = np.log(settings.outlier_probability) + flat_log_density
    widths = settings.kernel_m, settings.kernel_rad
    one = KernelDensity(Poses.identity(1), *widths)
    log_scale = -np.log(len(samples)) - one.log_normaliser[0]
    with np.errstate(divide="ignore"):
        log_seen = np.log(_sums(poses, samples, *widths), dtype=np.float64) + log_scale
    return settings.power * np.logaddexp(np.log1p(-settings.outlier_probability) + log_seen, log_outlier)


def _sums(poses: Poses, samples: Poses, width_m: float, width_rad: float) -> Float32[np.ndarray, " n"]:
    """Sums of the kernels exp(−½ d²) between each pose (n,) and all samples (m,), d the chordal distance in widths.

    −½|a − b|² = a·b − ½|a|² − ½|b|² is one matrix product of 14 columns; blocks of 256 rows stay in a core's cache.
    """
    scale, origin = np.repeat([1.0 / width_m, 1.0 / width_rad], [3, 9]), samples.chordal.mean(axis=0)
    left, right = np.empty((len(poses), 14), np.float32), np.empty((14, len(samples)), np.float32)
    rows, columns = (poses.chordal - origin) * scale, ((samples.chordal - origin) * scale).T
    left[:, :12], left[:, 12], left[:, 13] = rows, -0.5 * np.einsum("ij,ij->i", rows, rows), 1.0
    right[:12], right[12], right[13] = columns, 1.0, -0.5 * np.einsum("ij,ij->j", columns, columns)
    sums = np.empty(len(poses), np.float32)
    for start in range(0, len(poses), _BLOCK):
        exponent = left[start : start + _BLOCK] @ right
        sums[start : start + _BLOCK] = np.exp(exponent, out=exponent).sum(axis=1)
    return sums


def heaviest_place(poses: Poses, weights: Float64[np.ndarray, " n"]) -> tuple[Poses, float]:
    """The mean of the particles (n,) where they weigh most, and how much those weigh that lie around it.

    The heaviest cell of a grid over position and direction of view, then two steps of a mean shift: in a map that looks
    alike in many places, the mean of all particles would lie between the places.
    """
    cells = np.floor(np.concatenate([poses.translation / REACH_M, poses.rotation[:, :, 2] / REACH_RAD], axis=1))
    _, cell = np.unique(cells.astype(np.int64) @ _HASH, return_inverse=True)
    near = cell == np.argmax(np.bincount(cell, weights))
    best = poses[near].mean(weights[near])
    for _ in range(2):
        apart_m, apart_rad = poses.distance(best)
        near = (apart_m < REACH_M) & (apart_rad < REACH_RAD)
        if not weights[near].sum() > 0.0:
            break
        best = poses[near].mean(weights[near])
    return best, float(weights[near].sum())


@contextmanager
def drawing_from(rng: np.random.Generator) -> Iterator[None]:
    """FilterPy and particles draw from numpy's global generator: inside of this, from one that another one seeds."""
    before = np.random.get_state()  # noqa: NPY002
    np.random.seed(int(rng.integers(2**32)))  # noqa: NPY002
    try:
        yield
    finally:
        np.random.set_state(before)  # noqa: NPY002
