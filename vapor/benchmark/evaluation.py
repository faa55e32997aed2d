"""Every method evaluated on a segment, as a whole and in short sequences."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache
from types import MappingProxyType
from typing import Any

import numpy as np
from jaxtyping import Bool

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

OURS = "filter"
"""The method that the benchmarks are about."""

BELIEVING = (OURS, *BASELINES, "smoothed")
"""Methods that state their confidence about every image."""


def label(method: str) -> str:
    """A method in tables."""
    return method.replace("_", " ")


def short_label(method: str) -> str:
    """A method in narrow columns."""
    return METHODS[method].short_label or label(method)


def all_poses(followed: Followed) -> dict[str, Poses]:
    """Poses of every method by its name in `METHODS`, world_from_camera, (n,) each."""
    return followed.poses | {"smoothed": followed.smoothed.best, "fixed_lag": followed.fixed_lag}


def evaluate_methods(
    followed: Followed,
    poses: Mapping[str, Poses],
    images: Bool[np.ndarray, " n"] | None = None,
    *,
    unit_m: float = 1.0,
    storey_height_m: float | None = None,
    storeys: Storeys | None = None,
) -> dict[str, Any]:
    """What every method was worth on a segment of n images, as JSON.

    Args:
        followed: The results of the methods.
        poses: Of every method, from `all_poses`.
        images: Which images count, at least one; None for all.
        unit_m: Lengths are evaluated in units of so many metres.
        storey_height_m: From storey to storey, where storeys look alike.
        storeys: Of the building, where there are several.

    Returns:
        `images`, `methods` (see `evaluate_trajectory`), `belief` of the baselines and of the filter (see
        `evaluate_belief`), `image_truth_among_modes` (of the single images' posteriors), `particles` and `step_ms`.
        Where storeys look alike, `methods` have `storey` (see `evaluate_storey`), and `belief` has `on_storey`.
        Where there are several, `methods` have `storey_accuracy`.
    """
    every = followed.segment.times_ns
    at = np.arange(len(every)) if images is None else np.flatnonzero(images)
    times_ns, truth = every[at], _scaled_poses(followed.segment.truth[at], 1.0 / unit_m)
    found = {name: _scaled_poses(each[at], 1.0 / unit_m) for name, each in in_order(poses).items()}

    def modes_of(each_image: Sequence[tuple[Mode, ...]]) -> list[tuple[Mode, ...]]:
        return [tuple(_scaled_mode(mode, 1.0 / unit_m) for mode in each_image[i]) for i in at.tolist()]

    methods = {
        name: evaluate_trajectory(
            Trajectory(times_ns, each),
            Trajectory(times_ns, truth),
            # Whoever is carried off has no one moment from which on all is right.
            tracking=METHODS[name].can_converge and followed.kidnap_index is None,
        )
        for name, each in found.items()
    }
    if storey_height_m is not None:
        for name, each in methods.items():
            each["storey"] = evaluate_storey(found[name], truth, storey_height_m)
    if storeys is not None:
        for name, each in methods.items():
            each["storey_accuracy"] = storey_accuracy(found[name], truth, storeys)
    belief = {
        name: evaluate_belief(
            Belief(modes_of(each.modes), [each.status[i] for i in at.tolist()]),
            times_ns,
            truth,
            converged_at_s=methods[name].get("converged_at_s"),
            kidnap_index=followed.kidnap_index,
            storey_height_m=storey_height_m,
        )
        for name, each in {**followed.beliefs, "smoothed": followed.smoothed}.items()
    }
    return {
        "images": len(at),
        "methods": methods,
        "belief": belief,
        "image_truth_among_modes": truth_among_modes(modes_of(followed.image_modes), truth),
        "particles": followed.particles,
        "step_ms": followed.step_ms,
    }


def _scaled_poses(poses: Poses, factor: float) -> Poses:
    return Poses(poses.rotation, factor * poses.translation)


def _scaled_mode(mode: Mode, factor: float) -> Mode:
    lengths = np.repeat([factor, 1.0], 3)
    pose = _scaled_poses(mode.world_from_camera, factor)
    return replace(mode, world_from_camera=pose, covariance=mode.covariance * np.outer(lengths, lengths))


LENGTHS = (15, 100)
"""Images of a sequence."""

LAST = 10
"""So many images at the end of a sequence count."""

SUCCESS_M: Mapping[str, float] = MappingProxyType({"1m": 1.0, "0.5m": 0.5})
"""Limits of the position's error, metres."""


def succeeds(poses: Poses, truth: Poses, unit_m: float = 1.0) -> dict[str, bool]:
    """Whether the last ten of a sequence's poses (n,), n ≥ 10, are all closer to the truth than each of `SUCCESS_M`.

    Limits are in units of so many metres.
    """
    error = poses[-LAST:].distance(truth[-LAST:])[0] / unit_m
    return {name: bool((error < limit).all()) for name, limit in SUCCESS_M.items()}


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
            again = follow(sequence, followed.noise, followed.config, rng=rng, ablation=ablation, baselines=baselines)
            for name, poses in again.poses.items():
                if name != "dead_reckoning":  # its start is given
                    succeeded.setdefault(name, []).append(succeeds(poses, sequence.truth, unit_m))
        figures[str(length)] = {
            "sequences": len(starts),
            "success": {
                name: {limit: float(np.mean([each[limit] for each in found])) for limit in SUCCESS_M}
                for name, found in succeeded.items()
            }
            or None,
        }
    return figures
