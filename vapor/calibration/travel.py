"""How far the camera came along its passes, and the pairs of images that one pass has."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int64

from filtering.se3 import Poses

LEAST_PAIRS = 50
"""Pairs of images, below which nothing is said of how long anything lasts."""
_MOST_PAIRS = 10**6


@dataclass(frozen=True)
class Travel:
    """How far the camera travelled and turned between n images, and which of them belong to one pass.

    Attributes:
        pass_number: Of the pass that each image is from, (n,); images of one pass lie together.
        metres: Travelled since the first image of its pass, (n,).
        radians: Turned since then, (n,).
    """

    pass_number: Int64[np.ndarray, " n"]
    metres: Float64[np.ndarray, " n"]
    radians: Float64[np.ndarray, " n"]

    @staticmethod
    def along(poses: Poses, pass_number: Int64[np.ndarray, " n"]) -> Travel:
        """The travel along poses (n,) of numbered passes, each in order of time."""
        begins = np.diff(pass_number, prepend=pass_number[:1] - 1) != 0
        steps = poses[:-1].distance(poses[1:])
        metres, radians = (np.cumsum(np.append(0.0, step)) for step in steps)
        first = np.flatnonzero(begins)[np.cumsum(begins) - 1]
        return Travel(pass_number, metres - metres[first], radians - radians[first])

    def __getitem__(self, indices: Int64[np.ndarray, " k"]) -> Travel:
        return Travel(self.pass_number[indices], self.metres[indices], self.radians[indices])


def pairs_of_images(
    travel: Travel, usable: Bool[np.ndarray, " n"]
) -> tuple[Int64[np.ndarray, " k"], Int64[np.ndarray, " k"]]:
    """Indices of the earlier and the later image of k pairs, each of one pass.

    Where there are so many images that not all pairs can be looked at, those farthest apart are left out.

    Args:
        travel: Of n images.
        usable: Which of them may be in a pair.
    """
    firsts, seconds = [np.empty(0, np.int64)], [np.empty(0, np.int64)]
    for lag in range(1, min(len(usable), _MOST_PAIRS // max(len(usable), 1) + 1)):
        first = np.flatnonzero((travel.pass_number[lag:] == travel.pass_number[:-lag]) & usable[lag:] & usable[:-lag])
        firsts.append(first)
        seconds.append(first + lag)
    return np.concatenate(firsts), np.concatenate(seconds)
