"""Images that a model was trained on, by their true poses."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from filtering.se3 import Poses

_LEAST = 3  # of equal poses: recordings often begin at the identity


def count_trained_images(truth: Poses, trained: Poses) -> int:
    """Number of images with exactly the true pose of a training image; 0 where hardly any has one.

    A pose counts that is that of one image and of one training image: a camera that stands may have one pose for long.

    Args:
        truth: world_from_camera of the images, (n,).
        trained: world_from_camera of the training images as a model remembers them, in float32, (m,).
    """
    if not len(truth) or not len(trained):
        return 0
    count = len(np.intersect1d(_once(truth), _once(trained)))
    return count if count >= _LEAST else 0


def said_of_trained_images(truth: Sequence[Poses | None], trained: Poses) -> str | None:
    """How many images a model was trained on, see `count_trained_images`; None where it is hardly any.

    Args:
        truth: world_from_camera of each image, one pose each; None where unknown.
        trained: world_from_camera of the training images as a model remembers them, in float32, (m,).
    """
    known = [pose for pose in truth if pose is not None]
    count = count_trained_images(Poses.stack(known), trained) if known else 0
    if not count:
        return None
    return (
        f"{count} of {len(truth)} images were trained on: the model remembers images with exactly their true poses, so"
        " errors of these say nothing about new images"
    )


def _once(poses: Poses) -> np.ndarray:
    """The poses in float32, as bytes, but for those that are there twice."""
    numbers = np.concatenate([poses.translation, poses.rotation.reshape(-1, 9)], axis=1).astype(np.float32)
    numbers += 0.0  # -0 is 0
    found, counts = np.unique(numbers.view(f"V{numbers.itemsize * numbers.shape[1]}"), return_counts=True)
    return found[counts == 1]
