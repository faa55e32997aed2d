"""A whole run in hindsight: the smoothed trajectory with covariances, where the camera was carried off, the runner-up.

The end is the filter's; `filtering.trajectory_search` finds which places led there, and `filtering.chain_solver` where
in them the camera was, by the filter's model of motion, measurements and correlated errors.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise, takewhile
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int64

from filtering.cameras import CameraMemory
from filtering.chain_solver import solve
from filtering.config import GapConfig, LocalizerConfig
from filtering.errors import VaporTrackError, require_within
from filtering.estimate import Mode
from filtering.hindsight import FilterStep, Hindsight, SmoothedTrajectory
from filtering.measurement_noise import MeasurementNoise
from filtering.motion import GapMotion, OdometryBias, measured
from filtering.observation import Observation
from filtering.posterior import PosePosterior
from filtering.prediction import Gap
from filtering.se3 import Poses
from filtering.state_chain import Places, Transition, transition, unknown_prior
from filtering.trajectory_search import Path, SearchStep, most_probable_path
from filtering.unchecked import unchecked_replace
from filtering.vertical import Vertical, VerticalMemory


@dataclass(frozen=True)
class SmoothingConfig:
    """Settings of the smoother."""

    kidnap_rate: float = 3e-3
    """Probability that the camera was carried off unnoticed, at any moment of a run."""
    least_probability: float = 0.05
    """A second trajectory is reported from this probability on."""
    odometry_bias: OdometryBias = field(default_factory=lambda: LocalizerConfig().odometry_bias)
    """Scale error and drift of the odometry; as of the particle filter."""
    gap: GapConfig = field(default_factory=GapConfig)
    """Motion where odometry is missing; as of the particle filter."""
    outlier_places: float = 10.0
    """An outlier shows one of so many places; as of the particle filter."""
    adapt_errors: bool = True
    """Scale the measurement noise as odometry shows; as of the particle filter."""

    def __post_init__(self) -> None:
        require_within(self, kidnap_rate=(1e-300, 1.0), least_probability=(0.0, 1.0), outlier_places=(1.0, 1e9))

    @staticmethod
    def of_filter(config: LocalizerConfig) -> SmoothingConfig:
        """With the settings that the smoother has in common with a filter."""
        return SmoothingConfig(
            odometry_bias=config.odometry_bias,
            gap=config.gap,
            outlier_places=config.outlier_places,
            adapt_errors=config.adapt_errors,
        )


@dataclass(frozen=True)
class Prepared:
    """n images as the filter's sources of places know them.

    Attributes:
        steps: For the search.
        posteriors: Of the images, with the noise scaled as the whole run has shown.
        noise: Of each image, likewise.
        moved: Normalized distance since the image before, by source, (n, s).
        first_source: Of the camera of each image, (n,).
        transitions: Of the state, n − 1.
        verticals: Of the images.
    """

    steps: tuple[SearchStep, ...]
    posteriors: tuple[PosePosterior, ...]
    noise: tuple[MeasurementNoise, ...]
    moved: Float64[np.ndarray, "n s"]
    first_source: Int64[np.ndarray, " n"]
    transitions: tuple[Transition, ...]
    verticals: tuple[Vertical | None, ...]


def smooth(steps: Sequence[FilterStep], noise: MeasurementNoise, config: SmoothingConfig | None = None) -> Hindsight:
    """The most probable trajectory given all images and all odometry, and the second one where that is undecided.

    Args:
        steps: Of the filter, n ≥ 1 images.
        noise: Noise of the images.
        config: Settings.

    Raises:
        VaporTrackError: no step.
    """
    if not steps:
        raise VaporTrackError("no step of the filter to smooth, expected at least one")
    config = config or SmoothingConfig()
    prepared = _prepare(steps, noise, config)
    best, second, carried_off = [], [], np.zeros(len(steps), bool)
    stop = len(steps)
    while stop > 0:  # the last part first: before the camera was carried off, the filter's belief is of no use after it
        modes = steps[stop - 1].modes
        path = _path(prepared, slice(0, stop), modes[0], noise, config)
        breaks = np.flatnonzero(path.carried_off)
        start = int(breaks[-1]) if len(breaks) else 0
        carried_off[start] = start > 0
        part = slice(start, stop)
        best.append(_trajectory(prepared, part, path.poses[part], modes[0].weight, noise, config))
        second.append(None)
        if len(modes) > 1 and modes[1].weight >= config.least_probability:
            other = _path(prepared, part, modes[1], noise, config)
            second[-1] = _trajectory(prepared, part, other.poses, modes[1].weight, noise, config)
        stop = start
    best, second = best[::-1], second[::-1]
    ambiguous = any(part is not None for part in second)
    others = [_improbable(of_best) if part is None else part for of_best, part in zip(best, second, strict=True)]
    return Hindsight(_joined(best), _joined(others) if ambiguous else None, carried_off)


def _improbable(trajectory: SmoothedTrajectory) -> SmoothedTrajectory:
    return replace(trajectory, probability=np.zeros(len(trajectory.poses)))


def _joined(parts: Sequence[SmoothedTrajectory]) -> SmoothedTrajectory:
    return SmoothedTrajectory(
        Poses.concatenate([part.poses for part in parts]),
        np.concatenate([part.covariance for part in parts]),
        np.concatenate([part.probability for part in parts]),
    )


class Sources(NamedTuple):
    """The sources of places of all cameras, along their images, and of verticals after them.

    Attributes:
        cameras: Their memories by name. Those of the n-th camera follow those of the cameras before it.
        vertical: The memory of verticals; None where none are measured.
        in_gap: Whether odometry was missing before the latest image; None before the first image.
    """

    cameras: dict[str, CameraMemory]
    vertical: VerticalMemory | None = None
    in_gap: bool | None = None

    @staticmethod
    def unseen(
        noise: MeasurementNoise, config: SmoothingConfig, names: Iterable[str], vertical: Vertical | None = None
    ) -> Sources:
        """Those of cameras before their first images, with this noise, and of a first vertical."""
        view = Observation.of_posterior(PosePosterior.uninformative(noise), None).views[0]
        cameras = {name: CameraMemory.first_seen(view, 0, unknown=1.0, adapts=config.adapt_errors) for name in names}
        number = sum(len(camera.sources) for camera in cameras.values())
        return Sources(cameras, None if vertical is None else VerticalMemory(number, vertical.lengths))

    def known(self, step: FilterStep, noise: MeasurementNoise, config: SmoothingConfig) -> Sources:
        """The same with those that a step has; itself where it knows them."""
        if step.camera in self.cameras and (step.vertical is None or self.vertical is not None):
            return self
        new = Sources.unseen(noise, config, dict.fromkeys([*self.cameras, step.camera]), step.vertical)
        vertical = new.vertical
        if vertical is None and self.vertical is not None:
            number = sum(len(camera.sources) for camera in new.cameras.values())
            vertical = unchecked_replace(self.vertical, number=number)
        return Sources({**new.cameras, **self.cameras}, vertical, self.in_gap)

    def first_of(self, name: str) -> int:
        """The number of a camera's first source."""
        before = takewhile(lambda other: other != name, self.cameras)
        return sum(len(self.cameras[other].sources) for other in before)

    def after(
        self, step: FilterStep, noise: MeasurementNoise, config: SmoothingConfig
    ) -> tuple[Sources, list[float], Transition | None, SearchStep]:
        """After the next image: the sources, how far they moved, the transition of the state, and what is searched.

        Args:
            step: Of the filter.
            noise: Noise of the images.
            config: Settings.
        """
        vertical, in_gap, motion, to_here = self.vertical, self.in_gap, measured(step.odometry), None
        cameras, moved = self.cameras, [0.0] * sum(len(camera.sources) for camera in self.cameras.values())
        if in_gap is None:
            motion = rescaled = None
            moved = [*moved, *([] if vertical is None else [0.0])]
        elif motion is not None:
            rescaled = motion.rescaled(step.odometry_scale_error)
            cameras, moved = _each({name: camera.predict(rescaled) for name, camera in cameras.items()})
            vertical, moved = _with_vertical(vertical, moved)
            to_here = transition(motion, config.odometry_bias, moved, noise, new_drift=in_gap)
        else:
            # The search turns as far as is known; what is forgotten does not come from anywhere.
            rescaled = None if config.gap.action == "forget" else step.odometry
            likely = step.gap_motion or GapMotion(Poses.identity())
            cameras, moved = _each({name: camera.across_gap(likely) for name, camera in cameras.items()})
            vertical, moved = _with_vertical(vertical, moved)
            gap = Gap.of(step.odometry, step.elapsed_s, config.gap.velocity)
            # Motion without odometry says nothing of its scale.
            velocity = replace(gap.velocity, scale=config.odometry_bias.scale)
            to_here = transition(gap.known, velocity, moved, noise, new_drift=not in_gap)
        power = 0.0
        if not step.posterior.is_uninformative:
            camera, _, power = cameras[step.camera].observe(step.posterior)
            cameras = {**cameras, step.camera: camera}
        searched = SearchStep(
            step.posterior, rescaled, step.elapsed_s, power, config.outlier_places, step.hypotheses, step.weights
        )
        if vertical is not None and step.vertical is not None:
            vertical = vertical.observe(step.vertical)
        return Sources(cameras, vertical, in_gap is not None and motion is None), moved, to_here, searched


def _each(after: Mapping[str, tuple[CameraMemory, list[float]]]) -> tuple[dict[str, CameraMemory], list[float]]:
    cameras = {name: camera for name, (camera, _) in after.items()}
    return cameras, [distance for _, moved in after.values() for distance in moved]


def _with_vertical(vertical: VerticalMemory | None, moved: list[float]) -> tuple[VerticalMemory | None, list[float]]:
    """The memory of verticals after a motion, and how far all sources moved, as of the filter."""
    if vertical is None:
        return None, moved
    vertical, own = vertical.predict(moved[0])
    return vertical, [*moved, own]


def _prepare(steps: Sequence[FilterStep], noise: MeasurementNoise, config: SmoothingConfig) -> Prepared:
    verticals = tuple(step.vertical for step in steps)
    first_vertical = next((each for each in verticals if each is not None), None)
    sources = Sources.unseen(noise, config, dict.fromkeys(step.camera for step in steps), first_vertical)
    cameras, search, distances, transitions = [], [], [], []
    for step in steps:
        sources, moved, to_here, searched = sources.after(step, noise, config)
        cameras.append(sources.cameras[step.camera])
        search.append(searched)
        distances.append(moved)
        if to_here is not None:
            transitions.append(to_here)
    # The scale of the errors is that of the whole run.
    scales = {name: [source.scale for source in camera.sources] for name, camera in sources.cameras.items()}
    noises = [
        replace(
            each,
            sources=tuple(
                replace(source, scale=replace(source.scale, total=last.total, count=last.count))
                for source, last in zip(each.sources, scales[step.camera], strict=True)
            ),
        ).noise
        for step, each in zip(steps, cameras, strict=True)
    ]
    posteriors = tuple(step.posterior.inflated(*(scale.factor for scale in scales[step.camera])) for step in steps)
    first = np.array([sources.first_of(step.camera) for step in steps], np.int64)
    moved = np.array(distances)
    return Prepared(tuple(search), posteriors, tuple(noises), moved, first, tuple(transitions), verticals)


def _path(prepared: Prepared, part: slice, end: Mode, noise: MeasurementNoise, config: SmoothingConfig) -> Path:
    return most_probable_path(prepared.steps[part], end.world_from_camera, noise, config.kidnap_rate, config.gap)


def _trajectory(
    prepared: Prepared, part: slice, start: Poses, probability: float, noise: MeasurementNoise, config: SmoothingConfig
) -> SmoothedTrajectory:
    """The trajectory over a part of the images without a break, from poses (n,) that are near it."""
    loose = [i for i in range(part.start + 1, part.stop) if prepared.transitions[i - 1].is_loose]
    poses, covariances = [], []
    for begin, end in pairwise([part.start, *loose, part.stop]):
        own = slice(begin, end)
        places = Places(
            prepared.posteriors[own],
            prepared.moved[own],
            prepared.noise[own],
            prepared.first_source[own],
            prepared.verticals[own],
        )
        here = start[begin - part.start : end - part.start]
        prior = unknown_prior(here[0], noise, config.odometry_bias, prepared.moved.shape[1])
        chain, covariance = solve(here, prior, prepared.transitions[begin : end - 1], places, noise)
        poses.append(chain.poses)
        covariances.append(covariance)
    return SmoothedTrajectory(
        Poses.concatenate(poses), np.concatenate(covariances), np.full(part.stop - part.start, probability)
    )
