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
    """Fixed-lag smoother: also give each pose by the images until so many seconds later. 0: do not."""

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
    """CPU threads of the network. More of them help a large network on an idle machine, and slow down a busy one."""
    fitted_odometry: bool = True
    """Take the noise of odometry from the model's calibration, if it was fitted there; else from the messages."""
    planar: PlanarUse = "auto"
    """Whether a robot keeps the camera at one tilt and one height above the floor, which the training poses then tell.
    auto: if they show that it does, and as long as the images agree. yes: always, with the spread that they have. no:
    never."""

    def __post_init__(self) -> None:
        for name in ("num_samples", "threads"):
            if getattr(self, name) < 1:
                raise VaporTrackError(f"{name} is {getattr(self, name)}, expected at least 1")
        if self.planar not in get_args(PlanarUse):
            known = ", ".join(get_args(PlanarUse))
            raise VaporTrackError(f"planar is {quoted(self.planar)}, expected one of {known}")


@dataclass(frozen=True)
class RunConfig(ModelConfig, FilteringConfig):
    """Settings of a run with a regressor, beside the sequence and the model.

    Example:
        >>> import vapor
        >>> localizer = vapor.LocalizerConfig(converged_std_m=0.2)
        >>> config = vapor.RunConfig(engine="torch", odometry="visual", lag=2.0, localizer=localizer)
        >>> config.seed
        0
    """

    odometry: OdometrySource = "auto"
    """Where odometry comes from. auto: from the recording, or from the images if it has none. recorded: from the
    recording. visual: from the images. both: from both, which correct each other. none: use none; the velocity is
    unknown."""
    localize_hz: float = 10.0
    """With visual odometry: images a second that are localized. Those between them only show the motion."""
    rate_hz: float = float(ASSUMED_HZ)
    """Images a second of a folder of images whose names are no stamps."""

    def __post_init__(self) -> None:
        ModelConfig.__post_init__(self)
        require_within(self, localize_hz=(1e-3, 1e6), rate_hz=(1e-3, 1e6))
        require_odometry_source(self.odometry)
        FilteringConfig.__post_init__(self)
