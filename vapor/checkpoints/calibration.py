"""Calibration of a model: the errors of its posteriors, and of odometry in its scene."""

from __future__ import annotations

from dataclasses import dataclass
from dataclasses import field as dataclass_field

from filtering.density import KernelDensity
from filtering.errors import require_within
from filtering.measurement_noise import MeasurementNoise
from filtering.se3 import Poses
from sequences.odometry_fit.result import OdometryFit


@dataclass(frozen=True)
class Calibration:
    """How wrong a model's posteriors are, and the odometry of its scene; `vapor-track calibrate` fits it."""

    bandwidth_translation_m: float = 0.1
    """Kernel width of the posterior samples along each axis, metres: of their density, in figures."""
    bandwidth_rotation_rad: float = 0.1
    """Kernel width of the posterior samples about each axis, radians."""
    errors: MeasurementNoise = dataclass_field(default_factory=MeasurementNoise)
    """How the places among the samples err."""
    odometry: OdometryFit | None = None
    """How wrong odometry was on the data; None where none was at hand."""

    def __post_init__(self) -> None:
        require_within(self, bandwidth_translation_m=(1e-9, 1e9), bandwidth_rotation_rad=(1e-3, 10.0))

    def density(self, samples: Poses) -> KernelDensity:
        """p̂, the kernel density of posterior samples (m,)."""
        return KernelDensity(samples, self.bandwidth_translation_m, self.bandwidth_rotation_rad)
