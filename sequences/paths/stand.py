"""Where a body stops on its path, and stands."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from filtering.se3 import Poses
from sequences.paths.motion import STEP_S
from sequences.paths.timing import EXPOSURE_S, TAIL_S, odometry_stamps, poses_at

_STOPPING_S = 0.4  # to come to rest, and to walk again


@dataclass(frozen=True)
class Stand:
    """The camera comes to rest and stands, perfectly still, on a path that is otherwise as it would be.

    Attributes:
        image: The first image at rest; the last 0.4 s before it are slower.
        duration_s: How long; rounded to whole images, at least one.
        walks_on: Whether the rest of the path follows; else the sequence ends.
    """

    image: int
    duration_s: float
    walks_on: bool = False


def halted(base: Poses, image_time_ns: int, duration_s: float, *, walks_on: bool) -> Poses:
    """The path of the body as it is walked with a stand: at rest from half an exposure before the image on."""
    times_ns = odometry_stamps(base)
    still_from = int(np.searchsorted(times_ns, image_time_ns - round(EXPOSURE_S * 0.5e9), side="right")) - 1
    steps, ramp_steps = math.ceil(duration_s / STEP_S) + 2, round(_STOPPING_S / STEP_S)
    ramp = (np.arange(ramp_steps) + 0.5) / ramp_steps  # fraction of the speed
    before = np.concatenate([np.ones(max(still_from - ramp_steps, 0)), ramp[::-1]])[-still_from:]
    after = np.concatenate([ramp, np.ones(len(base))])[: len(base) - 1 - still_from]
    if not walks_on:
        after = np.zeros(round(TAIL_S / STEP_S))
    step_ns = round(STEP_S * 1e9)
    walked_ns = step_ns * np.concatenate([[0.0], np.cumsum(np.concatenate([before, np.zeros(steps), after]))])
    return poses_at(times_ns, base, times_ns[0] + np.round(walked_ns).astype(np.int64))
