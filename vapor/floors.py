"""Places one above the other: which floor a pose is on, and how good poses are but for it."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np
from jaxtyping import Bool, Int64

from filtering.se3 import Poses
from sequences.scenes import corridor

FLOOR_HEIGHT_M: Mapping[str, float] = MappingProxyType({"corridor": corridor.FLOOR_HEIGHT})
"""From floor to floor, metres along z, in the scenes whose floors look alike from end to end."""


def floors_off(poses: Poses, truth: Poses, floor_height_m: float) -> Int64[np.ndarray, " n"]:
    """By how many floors poses (n,) are too high, to the nearest floor."""
    return np.round((poses.translation[:, 2] - truth.translation[:, 2]) / floor_height_m).astype(np.int64)


def on_true_floor(poses: Poses, truth: Poses, floor_height_m: float) -> Poses:
    """The poses (n,), each moved up or down by whole floors to the true one."""
    down = np.zeros_like(poses.translation)
    down[:, 2] = floor_height_m * floors_off(poses, truth, floor_height_m)
    return Poses(poses.rotation, poses.translation - down)


def once_on_floor(poses: Poses, truth: Poses, floor_height_m: float) -> Bool[np.ndarray, " n"]:
    """The images from the first on which, and on all later ones of which, the floor is right, (n,)."""
    wrong = floors_off(poses, truth, floor_height_m) != 0
    return np.cumsum(wrong[::-1])[::-1] == 0
