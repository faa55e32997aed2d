"""The size of a scene, the errors to expect in it by default, and even thinning."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64, Int64

from filtering.measurement_noise import MeasurementNoise
from filtering.se3 import Poses

_TAIL = 0.005  # of the positions, at either end of each axis: network outputs may lie anywhere
_THINNEST, _MARGIN = 0.05, 0.02  # of the box in which cameras may be, in extents
_TURNED = 0.15  # fraction of all rotations that cameras have: they are mostly upright
_RADIUS, _NOISE_FLOOR, _NOISE_FLOOR_RAD, _LENGTH = 0.04, 0.02, 0.05, 0.05  # in extents, but for the angle
_MISTAKEN = 4.0  # lengths
RADIUS_RAD, LENGTH_RAD = 0.5, 0.4
MAX_PRIOR_POSES = 2000
"""Most prior poses that a model file holds."""


def scene_extent(poses: Poses) -> float:
    """Diagonal of the box around the positions of poses (n,), metres; 1 where all are the same."""
    extent = float(np.linalg.norm(_sides(poses)))
    return extent if extent > 1e-9 else 1.0


def typical_side_m(poses: Poses) -> float:
    """Geometric mean of the sides of the box around the positions of poses (n,), metres; thin sides are widened."""
    extent = scene_extent(poses)
    return float(np.prod(np.maximum(_sides(poses), _THINNEST * extent)) ** (1 / 3))


def log_clutter_density(poses: Poses) -> float:
    """Log density of poses spread evenly over the box around these (n,), cameras mostly upright, per m³ rad³."""
    extent = scene_extent(poses)
    sides = np.maximum(_sides(poses), _THINNEST * extent) + _MARGIN * extent
    return -float(np.log(np.prod(sides) * 8.0 * np.pi**2 * _TURNED))


def default_errors(poses: Poses) -> MeasurementNoise:
    """Errors of a network that was not calibrated, in proportion to the scene that poses (n,) outline."""
    extent = scene_extent(poses)
    noise_floor = (
        _NOISE_FLOOR * extent,
        _NOISE_FLOOR * extent,
        _NOISE_FLOOR * extent,
        _NOISE_FLOOR_RAD,
        _NOISE_FLOOR_RAD,
        _NOISE_FLOOR_RAD,
    )
    typical = 1.4 * np.array(noise_floor)  # as if the samples' own spread were as large
    a, b, c, d, e, f = (float(value) for value in typical)
    return MeasurementNoise(
        radius_m=_RADIUS * extent,
        radius_rad=RADIUS_RAD,
        noise_floor=noise_floor,
        log_clutter_density=log_clutter_density(poses),
        length_m=_LENGTH * extent,
        length_rad=LENGTH_RAD,
        outlier_lengths=_MISTAKEN,
        typical_std=(a, b, c, d, e, f),
    )


def _sides(poses: Poses) -> Float64[np.ndarray, "3"]:
    low, high = np.quantile(poses.translation, [_TAIL, 1.0 - _TAIL], axis=0)
    return high - low


def spaced(count: int, limit: int) -> Int64[np.ndarray, " n"]:
    """Indices of min(count, limit) of `count` things, evenly spaced in their order."""
    return np.linspace(0, count - 1, min(count, limit)).round().astype(np.int64)
