"""Whether a network can learn anything from images: enough of them, of a camera that moves and sees, near zero."""

from __future__ import annotations

import cv2
import numpy as np

from filtering.se3 import Poses
from vapor.training_data.training_set import TrainingError, TrainingSet

_FAR_M = 1e4  # beyond, float32 has steps of a millimetre
_COARSEST_M = 0.1  # that such a step may have
_STILL_M, _STILL_RAD = 0.005, float(np.deg2rad(0.5))  # of a camera that stands, at most
_COMPARED, _COARSE = 50, (8, 6)  # images, and the size at which they are compared, pixels
_FEW = 100  # images


def require_variety(images: TrainingSet) -> None:
    """Refuse images from which nothing can be learned: of a camera that stands, or sees nothing, or is out of range.

    Raises:
        TrainingError: what all of them have in common.
    """
    poses, few = images.poses, np.linspace(0, len(images) - 1, min(len(images), _COMPARED)).astype(int)
    moved_m, turned = poses.distance(poses[[0]])
    if len(images) > 1 and moved_m.max() < _STILL_M and turned.max() < _STILL_RAD:
        raise TrainingError(
            f"the camera does not move: all {len(images)} true poses are within {1e3 * _STILL_M:g} mm and"
            f" {np.degrees(_STILL_RAD):g}° of the first, expected a walk"
        )
    looks = np.stack(
        [
            cv2.resize(np.asarray(image), _COARSE, interpolation=cv2.INTER_AREA)
            for image in images.images[images.rows[few]]
        ]
    )
    if len(images) > 1 and looks.astype(float).std(axis=0).max() < 1.0:
        raise TrainingError(
            f"all {len(images)} images are alike, to within a level of grey, expected those of a camera that sees where"
            " it is"
        )
    step_m = float(np.spacing(np.float32(np.abs(poses.translation).max())))
    if step_m > _COARSEST_M:
        raise TrainingError(
            f"positions up to {np.abs(poses.translation).max():.3g} m from zero, of which float32 keeps {step_m:.2g} m"
            " only, expected coordinates near zero: --ground-truth-origin takes a point off"
        )


def too_few(images: TrainingSet) -> list[str]:
    """What to say of so few images that hardly any place can be learned from them; nothing where there are enough."""
    if len(images) >= _FEW:
        return []
    return [f"{len(images)} images to learn from: a place takes hundreds, along every path that will be walked"]


def too_far(poses: Poses) -> list[str]:
    """What to say of positions so far from zero that float32 rounds them noticeably; nothing where there are none."""
    furthest_m = float(np.abs(poses.translation).max())
    if furthest_m < _FAR_M:
        return []
    step_m = float(np.spacing(np.float32(furthest_m)))
    return [
        f"positions up to {furthest_m:.3g} m from zero: the network tells them to {step_m:.2g} m only;"
        " --ground-truth-origin takes a point near them off"
    ]
