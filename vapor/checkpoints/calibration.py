"""Calibration of a model: the errors of its posteriors, and of odometry in its scene."""

from __future__ import annotations

from dataclasses import dataclass
from dataclasses import field as dataclass_field
from pathlib import Path
from typing import Any

from filtering.density import KernelDensity
from filtering.error_model import ErrorModel
from filtering.errors import VaporTrackError, quoted, require_within
from filtering.se3 import Poses
from sequences.odometry_fit.result import OdometryFit
from vapor.checkpoints.stored_config import parse_config
from vapor.tensor_files import CheckpointError

_SIX = {"floor", "typical_std"}


@dataclass(frozen=True)
class Calibration:
    """How wrong a model's posteriors are, and the odometry of its scene; `vapor-track calibrate` fits it."""

    bandwidth_translation_m: float = 0.1
    """Kernel width of the posterior samples along each axis, metres: of their density, in figures."""
    bandwidth_rotation_rad: float = 0.1
    """Kernel width of the posterior samples about each axis, radians."""
    errors: ErrorModel = dataclass_field(default_factory=ErrorModel)
    """How the places among the samples err."""
    odometry: OdometryFit | None = None
    """How wrong odometry was on the data; None where none was at hand."""

    def __post_init__(self) -> None:
        require_within(self, bandwidth_translation_m=(1e-9, 1e9), bandwidth_rotation_rad=(1e-3, 10.0))

    def density(self, samples: Poses) -> KernelDensity:
        """p̂, the kernel density of posterior samples (m,)."""
        return KernelDensity(samples, self.bandwidth_translation_m, self.bandwidth_rotation_rad)


def parse_calibration(path: Path, values: Any) -> Calibration:
    """The calibration in a model file, from JSON: every field must be there, those of its parts too, and no other.

    Raises:
        CheckpointError: missing, surplus or unusable values.
    """
    if not isinstance(values, dict) or "errors" not in values:
        return parse_config(path, "calibration", Calibration, values)  # raises
    errors = _parse_errors(path, "calibration.errors", values["errors"])
    odometry = values.get("odometry")
    if odometry is not None:
        if not isinstance(odometry, dict):
            raise CheckpointError(f"{path}: calibration.odometry is {quoted(odometry)}, expected an object or null")
        try:
            odometry = OdometryFit.from_dict(odometry)
        except VaporTrackError as error:
            raise CheckpointError(f"{path}: calibration.odometry configuration: {error}") from error
    held: dict[str, Any] = {"errors": errors}
    held |= {"odometry": odometry} if "odometry" in values else {}
    return parse_config(path, "calibration", Calibration, values | held)


def _parse_errors(path: Path, name: str, errors: Any) -> ErrorModel:
    """An error model from JSON, with that of verified places in it."""
    if not isinstance(errors, dict):
        return parse_config(path, name, ErrorModel, errors)  # raises
    for field in _SIX & errors.keys():
        found = errors[field]
        if not (isinstance(found, list) and len(found) == 6 and all(type(v) in (int, float) for v in found)):
            raise CheckpointError(f"{path}: {name} configuration has {field} {quoted(found)}, expected six numbers")
    errors = errors | {field: tuple(map(float, errors[field])) for field in _SIX & errors.keys()}
    if errors.get("verified") is not None:
        errors["verified"] = _parse_errors(path, f"{name}.verified", errors["verified"])
    return parse_config(path, name, ErrorModel, errors)
