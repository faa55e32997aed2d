"""The map from above that cameras outline: which way is up, its cells, and directions in words."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64

from filtering.se3 import Poses
from vapor.evaluation.upright import upward

SECTORS = 8
STEEP = np.sin(np.deg2rad(60.0))
_COMPASS = ("east", "north-east", "north", "north-west", "west", "south-west", "south", "south-east")
_MOST_CELLS = 50  # along the longer side of the plan


@dataclass(frozen=True)
class Plan:
    """A map from above.

    Attributes:
        axes: Right and up on the map, and up in the world: unit vectors in the world, rows (3, 3).
        names: Of the first two, such as "x" or "-y".
        cell_m: Side of its cells, metres.
    """

    axes: Float64[np.ndarray, "3 3"]
    names: tuple[str, str]
    cell_m: float

    @staticmethod
    def of(poses: Poses, near_m: float) -> Plan:
        """The plan of where cameras (n,) were: up is the axis of the world that is up in most images."""
        up = upward(poses)
        first = np.eye(3)[0 if up[0] == 0.0 else 1]
        second = np.cross(up, first)
        names = [f"{'-' if axis.sum() < 0 else ''}{'xyz'[int(np.argmax(np.abs(axis)))]}" for axis in (first, second)]
        extent = np.ptp(poses.translation @ np.stack([first, second]).T, axis=0).max()
        cell_m = _round(max(near_m / 2, extent / _MOST_CELLS))
        return Plan(np.stack([first, second, up]), (names[0], names[1]), cell_m)

    def places(self, poses: Poses) -> Float64[np.ndarray, "n 3"]:
        """Positions on the map and heights, metres."""
        return poses.translation @ self.axes.T

    def sectors(self, poses: Poses) -> Int64[np.ndarray, " n"]:
        """Which way cameras look: 0 to 7 from right on the map counterclockwise, 8 up and 9 down."""
        ahead = poses.rotation[:, :, 2] @ self.axes.T
        level = np.round(np.arctan2(ahead[:, 1], ahead[:, 0]) / (2 * np.pi / SECTORS)).astype(np.int64) % SECTORS
        return np.where(np.abs(ahead[:, 2]) < STEEP, level, np.where(ahead[:, 2] > 0, SECTORS, SECTORS + 1))

    def direction(self, sector: int) -> str:
        """A direction in words: by the compass where z is up, with y to the north; else by axes."""
        if sector >= SECTORS:
            return "up" if sector == SECTORS else "down"
        if self.names == ("x", "y"):
            return _COMPASS[sector]
        turn = sector * 2 * np.pi / SECTORS
        parts = []
        for size, name in zip((np.cos(turn), np.sin(turn)), self.names, strict=True):
            if abs(size) > 0.1:
                negative = (size < 0) != name.startswith("-")
                parts.append(f"{'-' if negative else '+'}{name[-1]}")
        return " ".join(parts)


def _round(value: float) -> float:
    """Up to 1, 2 or 5 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(power * next(step for step in (1, 2, 5, 10) if step * power >= value * (1 - 1e-9)))
