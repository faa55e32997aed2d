"""Localization from short sequences, each from a flat prior: how often the last images are right.

The success rate of Chen et al., "F3Loc: Fusion and Filtering for Floorplan Localization", CVPR 2024, §4: a trajectory
is cut into sequences, and one succeeds if the position is within a limit at all of its last ten images. There errors
are of two dimensions and odometry is the true one; here errors are of three, and odometry is what there is.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from functools import cache
from types import MappingProxyType
from typing import Any

import numpy as np
from jaxtyping import Bool

from filtering.se3 import Poses
from vapor.tracking.ablations import ABLATIONS, Ablation
from vapor.tracking.follow import Followed, Passage, follow
from vapor.tracking.methods import BASELINES

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


def starts_of_sequences(passage: Passage, length: int, images: Bool[np.ndarray, " n"]) -> Iterator[int]:
    """First images of sequences without a common image, in order.

    Args:
        passage: n images.
        length: Images of a sequence.
        images: Which ones may be in a sequence, (n,).

    Yields:
        The earliest ones whose sequence has odometry all along, and whose first image has a place.
    """
    start = 0
    while start + length <= len(passage.times_ns):
        unknown = [i for i in range(start, start + length) if not images[i]]
        breaks = [i for i in range(start + 1, start + length) if passage.odometry[i] is None]
        if unknown or breaks:
            start = max([i + 1 for i in unknown] + breaks)
        elif len(passage.posterior(start).weights) == 0:
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
    """Cut a passage into sequences, let filter and baselines begin anew in each, and count those that succeed.

    What each image says is the same as in the passage as a whole; of the filters nothing is kept.

    Args:
        followed: The passage, with the errors and the settings of its filter.
        seed: Of the filters' draws.
        images: Which images may be in a sequence, (n,); None for all.
        unit_m: Limits are in units of so many metres.
        ablation: What is different about the filter.
        baselines: Names of those to run.

    Returns:
        For each of `LENGTHS` the number of `sequences`, and `success`: by method, of the single image, the baselines
        and the filter, the fraction of them that succeed within each of `SUCCESS_M`; None if there are no sequences.
    """
    whole = Passage(
        followed.passage.times_ns, followed.passage.odometry, followed.passage.truth, cache(followed.passage.posterior)
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
                if name != "dead_reckoning":  # which is told where it starts
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
