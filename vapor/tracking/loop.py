"""The step loop: each observation goes to the filter and to every baseline."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Protocol, runtime_checkable

from filtering.estimate import Estimate, Mode, Status, posterior_modes
from filtering.observation import Observation
from filtering.se3 import Poses


@runtime_checkable
class Localizer(Protocol):
    """The filter: `ParticleLocalizer`, or an ablation of it."""

    def advance(self, observation: Observation, /) -> Estimate:
        """Localize one moment, see `ParticleLocalizer.advance`."""
        ...


@runtime_checkable
class Tracker(Protocol):
    """A baseline that goes from image to image."""

    def advance(self, observation: Observation, /) -> Estimate | Mode:
        """Localize one moment."""
        ...


@dataclass(frozen=True)
class Step:
    """The results of the methods for one image.

    Attributes:
        observation: The image's posterior and the odometry.
        estimate: The filter's estimate.
        image_modes: Places of the image's posterior alone, by falling weight. Where it has none: those of the last
            image with any; before that, the filter's modes.
        baselines: Hypotheses of every baseline by its name, the best one first.
        step_ms: Wall-clock milliseconds of posterior and filter together, without the baselines.
    """

    observation: Observation
    estimate: Estimate
    image_modes: tuple[Mode, ...]
    baselines: Mapping[str, tuple[Mode, ...]]
    step_ms: float


class StepLoop:
    """Steps the filter and its baselines (`start_baselines`), all with the same observations."""

    def __init__(self, localizer: Localizer, baselines: Mapping[str, Tracker] = MappingProxyType({})) -> None:
        self._localizer, self._baselines = localizer, baselines
        self._image_modes: tuple[Mode, ...] = ()

    def step(self, observation: Observation, *, observe_ms: float) -> Step:
        """Take one moment, whose posterior took `observe_ms` milliseconds.

        Raises:
            VaporTrackError: unusable posterior or odometry.
        """
        begin = time.perf_counter()
        estimate = self._localizer.advance(observation)
        step_ms = observe_ms + 1e3 * (time.perf_counter() - begin)
        posterior = observation.posterior
        places = posterior_modes(posterior)
        self._image_modes = places or self._image_modes or estimate.modes
        followed = {name: each.advance(observation) for name, each in self._baselines.items()}
        return Step(
            observation,
            estimate,
            self._image_modes,
            {name: each.modes if isinstance(each, Estimate) else (each,) for name, each in followed.items()},
            step_ms,
        )


def elapsed_s(previous_ns: int | None, time_ns: int) -> float:
    """Seconds between the stamps of two images; 0 before the first, and where the clock went back."""
    return 0.0 if previous_ns is None else max(time_ns - previous_ns, 0) * 1e-9


@dataclass(frozen=True)
class Belief:
    """The belief of a method after each of n images, the reported hypothesis first."""

    modes: Sequence[tuple[Mode, ...]]
    status: Sequence[Status]

    @property
    def best(self) -> Poses:
        """The reported poses, world_from_camera, (n,)."""
        return Poses.stack([modes[0].world_from_camera for modes in self.modes])


def mode_status(mode: Mode, converged_std_m: float, converged_weight: float) -> Status:
    """The status of a baseline, by the weight and the position of its best mode."""
    sure = mode.widest_std_m <= converged_std_m and mode.weight >= converged_weight
    return "converged" if sure else "ambiguous"
