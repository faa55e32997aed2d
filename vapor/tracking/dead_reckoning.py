"""Dead reckoning: odometry alone."""

from __future__ import annotations

from collections.abc import Sequence

from filtering.motion import Odometry
from filtering.se3 import Poses


def dead_reckoning(first_pose: Poses, odometry: Sequence[Odometry | None]) -> Poses:
    """Poses from odometry alone.

    Args:
        first_pose: world_from_camera of the first image, one pose.
        odometry: Per image the motion since the previous one, (n,), n ≥ 1. The first is not used; where a later one
            is None the motion is unknown and the pose stays.

    Returns:
        world_from_camera, batch (n,).
    """
    poses = [first_pose]
    for motion in odometry[1:]:
        poses.append(poses[-1] if motion is None else poses[-1] @ motion.previous_from_current)
    return Poses.stack(poses)
