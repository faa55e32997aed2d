"""A fixed-lag smoother: each pose by the images until some seconds later, while the camera moves on.

It holds the states of the last seconds in a window (`filtering.state_chain`), and what earlier images say as a prior of
its first. Where the filter goes over to another place, the window is searched anew (`filtering.trajectory_search`).

Source: Dellaert and Kaess, "Factor graphs for robot perception", 2017, § 7.3 (marginalisation of a window).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from filtering.chain_solver import (
    Factors,
    Graph,
    covariance_of,
    covariances_of,
    factors_of,
    graph_of,
    marginalised,
    prior_factor,
    solved_from_first,
    updated,
)
from filtering.errors import VaporTrackError
from filtering.estimate import Mode, ModeConfig
from filtering.hindsight import FilterStep
from filtering.hypotheses import BIAS, POSE
from filtering.measurement_noise import MeasurementNoise
from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from filtering.smoothing import SmoothingConfig, Sources
from filtering.state_chain import Chain, Places, Transition, unknown_prior
from filtering.trajectory_search import SearchStep, most_probable_path
from filtering.vertical import Vertical

_NOTHING = PosePosterior.uninformative()
_ROUNDS = 4  # of Gauss-Newton, where a window begins anew
_RELINEARISED = 0.5  # ordinary standard deviations that a pose changes, until the window is linearised again


@dataclass(frozen=True)
class LaggedPose:
    """The pose of an image by the images until a lag later.

    Attributes:
        number: Of the image, from 0.
        world_from_camera: One pose.
        covariance: Of ξ = (v, ω), metres and radians, in the tangent at it.
        weight: Of its place in the filter's belief when it was given.
        carried_off: Whether the camera was carried off before it.
    """

    number: int
    world_from_camera: Poses
    covariance: Float64[np.ndarray, "6 6"]
    weight: float
    carried_off: bool


@dataclass(frozen=True)
class _Held:
    """An image of the window."""

    number: int
    time_s: float
    posterior: PosePosterior
    noise: MeasurementNoise
    moved: list[float]
    transition: Transition | None
    searched: SearchStep
    first_source: int
    vertical: Vertical | None = None
    since_vertical: float = 1.0  # lengths since the one before
    carried_off: bool = False


class FixedLagSmoother:
    """Gives the pose of each image once the filter has had the images of some seconds after it.

    Args:
        lag_s: Seconds, above 0.
        noise: Noise of the images.
        config: Settings of the smoother.
        modes: Which poses are one place; as of the particle filter.

    Raises:
        VaporTrackError: the lag is not a finite positive number.
    """

    def __init__(
        self,
        lag_s: float,
        noise: MeasurementNoise,
        config: SmoothingConfig | None = None,
        modes: ModeConfig | None = None,
    ) -> None:
        if not 0.0 < lag_s < np.inf:
            raise VaporTrackError(f"lag is {lag_s} s, expected a finite number of seconds above 0")
        self.lag_s, self.noise = lag_s, noise
        self._config, self._modes = config or SmoothingConfig(), modes or ModeConfig()
        self._number = 0
        self._begin()

    def _begin(self) -> None:
        self._sources = Sources.unseen(self.noise, self._config, ())
        self._window: list[_Held] = []
        self._chain: Chain | None = None  # about which the factors are linear
        self._factors: Factors = []
        self._of_first: np.ndarray | None = None
        self._time_s, self._weight = 0.0, 1.0

    def update(self, step: FilterStep) -> list[LaggedPose]:
        """Take the next image of the filter; gives the poses that are now the lag behind, in order.

        With the first image of a camera, and the first vertical, the window begins anew, as the state has their lasting
        errors from then on.
        """
        given: list[LaggedPose] = []
        sources = self._sources.known(step, self.noise, self._config)
        if sources is not self._sources:
            given += self._take(len(self._window))
            self._sources, self._chain = sources, None
        memory = self._sources.vertical
        self._sources, moved, to_here, searched = self._sources.after(step, self.noise, self._config)
        since = 1.0 if memory is None else memory.since + moved[-1]
        camera, best = self._sources.cameras[step.camera], step.modes[0]
        self._time_s += 0.0 if to_here is None else step.elapsed_s
        posterior = step.posterior.inflated(*(source.scale.factor for source in camera.sources))
        first = self._sources.first_of(step.camera)
        held = _Held(
            self._number, self._time_s, posterior, camera.noise, moved, to_here, searched, first, step.vertical, since
        )
        self._window.append(held)
        self._number, self._weight = self._number + 1, best.weight
        if to_here is not None and to_here.is_loose:
            given += self._take(len(self._window) - 1)
            self._chain = None
        if self._chain is None or to_here is None or not self._is_followed(self._extend(self._chain, to_here), best):
            given += self._begin_anew(best)
        while len(self._window) > 1 and self._window[-1].time_s - self._window[0].time_s >= self.lag_s - 1e-9:
            given.append(self._take_first())
        return given

    def finish(self) -> list[LaggedPose]:
        """The poses of the images that are left, by all images; the next image is a first one."""
        given = self._take(len(self._window))
        self._begin()
        return given

    @property
    def _key(self) -> int:
        """Of the first state."""
        return self._window[0].number

    @property
    def _graph(self) -> Graph:
        assert self._chain is not None
        return graph_of(prior_factor(self._prior, self._chain, self._key), self._factors)

    def _is_followed(self, now: Chain, best: Mode) -> bool:
        return bool(self._modes.same_place(now.poses[-1], best, self.noise))

    def _extend(self, chain: Chain, to_here: Transition) -> Chain:
        """Add the latest image to the window, and solve; the states as they are then."""
        self._chain = chain = _extended(chain, to_here)
        before, latest = self._window[-2:]
        two = chain.part(slice(-2, None))
        places = _places([before, latest], only_last=True)
        chosen = places.choose(two)
        self._factors += factors_of(two, [to_here], places, chosen, places.enlarged(two, chosen), before.number)[1:]
        moved = self._solve(chain)
        if (np.abs(moved) > _RELINEARISED * np.asarray(self.noise.finest.typical_std)).any():
            self._linearise(self._now)
        return self._now

    def _begin_anew(self, best: Mode) -> list[LaggedPose]:
        """Begin at the filter's best place; images from before the camera was carried off there are given."""
        path = most_probable_path(
            [held.searched for held in self._window],
            best.world_from_camera,
            self.noise,
            self._config.kidnap_rate,
            self._config.gap,
        )
        breaks = np.flatnonzero(path.carried_off)
        first = int(breaks[-1]) if len(breaks) and self._chain is not None else 0
        given = self._take(first)
        if first:
            self._window[0] = replace(self._window[0], carried_off=True)
        num_sources = len(self._window[0].moved)
        self._prior = unknown_prior(path.poses[first], self.noise, self._config.odometry_bias, num_sources)
        self._now = Chain.from_prior(self._prior, path.poses[first:])
        for number in range(_ROUNDS):
            self._linearise(self._now, first=number == 0)
        return given

    def _linearise(self, chain: Chain, *, first: bool = False) -> None:
        """Linearise all factors about a chain, and solve."""
        places = _places(self._window)
        chosen = places.choose(chain)
        larger = np.ones(len(chosen)) if first else places.enlarged(chain, chosen)
        transitions = [held.transition for held in self._window[1:] if held.transition is not None]
        self._chain = chain
        self._factors = factors_of(chain, transitions, places, chosen, larger, self._key)
        self._solve(chain)

    def _solve(self, chain: Chain) -> Float64[np.ndarray, "n 6"]:
        """The states by all factors; the change of each pose."""
        change, self._of_first = solved_from_first(self._graph, self._key, len(self._window), chain.units)
        self._now, moved = updated(chain, change, self._key)
        return moved

    def _take_first(self) -> LaggedPose:
        """The pose of the first image, which leaves the window."""
        chain = self._chain
        assert chain is not None
        if self._of_first is None:  # another image has left the window since
            self._solve(chain)
        assert self._of_first is not None
        held = self._window[0]
        covariance = covariance_of(self._of_first, chain.units)
        given = LaggedPose(held.number, self._now.poses[0], covariance, self._weight, held.carried_off)
        own = [prior_factor(self._prior, chain, self._key), *self._factors[0], self._factors[1][0]]
        self._prior = marginalised(own, chain)
        self._window, self._factors = self._window[1:], [self._factors[1][1:], *self._factors[2:]]
        self._chain, self._now = (each.part(slice(1, None)) for each in (chain, self._now))
        self._of_first = None
        return given

    def _take(self, count: int) -> list[LaggedPose]:
        """The poses of the first images, by the states as they are now; they leave the window."""
        if count == 0 or self._chain is None:
            return []
        # The latest image may not be in the graph yet.
        known = min(count, len(self._factors))
        covariances = covariances_of(self._graph, range(self._key, self._key + known), self._chain.units)
        held, self._window = self._window[:count], self._window[count:]
        return [
            LaggedPose(each.number, self._now.poses[i], covariances[i], self._weight, each.carried_off)
            for i, each in enumerate(held)
        ]


def _places(window: Sequence[_Held], *, only_last: bool = False) -> Places:
    last = len(window) - 1
    posteriors = [_NOTHING if only_last and i < last else held.posterior for i, held in enumerate(window)]
    verticals = [None if only_last and i < last else held.vertical for i, held in enumerate(window)]
    moved, first = np.array([held.moved for held in window]), np.array([held.first_source for held in window])
    since = np.array([held.since_vertical for held in window])
    return Places(posteriors, moved, [held.noise for held in window], first, verticals, since)


def _extended(chain: Chain, to_here: Transition) -> Chain:
    """A chain with one more state, as its last one leads to it."""
    mean = chain.mean[-1:]
    errs = (to_here.matrix[POSE, BIAS] @ mean[0, :7])[None]
    pose = chain.poses[-1:] @ (to_here.previous_from_current @ Poses.exp(errs))
    rest = np.diagonal(to_here.matrix)[6:] * mean
    return Chain(Poses.concatenate([chain.poses, pose]), np.concatenate([chain.mean, rest]), chain.units)
