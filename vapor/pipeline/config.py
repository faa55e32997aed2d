"""Settings of runs."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, get_args

from filtering.config import LocalizerConfig
from filtering.errors import VaporTrackError, quoted, require_within
from sequences.frame import ASSUMED_HZ
from vapor.engines.engine import Device, EngineConfig

OdometrySource = Literal["auto", "recorded", "visual", "both", "none"]
PlanarUse = Literal["auto", "yes", "no"]


def require_odometry_source(source: object) -> None:
    """Raise VaporTrackError where this is no `OdometrySource`."""
    if source not in get_args(OdometrySource):
        known = ", ".join(get_args(OdometrySource))
        raise VaporTrackError(f"odometry is {quoted(source)}, expected one of {known}")


@dataclass(frozen=True)
class FilterConfig:
    """Settings of the filter, wherever its images come from."""

    seed: int = 0
    """Seed of all random draws: on the same machine, the same seed and file give the same output."""
    localizer: LocalizerConfig = field(default_factory=LocalizerConfig)
    """The particle filter."""
    lag: float = 0.0
    """Give each pose also by the images until so many seconds later (a fixed-lag smoother); 0: do not."""

    def __post_init__(self) -> None:
        require_within(self, lag=(0.0, 3600.0))
        if self.seed < 0:
            raise VaporTrackError(f"seed is {self.seed}, expected at least 0")


@dataclass(frozen=True)
class FilteringConfig(FilterConfig):
    """Settings of a run, whatever the observation model."""

    recording: bool = True
    """Write recording.rrd for the Rerun viewer."""
    view: bool = False
    """Open the Rerun viewer and stream into it."""


@dataclass(frozen=True)
class ModelConfig(EngineConfig):
    """How a model observes, and what its training poses say of the camera."""

    num_samples: int = 1000
    """Posterior samples per image."""
    device: Device = "auto"
    """Where the network runs."""
    threads: int = 1
    """Processor threads of the network: more help a large network on an idle machine, and slow down a busy one."""
    fitted_odometry: bool = True
    """Take the noise of the odometry from the model's calibration, where that was fitted from odometry; otherwise as
    the sequence states it."""
    planar: PlanarUse = "auto"
    """Whether the camera is on a robot that keeps it at one tilt and height above the floor: these are then known by
    the training poses. auto: where these show it, while images agree. yes: with their spread, whatever it is."""

    def __post_init__(self) -> None:
        for name in ("num_samples", "threads"):
            if getattr(self, name) < 1:
                raise VaporTrackError(f"{name} is {getattr(self, name)}, expected at least 1")
        if self.planar not in get_args(PlanarUse):
            known = ", ".join(get_args(PlanarUse))
            raise VaporTrackError(f"planar is {quoted(self.planar)}, expected one of {known}")


@dataclass(frozen=True)
class RunConfig(ModelConfig, FilteringConfig):
    """Settings of a run with a regressor, beside the sequence and the model."""

    odometry: OdometrySource = "auto"
    """auto: use odometry where it is recorded, and elsewhere make it from the images. recorded: require it. visual:
    make it from the images. both: these correct each other. none: each hypothesis moves with an unknown velocity."""
    localize_hz: float = 10.0
    """With visual odometry, localize so many images a second on average; those between them show the motion."""
    rate_hz: float = float(ASSUMED_HZ)
    """How many images there are in a second, in a folder of images whose names state no stamps."""

    def __post_init__(self) -> None:
        ModelConfig.__post_init__(self)
        require_within(self, localize_hz=(1e-3, 1e6), rate_hz=(1e-3, 1e6))
        require_odometry_source(self.odometry)
        FilteringConfig.__post_init__(self)
