"""Checks of training images: enough of them, of a camera that moves and sees, near zero, in right colours."""

from __future__ import annotations

from collections.abc import Mapping

import cv2
import numpy as np
from jaxtyping import Float64, UInt8

from filtering.errors import listed
from filtering.se3 import Poses
from vapor.training_data.training_set import TrainingError, TrainingSet

_FAR_M = 1e4  # beyond, float32 has steps of a millimetre
_COARSEST_M = 0.1  # that such a step may have
_STILL_M, _STILL_RAD = 0.005, float(np.deg2rad(0.5))  # of a camera that stands, at most
_COMPARED, _COARSE = 50, (8, 6)  # images, and the size at which they are compared, pixels
_FEW = 100  # images
_NAMED = 3  # recordings
_SIDE_PX, _BINS, _RANGE = 32, 24, 0.4  # of an image; and of each of two differences of colours, over the brightness
_ALIKE, _LESS, _APART = 0.5, 0.6, 0.04  # squared Hellinger distances: at most; swapped, of that before; between both
_BLUISH, _MOST = -0.03, 0.8  # red less blue, over the brightness; and of the images of a recording


def require_variety(images: TrainingSet) -> None:
    """Refuse images from which nothing can be learned.

    Raises:
        TrainingError: the camera does not move, all images are alike, or positions are too far from zero.
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
            f"all {len(images)} images are alike, to within a level of grey, expected images that show where the"
            " camera is"
        )
    step_m = float(np.spacing(np.float32(np.abs(poses.translation).max())))
    if step_m > _COARSEST_M:
        raise TrainingError(
            f"positions up to {np.abs(poses.translation).max():.3g} m from zero, rounded to {step_m:.2g} m in float32,"
            " expected coordinates near zero: --ground-truth-origin takes a point off"
        )


def too_few(images: TrainingSet) -> list[str]:
    """A notice where there are too few images to learn a place from."""
    if len(images) >= _FEW:
        return []
    return [f"{len(images)} images to learn from: a place takes hundreds, along every path that will be walked"]


def too_far(poses: Poses) -> list[str]:
    """A notice on positions so far from zero that float32 rounds them noticeably."""
    furthest_m = float(np.abs(poses.translation).max())
    if furthest_m < _FAR_M:
        return []
    step_m = float(np.spacing(np.float32(furthest_m)))
    return [
        f"positions up to {furthest_m:.3g} m from zero: the network resolves them to {step_m:.2g} m only;"
        " --ground-truth-origin takes a point near them off"
    ]


class Colours:
    """A histogram of the colours of a recording."""

    def __init__(self) -> None:
        self._counts = np.zeros((_BINS, _BINS))
        self._bluish = self._images = 0

    def take(self, image: UInt8[np.ndarray, "h w 3"]) -> None:
        """Add an RGB image."""
        small = np.asarray(cv2.resize(image, (_SIDE_PX, _SIDE_PX), interpolation=cv2.INTER_AREA), np.float64)
        red, green, blue = small.reshape(-1, 3).T
        total = red + green + blue + 1.0
        differences = np.clip(np.stack([red - green, blue - green]) / total, -0.999 * _RANGE, 0.999 * _RANGE)
        at = ((differences + _RANGE) * (_BINS / (2 * _RANGE))).astype(int)
        np.add.at(self._counts, (at[0], at[1]), 1.0)
        self._images += 1
        self._bluish += float((red - blue).mean()) < _BLUISH * float(total.mean()) / 3

    @property
    def share(self) -> Float64[np.ndarray, "bins bins"]:
        """The fraction of each colour; the transpose has red and blue swapped."""
        return self._counts / max(self._counts.sum(), 1.0)

    @property
    def are_bluish(self) -> bool:
        """Whether nearly all images have more blue than red, which lamps, wood and skin seldom give."""
        return self._bluish > _MOST * self._images


def said_of_colours(recordings: Mapping[str, Colours]) -> list[str]:
    """Notices on recordings whose red and blue are swapped, or else seem to be."""
    return said_of_swapped_colours(recordings) or said_of_bluish_colours(recordings)


def said_of_bluish_colours(recordings: Mapping[str, Colours]) -> list[str]:
    """A question where all recordings are bluish."""
    return [
        f"{listed(recordings, _NAMED)}: more blue than red in nearly all images, as few places have it: see whether"
        " these are swapped (BGR that is labelled RGB)"
    ] * all(colours.are_bluish for colours in recordings.values())


def said_of_swapped_colours(recordings: Mapping[str, Colours]) -> list[str]:
    """A notice on recordings whose colours fit the others only when red and blue are swapped."""
    shares = {name: colours.share for name, colours in recordings.items()}
    found = []
    for name, share in shares.items():
        usual = np.mean([other for each, other in shares.items() if each != name] or [share], axis=0)
        now, swapped = _apart(share, usual), _apart(share.T, usual)
        if swapped < _LESS * now and now - swapped > _APART and swapped < _ALIKE:
            found.append(name)
    if not found:
        return []
    names, some = (shares, " in some of these recordings") if 2 * len(found) >= len(shares) else (found, "")
    return [
        f"{listed(names, _NAMED)}: red and blue are swapped{some}, beside the other recordings (BGR that is labelled"
        " RGB, or the reverse), or their white balance differs"
    ]


def _apart(a: np.ndarray, b: np.ndarray) -> float:
    """Squared Hellinger distance, 0 where alike and 1 where nothing is shared."""
    return 1.0 - float(np.sum(np.sqrt(a * b)))
