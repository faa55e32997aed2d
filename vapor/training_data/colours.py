"""Whether red and blue of some recordings are swapped, seen beside the others."""

from __future__ import annotations

from collections.abc import Mapping

import cv2
import numpy as np
from jaxtyping import Float64, UInt8

_SIDE_PX, _BINS, _RANGE = 32, 24, 0.4  # of an image; and of each of two differences of colours, over the brightness
_ALIKE, _LESS, _APART = 0.5, 0.6, 0.04  # squared Hellinger distances: at most; swapped, of that before; between both
_BLUISH, _MOST = -0.03, 0.8  # red less blue, over the brightness; and of the images of a recording


class Colours:
    """Which colours a recording has."""

    def __init__(self) -> None:
        self._counts = np.zeros((_BINS, _BINS))
        self._bluish = self._images = 0

    def take(self, image: UInt8[np.ndarray, "h w 3"]) -> None:
        """The next RGB image."""
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
        """Of each colour; red and blue are swapped in its transpose."""
        return self._counts / max(self._counts.sum(), 1.0)

    @property
    def are_bluish(self) -> bool:
        """Whether nearly all images have more blue than red, as lamps, wood and skin make them seldom."""
        return self._bluish > _MOST * self._images


def said_of_colours(recordings: Mapping[str, Colours]) -> list[str]:
    """Which recordings have red and blue swapped, or seem to; nothing where none has.

    Of several, one whose colours are the others' only when swapped; all of them where they are bluish.
    """
    shares = {name: colours.share for name, colours in recordings.items()}
    found = []
    for name, share in shares.items():
        usual = np.mean([other for each, other in shares.items() if each != name] or [share], axis=0)
        now, swapped = _apart(share, usual), _apart(share.T, usual)
        if swapped < _LESS * now and now - swapped > _APART and swapped < _ALIKE:
            found.append(name)
    if not found:
        return [
            f"{_listed(recordings)}: more blue than red in nearly all images, as few places have it: see whether these"
            " are swapped (BGR that is said to be RGB)"
        ] * all(colours.are_bluish for colours in recordings.values())
    if 2 * len(found) >= len(shares):
        return [
            f"{_listed(shares)} do not have the same colours: red and blue of some are swapped (BGR that is said to be"
            " RGB, or the reverse), or their white balance is another"
        ]
    return [
        f"{name}: red and blue are swapped, beside the other recordings (BGR that is said to be RGB, or the reverse),"
        " or its white balance is another"
        for name in found
    ]


def _apart(a: np.ndarray, b: np.ndarray) -> float:
    """Squared Hellinger distance, 0 where alike and 1 where nothing is shared."""
    return 1.0 - float(np.sum(np.sqrt(a * b)))


def _listed(names: Mapping[str, object]) -> str:
    first = list(names)[:3]
    return f"{', '.join(first)}{', ...' if len(names) > len(first) else ''}"
