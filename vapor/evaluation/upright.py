"""Which way is up, as cameras tell that took images of a place."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64

from filtering.se3 import Poses

_UPWARD = 0.2  # how much rather z is taken for up than another axis


def upward(poses: Poses) -> Float64[np.ndarray, "3"]:
    """The axis of the world, or its opposite, that is up in most images.

    Args:
        poses: world_from_camera, (n,), n ≥ 1.
    """
    right, up = poses.rotation[:, :, 0], -poses.rotation[:, :, 1]
    signed = np.concatenate([np.eye(3), -np.eye(3)])
    upright = (up @ signed.T).mean(axis=0) - np.abs(right @ signed.T).mean(axis=0)
    return signed[int(np.argmax(upright + _UPWARD * (np.arange(6) == 2)))]
