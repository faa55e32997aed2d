"""The step loop: image after image, the posterior and the odometry go to the filter and to every baseline."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Protocol, runtime_checkable

from filtering.estimate import Estimate, Mode, posterior_modes
from filtering.motion import Odometry
from filtering.posterior import PosePosterior


@runtime_checkable
class Localizer(Protocol):
    """The filter as the loop sees it: `ParticleLocalizer`, or an ablation of it."""

    def update(self, posterior: PosePosterior, odometry: Odometry | None, /, *, elapsed_s: float) -> Estimate:
        """Localize one image, see `ParticleLocalizer.update`."""
        ...


@runtime_checkable
class Tracker(Protocol):
    """A baseline that goes from image to image, as the filter does."""

    def update(self, posterior: PosePosterior, odometry: Odometry | None, *, elapsed_s: float) -> tuple[Mode, ...]:
        """Take one image.

        Args:
            posterior: The image's posterior.
            odometry: Motion since the previous image, not used on the first one; None where it is unknown.
            elapsed_s: Seconds since the previous image.

        Returns:
            Hypotheses, at least one, the best one first.
        """
        ...


@dataclass(frozen=True)
class Step:
    """What the methods made of one image.

    Attributes:
        posterior: The image's posterior.
        estimate: What the filter believes after the image.
        image_modes: Places of the image's posterior alone, by falling weight. Where it has none: those of the last
            image that had any; before that, the filter's modes.
        evidence: Places of the image's posterior, none where it says nothing: what a smoother is told.
        baselines: Hypotheses of every baseline by its name, the best one first.
        step_ms: Wall-clock milliseconds that posterior and filter took, without the baselines: in all, also where the
            posterior was computed while the filter had the image before.
    """

    posterior: PosePosterior
    estimate: Estimate
    image_modes: tuple[Mode, ...]
    evidence: tuple[Mode, ...]
    baselines: Mapping[str, tuple[Mode, ...]]
    step_ms: float


class Baselines:
    """Leads baselines from image to image, all with the same posteriors and odometry.

    Args:
        trackers: The baselines by name, see `start_baselines`.
    """

    def __init__(self, trackers: Mapping[str, Tracker]) -> None:
        self._trackers, self._clock = trackers, _Clock()

    def step(self, time_ns: int, posterior: PosePosterior, odometry: Odometry | None) -> dict[str, tuple[Mode, ...]]:
        """Take one image, see `StepLoop.step`; gives hypotheses by the baselines' names, the best one first."""
        elapsed_s = self._clock.elapsed_s(time_ns)
        return {
            name: tracker.update(posterior, odometry, elapsed_s=elapsed_s) for name, tracker in self._trackers.items()
        }


class _Clock:
    """Seconds since the image before."""

    def __init__(self) -> None:
        self._previous_ns: int | None = None

    def elapsed_s(self, time_ns: int) -> float:
        elapsed_s = 0.0 if self._previous_ns is None else max(time_ns - self._previous_ns, 0) * 1e-9
        self._previous_ns = time_ns
        return elapsed_s


class StepLoop:
    """Leads the filter and its baselines from image to image, all with the same posteriors and odometry.

    Args:
        localizer: The filter.
        baselines: The baselines by name, see `start_baselines`; none where they are led elsewhere.
    """

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
        """Take one image.

        Args:
            time_ns: Stamp of the image.
            posterior: Its posterior.
            odometry: Motion since the previous image; None where it is unknown.
            observe_ms: Milliseconds that the posterior took.

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
            () if posterior.says_nothing else places,
            self._baselines.step(time_ns, posterior, odometry),
            step_ms,
        )
