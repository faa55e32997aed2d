"""Images of a run that its model was trained on, by their true poses."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import KDTree

from filtering.se3 import Poses

_SAME = 1e-6  # of a coordinate and of the matrix: a model stores poses as float32


def said_of_trained_images(truth: Sequence[Poses | None], trained: Poses) -> str | None:
    """How many images have the very true pose of a training image; None where none has.

    Two images taken apart never have one pose to seven digits, but for a camera that a simulation places exactly.

    Args:
        truth: world_from_camera of each image, one pose each; None where unknown.
        trained: world_from_camera of the training images, (n,).
    """
    known = [pose for pose in truth if pose is not None]
    if not known or not len(trained):
        return None
    size = max(1.0, float(np.abs(trained.translation).max()))
    poses, remembered = (_numbers(each, size) for each in (Poses.stack(known), trained))
    count = int((KDTree(remembered).query(poses, p=np.inf)[0] < _SAME).sum())
    if not count:
        return None
    return (
        f"{count} of {len(truth)} images were trained on: the model remembers images with exactly their true poses, so"
        " errors of these say nothing about new images"
    )


def _numbers(poses: Poses, size: float) -> np.ndarray:
    return np.concatenate([poses.translation / size, poses.rotation.reshape(-1, 9)], axis=1)
