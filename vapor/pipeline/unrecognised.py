"""Why images of a run are not recognised: changes that make them look like training images."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final

import cv2
import numpy as np
from jaxtyping import UInt8

from filtering.estimate import Status
from filtering.measurement_noise import OUT_OF_DISTRIBUTION
from sequences.frame import Camera

MOST_IMAGES = 23
"""So many images of a run are enough."""
SeenImage = tuple[UInt8[np.ndarray, "h w 3"], Camera | None]
"""An image and its camera, None where unknown."""
_CLEARLY = 0.8  # of the score of the images as they are: a change that explains it brings it below that
_UNLIKE = 0.9 * OUT_OF_DISTRIBUTION  # images with lower scores look like training images
_VERIFIED = 0.2  # of the changed images, in which landmarks verify a place where the change explains it
_GREY = 2.0  # of 255, between the largest and the smallest channel of a pixel
_MIDDLE = 110  # of 255, a usual median brightness


def _brightened(image: UInt8[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "h w 3"]:
    factor = _MIDDLE / max(float(np.median(image)), 1.0)
    return np.asarray(cv2.convertScaleAbs(image, alpha=factor))


_CHANGES: Final[dict[str, Callable[[np.ndarray], np.ndarray]]] = {
    "red and blue are swapped (BGR that is labelled RGB, or the reverse)": lambda image: image[..., ::-1],
    "turned by 180° (a camera mounted upside down)": lambda image: np.rot90(image, 2),
    "turned by 90° to the left (a camera mounted sideways)": lambda image: np.rot90(image, 1),
    "turned by 90° to the right (a camera mounted sideways)": lambda image: np.rot90(image, -1),
    "mirrored": lambda image: image[:, ::-1],
    "their brightness is inverted": lambda image: 255 - image,
    "brightened (they are dark)": _brightened,
    "darkened (they are overexposed)": _brightened,
}


def are_unrecognised(status: Sequence[Status]) -> bool:
    """Whether images of a run are hardly recognised: fewer than one in ten converged, more than one in four lost."""
    return 10 * status.count("converged") < len(status) < 4 * status.count("lost")


def why_unrecognised(
    images: Sequence[SeenImage],
    ood_score: Callable[[np.ndarray, Camera | None], float],
    is_verified: Callable[[np.ndarray, Camera | None], bool | None] = lambda image, camera: None,
) -> str:
    """Why images of a run are not recognised, as a sentence about them.

    Each change above is tried. The one whose images look most like training images to the network is named if they do
    look like them, clearly more than the images as they are, and if landmarks, where there are any, verify places in
    them. Images of another place look a little less unlike after some change, too.

    Args:
        images: Some images of the run.
        ood_score: How unlike the training an image looks, as `VaporObservationModel.ood_score`.
        is_verified: Whether landmarks verify a place in an image, as `VaporObservationModel.is_verified`.
    """
    grey = np.median([float(np.ptp(image.astype(np.int16), axis=-1).mean()) for image, _ in images]) < _GREY
    now = _score(images, ood_score, np.asarray)
    bright = float(np.median([np.median(image) for image, _ in images])) > _MIDDLE
    possible = {
        name: change for name, change in _CHANGES.items() if not name.startswith("bright" if bright else "dark")
    }
    scores = {name: _score(images, ood_score, change) for name, change in possible.items()}
    best = min(scores, key=scores.__getitem__)
    if scores[best] < min(_CLEARLY * now, _UNLIKE) and _agree(images, is_verified, possible[best]):
        return f"images look like those that the model learned from only when {best}: correct this where they are made"
    if now < _UNLIKE:
        return (
            "images look like those that the model learned from, but where they were taken does not agree with the"
            " odometry, or cannot be distinguished from them: `vapor-track inspect` compares clocks and axes"
        )
    if grey:
        return "images are grey, and look unlike those that the model learned from: record colour if those have it"
    return "images look unlike all that the model learned from: another place, another light, or another camera"


def _score(
    images: Sequence[SeenImage],
    ood_score: Callable[[np.ndarray, Camera | None], float],
    change: Callable[[np.ndarray], np.ndarray],
) -> float:
    """How unlike training images some are after a change; 1 is as unlike as another place."""
    return float(np.median([ood_score(*_changed(seen, change)) for seen in images]))


def _agree(
    images: Sequence[SeenImage],
    is_verified: Callable[[np.ndarray, Camera | None], bool | None],
    change: Callable[[np.ndarray], np.ndarray],
) -> bool:
    """Whether landmarks verify places in some images after a change; True without landmarks."""
    verified = [is_verified(*_changed(seen, change)) for seen in images]
    return None in verified or verified.count(True) >= _VERIFIED * len(verified)


def _changed(
    seen: SeenImage, change: Callable[[np.ndarray], np.ndarray]
) -> tuple[UInt8[np.ndarray, "h2 w2 3"], Camera | None]:
    image, camera = seen
    changed = np.ascontiguousarray(change(image))
    return changed, camera if changed.shape == image.shape else None
