"""Colours by which hypotheses are told apart from image to image."""

from __future__ import annotations

import numpy as np
from jaxtyping import UInt8
from scipy.optimize import linear_sum_assignment

from filtering.motion import Odometry
from filtering.se3 import Poses

BEST = (50, 135, 255)
"""The colour of the best hypothesis."""
_OTHERS = (
    (235, 95, 30),
    (225, 120, 200),
    (240, 228, 66),
    (190, 130, 70),
    (230, 45, 100),
    (150, 200, 40),
    (255, 180, 170),
    (120, 130, 60),
    (0, 200, 200),
    (160, 60, 60),
)


class HypothesisColors:
    """A colour for each hypothesis, as long as there is one where its motion leads; the best one is always blue.

    Args:
        length_m: A difference in position that counts as much as one of a radian.
    """

    def __init__(self, length_m: float) -> None:
        self._length_m = length_m
        self._poses: Poses | None = None
        self._numbers = np.zeros(0, np.int64)

    def of(self, poses: Poses, odometry: Odometry | None) -> UInt8[np.ndarray, "n 3"]:
        """Colours of the hypotheses after another image.

        Args:
            poses: Of them, world_from_camera, (n,), the best one first.
            odometry: Motion since the last image; None where it is unknown, and taken for small.
        """
        numbers = np.full(len(poses), -1)
        if self._poses is not None:
            moved = self._poses if odometry is None else self._poses @ odometry.previous_from_current
            metres_sq, turned = poses.squared_distances(moved)
            here, before = linear_sum_assignment(metres_sq / self._length_m**2 + turned)
            numbers[here] = self._numbers[before]
        free = iter(sorted(set(range(2 * len(poses))) - set(numbers.tolist())))
        numbers = np.array([number if number >= 0 else next(free) for number in numbers.tolist()], np.int64)
        self._poses, self._numbers = poses, numbers
        colors = np.array(_OTHERS, np.uint8)[numbers % len(_OTHERS)]
        colors[0] = BEST
        return colors
