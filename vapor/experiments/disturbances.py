"""What images suffer from: too little light, noise, blur, compression; each a function of a grey image.

`vapor.training.augment` varies what a network is trained on, mildly; these are as strong as recordings have them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType

import cv2
import numpy as np
from jaxtyping import Float32, UInt8

_DARKENED = 1.0 / 3.0
_GAMMA = 2.2
_NOISE = 10.0  # grey levels
_DEFOCUS_PX = 2.0  # radius of the disk that a point becomes
_MOTION_PX = 9  # that a point moves while the shutter is open
_JPEG_QUALITY = 20

Grey = UInt8[np.ndarray, "h w"]
Disturbance = Callable[[Grey, np.random.Generator], Grey]


def _darkened(view: Grey, rng: np.random.Generator) -> Grey:
    """A third of the light, rounded as a camera would."""
    return np.rint(_DARKENED * view).astype(np.uint8)


def _gamma(view: Grey, rng: np.random.Generator) -> Grey:
    """Dark parts darker, with as much contrast at the bright end as before."""
    return np.rint(255.0 * (view / 255.0) ** _GAMMA).astype(np.uint8)


def _noise(view: Grey, rng: np.random.Generator) -> Grey:
    """Independent noise in every pixel."""
    return np.clip(np.rint(view + rng.normal(0.0, _NOISE, view.shape)), 0, 255).astype(np.uint8)


def _defocused(view: Grey, rng: np.random.Generator) -> Grey:
    """Each point a disk."""
    reach = int(np.ceil(_DEFOCUS_PX))
    y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    disk = np.clip(_DEFOCUS_PX + 0.5 - np.hypot(x, y), 0.0, 1.0).astype(np.float32)
    return _filtered(view, disk)


def _moved(view: Grey, rng: np.random.Generator) -> Grey:
    """Each point a line, in a direction drawn for the image."""
    kernel = np.zeros((_MOTION_PX, _MOTION_PX), np.float32)
    middle, angle = (_MOTION_PX - 1) / 2.0, rng.uniform(0.0, np.pi)
    for along in np.linspace(-middle, middle, 8 * _MOTION_PX):
        x, y = middle + along * np.cos(angle), middle + along * np.sin(angle)
        left, top = min(int(x), _MOTION_PX - 2), min(int(y), _MOTION_PX - 2)
        right, down = x - left, y - top
        kernel[top : top + 2, left : left + 2] += np.outer([1.0 - down, down], [1.0 - right, right]).astype(np.float32)
    return _filtered(view, kernel)


def _filtered(view: Grey, kernel: Float32[np.ndarray, "k k"]) -> Grey:
    return np.asarray(cv2.filter2D(view, -1, kernel / kernel.sum(), borderType=cv2.BORDER_REPLICATE))


def _compressed(view: Grey, rng: np.random.Generator) -> Grey:
    """What JPEG leaves of it."""
    _, coded = cv2.imencode(".jpg", view, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    return np.asarray(cv2.imdecode(coded, cv2.IMREAD_GRAYSCALE), np.uint8)


AS_IT_IS = "as it is"

DISTURBANCES: Mapping[str, Disturbance] = MappingProxyType(
    {
        AS_IT_IS: lambda view, rng: view,
        "a third of the light": _darkened,
        f"gamma {_GAMMA:g}": _gamma,
        f"noise {_NOISE:g} of 255": _noise,
        f"defocus {_DEFOCUS_PX:g} px": _defocused,
        f"motion {_MOTION_PX} px": _moved,
        f"JPEG {_JPEG_QUALITY}": _compressed,
    }
)
"""By what is done to the image; what is random is drawn from the generator."""


def disturbed(view: Grey, disturbance: str, image: int) -> Grey:
    """A grey image of 8 bits with one of `DISTURBANCES`, the same whenever it is asked for.

    Args:
        view: The image.
        disturbance: By its name.
        image: Its number, from which what is random is drawn.
    """
    return DISTURBANCES[disturbance](view, np.random.default_rng(image))
