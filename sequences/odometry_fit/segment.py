"""Odometry and the true poses between its increments."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from filtering.motion import Odometry
from filtering.se3 import Poses


@dataclass(frozen=True)
class OdometrySegment:
    """Consecutive increments of odometry and the true poses that they lead from and to.

    Attributes:
        odometry: n increments of the camera.
        truth: world_from_camera, (n + 1,).
        recording: Number of the recording it is from: the scale error is one for all of it.
    """

    odometry: Sequence[Odometry]
    truth: Poses
    recording: int = 0
