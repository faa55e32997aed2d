"""Settings of the filter."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, get_args

import numpy as np

from filtering.errors import VaporTrackError, require_within
from filtering.estimate import ModeConfig
from filtering.measurement_noise import MeasurementNoise
from filtering.motion import OdometryBias
from filtering.resampling import Resampling

Births = Literal["rate", "augmented-mcl"]


@dataclass(frozen=True)
class GapConfig:
    """Motion where odometry is missing."""

    action: Literal["widen", "forget"] = "widen"
    """Widen the belief by a motion in an unknown direction, or also replace it by the next informative image; until
    then it is "lost"."""
    speed_m_per_s: float = 1.5
    """Standard deviation of the speed along each axis; a brisk walk."""
    turn_rad_per_s: float = 0.5
    """Standard deviation of the turn rate about each axis."""
    time_s: float = 5.0
    """Time over which both change, seconds."""

    def __post_init__(self) -> None:
        require_within(self, speed_m_per_s=(0.0, 1e6), turn_rad_per_s=(0.0, 1e3), time_s=(1e-3, 1e9))

    @property
    def velocity(self) -> OdometryBias:
        """The unknown velocity, as the drift of odometry that reports no motion."""
        v, w = self.speed_m_per_s, self.turn_rad_per_s
        return OdometryBias(scale=0.0, drift=(v, v, v, w, w, w), time_s=self.time_s)


@dataclass(frozen=True)
class LocalizerConfig:
    """Settings of the filter; lengths follow from the measurement noise of the images (`MeasurementNoise`).

    Example:
        >>> import numpy as np
        >>> import vapor
        >>> config = vapor.LocalizerConfig(late_window_s=1.0, converged_std_m=0.3)
        >>> localizer = vapor.ParticleLocalizer(None, config, rng=np.random.default_rng(0))
        >>> localizer.config.late_window_s
        1.0
    """

    max_hypotheses: int = 50
    """Largest number of particles, each a hypothesis with a Gaussian of its own."""
    outlier_places: float = 10.0
    """An outlier supports a wrong hypothesis with a probability of 1 over this: of so many places it shows one."""
    birth_rate: float = 3e-4
    """Probability, for each new view that fits the belief, that the camera was carried off unnoticed. So much of the
    belief becomes unassigned, and hypotheses are born from it."""
    max_birth_rate: float = 0.1
    """The birth rate of a view that does not fit at all; in between it rises in equal ratios. With both at 0 nothing is
    ever unassigned, nor born after the first image, where `births` is "rate"."""
    births: Births = "rate"
    """Mass becomes unassigned at those rates, or as in augmented Monte Carlo localization, while images agree with the
    belief less than usual."""
    adapt_errors: bool = True
    """Scale the measurement noise where odometry shows that images err more or less than it states."""
    merge_divergence: float = 0.5
    """Hypotheses that differ by no more than this are merged, nats."""
    least_weight: float = 1e-8
    """Hypotheses of smaller weight are dropped."""
    resampling: Resampling = "optimal"
    """Resampling beyond `max_hypotheses`: unbiased with the least variance, or the heaviest ones."""
    converged_weight: float = 0.9
    """Status is "converged" from this weight of the best mode on."""
    converged_std: float = 3.0
    """Status "converged" also needs a standard deviation of the best mode's position, along its widest axis, of at most
    so many standard deviations of an ordinary image's error. With a map of landmarks: of a verified place's, or the
    geometric mean of both errors."""
    converged_std_m: float | None = None
    """That limit in metres, in place of `converged_std`."""
    converged_map_fraction: float = 0.5
    """Status "converged" also needs a standard deviation of at most this fraction of the size of the map
    (`MeasurementNoise.map_size_m`): a map-wide belief is not converged."""
    converged_agreement: float = 0.7
    """Status "converged" also needs that at least this fraction of the belief fits the latest images."""
    lost_agreement: float = 0.3
    """Status is "lost" while less than this fraction of the belief fits the latest images."""
    lost_unassigned: float = 0.5
    """Status is "lost" also while more than this fraction of the belief is unassigned."""
    agreement_s: float = 1.0
    """Time over which the fit to the latest images is averaged, seconds."""
    agreement_images: int = 5
    """Least number of images over which the fit to the latest images is averaged."""
    switch_ratio: float = 1.5
    """Another mode becomes the best one when its weight exceeds that of the best by this factor."""
    odometry_bias: OdometryBias = field(default_factory=lambda: OdometryBias(relative_drift=0.6))
    """Scale error and drift of the odometry."""
    odometry_failures_per_s: float = 0.005
    """Rate at which odometry goes wrong: wheels slip or are stuck, a scale triples, a pose jumps."""
    odometry_failure_s: float = 5.0
    """Mean duration of such a failure of odometry, seconds."""
    gap: GapConfig = field(default_factory=GapConfig)
    """Motion where odometry is missing."""
    modes: ModeConfig = field(default_factory=ModeConfig)
    """Which hypotheses are reported as one mode."""
    late_window_s: float = 0.5
    """Images that are late by at most so much are fused at their own times, seconds; of steps with times."""

    def __post_init__(self) -> None:
        require_within(
            self,
            max_hypotheses=(1, 10**6),
            max_birth_rate=(0.0, 1.0),
            birth_rate=(0.0, self.max_birth_rate),
            merge_divergence=(0.0, 1e6),
            least_weight=(0.0, 0.1),
            converged_weight=(0.0, 1.0),
            converged_std=(0.0, 1e6),
            converged_map_fraction=(0.0, 1e6),
            converged_agreement=(0.0, 1.0),
            lost_agreement=(0.0, 1.0),
            lost_unassigned=(0.0, 1.0),
            outlier_places=(1.0, 1e9),
            odometry_failures_per_s=(0.0, 1e3),
            odometry_failure_s=(1e-3, 1e9),
            agreement_s=(1e-6, 1e6),
            agreement_images=(1, 10**6),
            switch_ratio=(1.0, 1e9),
            late_window_s=(0.0, 60.0),
        )
        for name, known in (("births", Births), ("resampling", Resampling)):
            if getattr(self, name) not in get_args(known):
                raise VaporTrackError(
                    f"{name} is {getattr(self, name)!r}, expected one of {', '.join(get_args(known))}"
                )
        if self.converged_std_m is not None:
            require_within(self, converged_std_m=(0.0, 1e9))

    @property
    def has_births(self) -> bool:
        """Whether hypotheses are born after the first image."""
        return self.births != "rate" or self.max_birth_rate > 0.0

    def widest_std_m(self, noise: MeasurementNoise) -> float:
        """The largest standard deviation of the position, along its widest axis, of a converged belief, metres."""
        if self.converged_std_m is not None:
            return self.converged_std_m
        ordinary, finest = (max(each.typical_std[:3]) for each in (noise, noise.finest))
        widest = max(self.converged_std * finest, float(np.sqrt(finest * ordinary)))
        return min(widest, self.converged_map_fraction * noise.map_size_m)
