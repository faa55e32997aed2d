"""Why images of a run are not recognised: changes that make them look like the images the model learned from."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final

import cv2
import numpy as np
from jaxtyping import UInt8

from filtering.error_model import FOREIGN
from filtering.estimate import Status
from sequences.frame import Camera

_KEPT = 12  # images
_CLEARLY = 0.8  # of the score of the images as they are: a change that brings it below that explains it
_UNLIKE = 0.9 * FOREIGN
_GREY = 2.0  # of 255, between the largest and the smallest channel of a pixel
_MIDDLE = 110  # of 255, a usual median brightness


class SomeImages:
    """A few images spread evenly over a sequence of unknown length.

    Attributes:
        images: Those kept, with their cameras, in order.
    """

    def __init__(self) -> None:
        self.images: list[tuple[UInt8[np.ndarray, "h w 3"], Camera | None]] = []
        self._every, self._number = 1, 0

    def add(self, image: UInt8[np.ndarray, "h w 3"], camera: Camera | None) -> None:
        """The next image of the sequence."""
        if self._number % self._every == 0:
            self.images.append((image, camera))
        self._number += 1
        if len(self.images) == 2 * _KEPT:
            self.images, self._every = self.images[::2], 2 * self._every


def _brightened(image: UInt8[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "h w 3"]:
    factor = _MIDDLE / max(float(np.median(image)), 1.0)
    return np.asarray(cv2.convertScaleAbs(image, alpha=factor))


_CHANGES: Final[dict[str, Callable[[np.ndarray], np.ndarray]]] = {
    "with red and blue swapped (BGR that is labelled RGB, or the reverse)": lambda image: image[..., ::-1],
    "turned by 180° (a camera mounted upside down)": lambda image: np.rot90(image, 2),
    "turned by 90° to the left (a camera mounted sideways)": lambda image: np.rot90(image, 1),
    "turned by 90° to the right (a camera mounted sideways)": lambda image: np.rot90(image, -1),
    "mirrored": lambda image: image[:, ::-1],
    "with brightness inverted": lambda image: 255 - image,
    "brightened (they are dark)": _brightened,
    "darkened (they are overexposed)": _brightened,
}


def are_unrecognised(status: Sequence[Status]) -> bool:
    """Whether images of a run are hardly recognised: fewer than one in ten converged, more than one in four lost."""
    return 10 * status.count("converged") < len(status) < 4 * status.count("lost")


def why_unrecognised(some: SomeImages, unfamiliarity: Callable[[np.ndarray, Camera | None], float]) -> str:
    """What explains that images of a run are not recognised, as a sentence about them.

    Each change above is tried: the one whose images look most like training images to the network is named where the
    images as they are do not.

    Args:
        some: Images of the run.
        unfamiliarity: How unlike training images an image is, such as `VaporObservationModel.unfamiliarity`.
    """
    images = some.images
    grey = np.median([float(np.ptp(image.astype(np.int16), axis=-1).mean()) for image, _ in images]) < _GREY
    now = _score(images, unfamiliarity, lambda image: image)
    bright = float(np.median([np.median(image) for image, _ in images])) > _MIDDLE
    possible = {
        name: change for name, change in _CHANGES.items() if not name.startswith("bright" if bright else "dark")
    }
    scores = {name: _score(images, unfamiliarity, change) for name, change in possible.items()}
    best = min(scores, key=scores.__getitem__)
    if scores[best] < _CLEARLY * now:
        return f"images look like those that the model learned from only when {best}: correct this where they are made"
    if now < _UNLIKE:
        return (
            "images look like those that the model learned from, but where they were taken does not agree with the"
            " odometry, or is not told by them: `vapor-track inspect` compares clocks and axes"
        )
    if grey:
        return "images are grey, and look unlike those that the model learned from: record colour if those have it"
    return "images look unlike all that the model learned from: another place, another light, or another camera"


def _score(
    images: list[tuple[UInt8[np.ndarray, "h w 3"], Camera | None]],
    unfamiliarity: Callable[[np.ndarray, Camera | None], float],
    change: Callable[[np.ndarray], np.ndarray],
) -> float:
    """How unlike training images some are after a change; 1 is as unlike as another place."""
    scores = []
    for image, camera in images:
        changed = np.ascontiguousarray(change(image))
        same_size = camera is None or changed.shape == image.shape
        scores.append(unfamiliarity(changed, camera if same_size else None))
    return float(np.median(scores))
