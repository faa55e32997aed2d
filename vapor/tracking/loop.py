"""The step loop: posterior and odometry of each image go to the filter and to every baseline."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Protocol, runtime_checkable

from filtering.estimate import Estimate, Mode, Status, posterior_modes
from filtering.motion import Odometry
from filtering.posterior import PosePosterior
from filtering.se3 import Poses

MOST_MODES = 16
"""Kept of each image, the heaviest: enough for a place among many alike, and bounded in memory over a long run."""


@runtime_checkable
class Localizer(Protocol):
    """The filter: `ParticleLocalizer`, or an ablation of it."""

    def update(self, posterior: PosePosterior, odometry: Odometry | None, /, *, elapsed_s: float) -> Estimate:
        """Localize one image, see `ParticleLocalizer.update`."""
        ...


@runtime_checkable
class Tracker(Protocol):
    """A baseline that goes from image to image."""

    def update(self, posterior: PosePosterior, odometry: Odometry | None, /, *, elapsed_s: float) -> Estimate | Mode:
        """Take one image; odometry is None where unknown, and not used on the first one."""
        ...


@dataclass(frozen=True)
class Step:
    """The results of the methods for one image.

    Attributes:
        posterior: The image's posterior.
        estimate: The filter's estimate.
        image_modes: Places of the image's posterior alone, by falling weight. Where it has none: those of the last
            image with any; before that, the filter's modes.
        evidence: Places of the image's posterior for the smoother; none of an uninformative image.
        baselines: Hypotheses of every baseline by its name, the best one first.
        step_ms: Wall-clock milliseconds of posterior and filter together, without the baselines.
    """

    posterior: PosePosterior
    estimate: Estimate
    image_modes: tuple[Mode, ...]
    evidence: tuple[Mode, ...]
    baselines: Mapping[str, tuple[Mode, ...]]
    step_ms: float


class Baselines:
    """Steps baselines, all with the same posteriors and odometry."""

    def __init__(self, trackers: Mapping[str, Tracker]) -> None:
        self._trackers, self._clock = trackers, _Clock()

    def step(self, time_ns: int, posterior: PosePosterior, odometry: Odometry | None) -> dict[str, tuple[Mode, ...]]:
        """Take one image, see `StepLoop.step`; gives hypotheses by the baselines' names, the best one first."""
        elapsed_s = self._clock.elapsed_s(time_ns)
        found = {name: each.update(posterior, odometry, elapsed_s=elapsed_s) for name, each in self._trackers.items()}
        return {name: each.modes if isinstance(each, Estimate) else (each,) for name, each in found.items()}


class _Clock:
    def __init__(self) -> None:
        self._previous_ns: int | None = None

    def elapsed_s(self, time_ns: int) -> float:
        elapsed_s = 0.0 if self._previous_ns is None else max(time_ns - self._previous_ns, 0) * 1e-9
        self._previous_ns = time_ns
        return elapsed_s


class StepLoop:
    """Steps the filter and its baselines (`start_baselines`), all with the same posteriors and odometry."""

    def __init__(self, localizer: Localizer, baselines: Mapping[str, Tracker] = MappingProxyType({})) -> None:
        self._localizer = localizer
        self._baselines, self._clock = Baselines(baselines), _Clock()
        self._image_modes: tuple[Mode, ...] = ()

    def step(
        self,
        time_ns: int,
        posterior: PosePosterior,
        odometry: Odometry | None,
        *,
        observe_ms: float,
    ) -> Step:
        """Take one image, whose posterior took `observe_ms` milliseconds; odometry is None where unknown.

        Raises:
            VaporTrackError: unusable posterior or odometry.
        """
        elapsed_s = self._clock.elapsed_s(time_ns)
        begin = time.perf_counter()
        estimate = self._localizer.update(posterior, odometry, elapsed_s=elapsed_s)
        step_ms = observe_ms + 1e3 * (time.perf_counter() - begin)
        places = posterior_modes(posterior)
        self._image_modes = places or self._image_modes or estimate.modes
        return Step(
            posterior,
            estimate,
            self._image_modes,
            () if posterior.is_uninformative else places,
            self._baselines.step(time_ns, posterior, odometry),
            step_ms,
        )


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


@dataclass(frozen=True)
class History:
    """The steps of n images, without posterior samples and particles; `filtered` are the filter's best modes."""

    evidence: list[tuple[Mode, ...]] = field(default_factory=list)
    odometry: list[Odometry | None] = field(default_factory=list)
    normalized_distances: list[float] = field(default_factory=list)
    filtered: list[Poses] = field(default_factory=list)
    converged: list[bool] = field(default_factory=list)

    def add(self, step: Step, odometry: Odometry | None) -> None:
        """Append one image."""
        self.evidence.append(step.evidence[:MOST_MODES])
        self.odometry.append(odometry)
        self.normalized_distances.append(step.estimate.normalized_distance)
        self.filtered.append(step.estimate.modes[0].world_from_camera)
        self.converged.append(step.estimate.status == "converged")
