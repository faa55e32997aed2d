"""Figures of many runs: all methods side by side, short sequences, intervals over walks."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from types import MappingProxyType
from typing import Any

import numpy as np
from jaxtyping import Bool, Float64, Int64

from filtering.estimate import Mode
from filtering.se3 import Poses
from filtering.storeys import Storeys
from sequences.frame import Trajectory
from vapor.evaluation.consistency import evaluate_belief, truth_among_modes
from vapor.evaluation.storeys import evaluate_storey, storey_accuracy
from vapor.evaluation.trajectory import evaluate_trajectory
from vapor.tracking.ablations import ABLATIONS, Ablation
from vapor.tracking.follow import Followed, Segment, follow
from vapor.tracking.loop import Belief
from vapor.tracking.methods import BASELINES, METHODS, in_order

LOCALIZING = tuple(method for method in METHODS if method != "dead_reckoning")
"""Methods that find the camera by themselves: dead reckoning is given its start."""

BELIEVING = (*BASELINES, "filter")
"""Methods that state their confidence after every image."""

OURS = "filter"
"""The method that the benchmarks are about."""


def ours_first() -> list[str]:
    """Names in `BELIEVING`, the particle filter first."""
    return [OURS, *(method for method in BELIEVING if method != OURS)]


def label(method: str) -> str:
    """A method in tables."""
    return method.replace("_", " ")


def short_label(method: str) -> str:
    """A method in narrow columns."""
    return METHODS[method].short_label or label(method)


def _scaled_poses(poses: Poses, factor: float) -> Poses:
    return Poses(poses.rotation, factor * poses.translation)


def _scaled_mode(mode: Mode, factor: float) -> Mode:
    pose = _scaled_poses(mode.world_from_camera, factor)
    lengths = np.repeat([factor, 1.0], 3)
    return replace(mode, world_from_camera=pose, covariance=mode.covariance * np.outer(lengths, lengths))


def _scaled_belief(belief: Belief, factor: float) -> Belief:
    return replace(belief, modes=[tuple(_scaled_mode(mode, factor) for mode in modes) for modes in belief.modes])


@dataclass(frozen=True)
class Comparison:
    """What every method made of a segment of n images.

    Attributes:
        poses: Poses of every method by its name in `METHODS`, world_from_camera, batches (n,).
        beliefs: Of the filter and each baseline, by name.
        image_modes: Places of each image's posterior alone, (n,).
        particles: Median number of particles of the filter.
        step_ms: Median milliseconds of a step of the filter.
        kidnap_index: First image after the camera was carried off; None where it was not.
    """

    times_ns: Int64[np.ndarray, " n"]
    truth: Poses
    poses: dict[str, Poses]
    beliefs: dict[str, Belief]
    image_modes: tuple[tuple[Mode, ...], ...]
    particles: int
    step_ms: float
    kidnap_index: int | None = None

    def figures(
        self,
        images: Bool[np.ndarray, " n"] | None = None,
        *,
        storey_height_m: float | None = None,
        storeys: Storeys | None = None,
    ) -> dict[str, Any]:
        """What every method was worth, as JSON.

        Args:
            images: Which images count, at least one; None for all.
            storey_height_m: From storey to storey, in the unit of the poses, where storeys look alike.
            storeys: Of the building, where there are several, in the unit of the poses.

        Returns:
            `images`, `methods` (see `evaluate_trajectory`), `belief` of the baselines and of the filter (see
            `evaluate_belief`), `image_truth_among_modes` (of the single images' posteriors), `particles` and `step_ms`.
            Where storeys look alike, `methods` have `storey` (see `evaluate_storey`), and `belief` has `on_storey`.
            Where there are several, `methods` have `storey_accuracy`.
        """
        every = np.ones(len(self.times_ns), bool)
        at = np.flatnonzero(every if images is None else images)
        times_ns, truth = self.times_ns[at], self.truth[at]
        methods = {
            name: evaluate_trajectory(
                Trajectory(times_ns, poses[at]),
                Trajectory(times_ns, truth),
                # Whoever is carried off has no one moment from which on all is right.
                tracking=METHODS[name].can_converge and self.kidnap_index is None,
            )
            for name, poses in in_order(self.poses).items()
        }
        if storey_height_m is not None:
            for name, each in methods.items():
                each["storey"] = evaluate_storey(self.poses[name][at], truth, storey_height_m)
        if storeys is not None:
            for name, each in methods.items():
                each["storey_accuracy"] = storey_accuracy(self.poses[name][at], truth, storeys)
        belief = {
            name: evaluate_belief(
                Belief([each.modes[i] for i in at.tolist()], [each.status[i] for i in at.tolist()]),
                times_ns,
                truth,
                converged_at_s=methods[name].get("converged_at_s"),
                kidnap_index=self.kidnap_index,
                storey_height_m=storey_height_m,
            )
            for name, each in self.beliefs.items()
        }
        return {
            "images": len(at),
            "methods": methods,
            "belief": belief,
            "image_truth_among_modes": truth_among_modes([self.image_modes[i] for i in at.tolist()], truth),
            "particles": self.particles,
            "step_ms": self.step_ms,
        }

    def scaled(self, factor: float) -> Comparison:
        """The same where all lengths are multiplied by a factor: evaluated in metres, or in another unit."""
        return replace(
            self,
            truth=_scaled_poses(self.truth, factor),
            poses={name: _scaled_poses(each, factor) for name, each in self.poses.items()},
            beliefs={name: _scaled_belief(belief, factor) for name, belief in self.beliefs.items()},
            image_modes=tuple(tuple(_scaled_mode(mode, factor) for mode in modes) for modes in self.image_modes),
        )


def compare(followed: Followed) -> Comparison:
    """Every method over a segment: those that went from image to image, and those that see it as a whole."""
    return Comparison(
        followed.segment.times_ns,
        followed.segment.truth,
        followed.poses | followed.poses_at_end(),
        followed.beliefs,
        followed.image_modes,
        followed.particles,
        followed.step_ms,
        followed.kidnap_index,
    )


LENGTHS = (15, 100)
"""Images of a sequence."""

LAST = 10
"""So many images at the end of a sequence count."""

SUCCESS_M: Mapping[str, float] = MappingProxyType({"1m": 1.0, "0.5m": 0.5})
"""Limits of the position's error, metres."""


def succeeds(poses: Poses, truth: Poses) -> dict[str, bool]:
    """Whether the last ten of a sequence's poses (n,), n ≥ 10, are all closer to the truth than each of `SUCCESS_M`."""
    error_m = poses[-LAST:].distance(truth[-LAST:])[0]
    return {name: bool((error_m < limit_m).all()) for name, limit_m in SUCCESS_M.items()}


def starts_of_sequences(segment: Segment, length: int, images: Bool[np.ndarray, " n"]) -> Iterator[int]:
    """First images of sequences without a common image, in order.

    Args:
        images: Which images may be in a sequence, (n,).

    Yields:
        The earliest ones whose sequence has odometry all along, and whose first image has a place.
    """
    start = 0
    while start + length <= len(segment.times_ns):
        unknown = [i for i in range(start, start + length) if not images[i]]
        breaks = [i for i in range(start + 1, start + length) if segment.odometry[i] is None]
        if unknown or breaks:
            start = max([i + 1 for i in unknown] + breaks)
        elif len(segment.posterior(start).weights) == 0:
            start += 1
        else:
            yield start
            start += length


def evaluate_sequences(
    followed: Followed,
    *,
    seed: Sequence[int],
    images: Bool[np.ndarray, " n"] | None = None,
    unit_m: float = 1.0,
    ablation: Ablation = ABLATIONS["full"],
    baselines: Collection[str] = BASELINES,
) -> dict[str, dict[str, Any]]:
    """Cut a segment into sequences, start filter and baselines in each, and count those that succeed.

    Posteriors of images are those of the whole segment; no state of a filter is kept.

    Args:
        followed: The segment, with the errors and the settings of its filter.
        images: Which images may be in a sequence, (n,); None for all.
        unit_m: Limits are in units of so many metres.

    Returns:
        For each of `LENGTHS` the number of `sequences`, and `success`: by method, of the single image, the baselines
        and the filter, the fraction of them that succeed within each of `SUCCESS_M`; None if there are no sequences.
    """
    whole = Segment(
        followed.segment.times_ns, followed.segment.odometry, followed.segment.truth, cache(followed.segment.posterior)
    )
    allowed = np.ones(len(whole.times_ns), bool) if images is None else images
    figures: dict[str, dict[str, Any]] = {}
    for length in LENGTHS:
        succeeded: dict[str, list[dict[str, bool]]] = {}
        starts = list(starts_of_sequences(whole, length, allowed))
        for start in starts:
            sequence = whole.part(start, start + length)
            rng = np.random.default_rng([*seed, length, start])
            again = follow(sequence, followed.errors, followed.config, rng=rng, ablation=ablation, baselines=baselines)
            for name, poses in again.poses.items():
                if name != "dead_reckoning":  # its start is given
                    scaled = (Poses(each.rotation, each.translation / unit_m) for each in (poses, sequence.truth))
                    succeeded.setdefault(name, []).append(succeeds(*scaled))
        figures[str(length)] = {
            "sequences": len(starts),
            "success": {
                name: {limit: float(np.mean([each[limit] for each in found])) for limit in SUCCESS_M}
                for name, found in succeeded.items()
            }
            or None,
        }
    return figures


Interval = tuple[float, float]

_RESAMPLES = 1000
_TAILS = (2.5, 97.5)  # percentiles: 95 % lie between


class Walks:
    """The walks of n ≥ 1 runs, drawn a thousand times with replacement: all runs cut from a walk come with it.

    Intervals are percentiles of a figure over these draws (bootstrap of clusters: Davison and Hinkley, "Bootstrap
    Methods and Their Application", 1997, §3.8); the same runs give the same. They are None where fewer than two walks
    have a value. Where all walks agree they have no width, which is no proof: see `dissent`.

    Args:
        walks: Which walk each run is cut from, (n,).
    """

    def __init__(self, walks: Sequence[int]) -> None:
        self._walk = np.unique(walks, return_inverse=True)[1]
        every = self.count
        drawn = np.random.default_rng(0).multinomial(every, np.full(every, 1.0 / every), size=_RESAMPLES)
        self._times = drawn[:, self._walk]  # how often each run is in each draw

    @property
    def count(self) -> int:
        """How many walks there are."""
        return int(self._walk.max()) + 1

    def mean(
        self, values: Sequence[int | float | None], weights: Sequence[int | float] | None = None
    ) -> Interval | None:
        """Interval of the mean of the runs' values (n,), weighted if asked for; runs without a value do not count."""
        known = np.array([value is not None for value in values])
        weight = known * (1.0 if weights is None else np.array(weights))
        total = self._times @ weight
        of_draws = self._times @ (weight * np.array([value or 0.0 for value in values]))
        return self._interval(known, of_draws[total > 0] / total[total > 0])

    def number(self, flags: Sequence[bool]) -> Interval | None:
        """Interval of how many of the runs have a flag, (n,)."""
        fraction = self.mean(flags)
        return None if fraction is None else (len(flags) * fraction[0], len(flags) * fraction[1])

    def median(self, values: Sequence[int | float | None]) -> Interval | None:
        """Interval of the median of the runs' values (n,); runs without one do not count."""
        known = np.array([value is not None for value in values])
        numbers = np.array([value for value in values if value is not None], np.float64)
        order = np.argsort(numbers)
        up_to = np.cumsum(self._times[:, known][:, order], axis=1)
        up_to = up_to[up_to.any(axis=1)]
        total = up_to[:, -1:]
        middle = [(up_to <= rank).sum(axis=1) for rank in ((total - 1) // 2, total // 2)]
        return self._interval(known, numbers[order][np.array(middle)].mean(axis=0))

    def _interval(self, known: np.ndarray, of_draws: Float64[np.ndarray, " k"]) -> Interval | None:
        if len(np.unique(self._walk[known])) < 2:
            return None
        low, high = np.percentile(of_draws, _TAILS)
        return float(low), float(high)


def dissent(walks: int) -> float:
    """The largest fraction of walks that are otherwise, with 95 % confidence, where so many agree: about 3 in n."""
    return 1.0 - 0.05 ** (1.0 / walks)
