"""A few of many: evenly spaced in their order."""

from __future__ import annotations

import numpy as np
from jaxtyping import Int64

from filtering.se3 import Poses

MAX_PRIOR_POSES = 2000
"""Most prior poses that a model file holds."""


def spaced(count: int, limit: int) -> Int64[np.ndarray, " n"]:
    """Indices of min(count, limit) of `count` things, evenly spaced in their order."""
    return np.linspace(0, count - 1, min(count, limit)).round().astype(np.int64)


def thin_poses(poses: Poses, limit: int = MAX_PRIOR_POSES) -> Poses:
    """At most `limit` of the poses (n,), evenly spaced in their order."""
    return poses if len(poses) <= limit else poses[spaced(len(poses), limit)]
