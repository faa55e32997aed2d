"""Images of lenses that distort -> images of pinhole cameras."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from math import tan
from typing import Literal

import cv2
import numpy as np
from jaxtyping import Float64, UInt8

from sequences.errors import SequenceError
from sequences.frame import Camera
from sequences.values import LARGEST

DistortionModel = Literal["plumb_bob", "rational_polynomial", "equidistant"]

# How many coefficients each model may have.
_COUNTS: dict[str, tuple[int, ...]] = {
    "plumb_bob": (4, 5, 8, 12, 14),
    "rational_polynomial": (4, 5, 8, 12, 14),
    "equidistant": (4,),
}
_WIDEST = tan(np.pi / 3)  # half of the widest pinhole view, at distance 1: beyond 120° a pinhole image is mostly rim
_ZOOMS = (0.05, 20.0)  # focal length of the pinhole camera over that of the lens
_SAME_ASPECT = 0.02  # within which the sides of an image may differ from those stated: sizes are rounded
_UNTIL = (cv2.TERM_CRITERIA_MAX_ITER | cv2.TERM_CRITERIA_EPS, 50, 1e-9)  # distortion is taken away from points
_INVERTED_PX = 0.1  # so near a ray must come back to the pixel that it is of
_RIM, _ALONG = 16, 24  # points on every edge of an image that are looked at, and on the way to each


@dataclass(frozen=True)
class Lens:
    """A camera whose images are distorted.

    Attributes:
        camera: Image size, and focal lengths and principal point before distortion.
        model: "plumb_bob" and "rational_polynomial" are OpenCV's pinhole model with k1 k2 p1 p2 k3 ..., "equidistant"
            is its fisheye model with k1 to k4.
        coefficients: Distortion coefficients in OpenCV's order.

    Raises SequenceError for an unknown model, a wrong number of coefficients, or one that is not finite or too large.
    """

    camera: Camera
    model: DistortionModel
    coefficients: tuple[float, ...]

    def __post_init__(self) -> None:
        if self.model not in _COUNTS:
            raise SequenceError(f"distortion model {self.model!r}, expected one of {', '.join(_COUNTS)}")
        for number, value in enumerate(self.coefficients, start=1):
            if not abs(value) <= LARGEST:  # NaN compares as false
                raise SequenceError(f"distortion coefficient {number} is {value}, expected finite numbers")
        if len(self.coefficients) not in (counts := _COUNTS[self.model]):
            found, expected = len(self.coefficients), " or ".join(map(str, counts))
            raise SequenceError(f"{found} distortion coefficients of {self.model}, expected {expected}")

    def scaled(self, width: int, height: int) -> Lens:
        """The same lens at another image size."""
        if (width, height) == (self.camera.width, self.camera.height):
            return self
        return replace(self, camera=self.camera.scaled(width, height))


def as_used(camera: Camera | Lens | None, *, undistort: bool) -> Camera | Lens | None:
    """The camera, without its distortion where that is to be left alone."""
    return camera.camera if isinstance(camera, Lens) and not undistort else camera


@lru_cache(maxsize=64)
def pinhole_of(camera: Camera | Lens) -> Camera:
    """The pinhole camera of images after undistortion; a pinhole camera itself.

    It has the size, the principal point and the ratio of focal lengths of the lens, and the widest view that the lens
    fills, but at most 60° to each side. Raises SequenceError where the distortion folds even the middle of the image.
    """
    if not isinstance(camera, Lens):
        return camera
    lens, pinhole = camera, camera.camera
    short, long = _ZOOMS
    if not _sees_all_of(lens, _zoomed(pinhole, long)):
        raise SequenceError(
            f"distortion coefficients {', '.join(f'{c:g}' for c in lens.coefficients)} of {lens.model} fold the image"
            " about its principal point, expected those of a lens"
        )
    while long / short > 1.0005:  # a longer focal length sees a part of the view of a shorter one
        middle = np.sqrt(short * long)
        if _sees_all_of(lens, _zoomed(pinhole, middle)):
            long = middle
        else:
            short = middle
    return _zoomed(pinhole, float(long))


def same_aspect(camera: Camera, width: int, height: int) -> bool:
    """Whether images of a size may be a camera's, scaled."""
    return abs(width * camera.height - height * camera.width) <= _SAME_ASPECT * height * camera.width


def undistorted(
    image: UInt8[np.ndarray, "height width 3"], camera: Camera | Lens | None
) -> tuple[UInt8[np.ndarray, "height width 3"], Camera | None]:
    """The image as a pinhole camera would have taken it, and that camera, see `pinhole_of`.

    The camera is scaled to the image's size. Without one, or with one of another aspect, the image is returned
    unchanged, without a camera.
    """
    if camera is None:
        return image, None
    height, width = image.shape[:2]
    stated = camera.camera if isinstance(camera, Lens) else camera
    if not same_aspect(stated, width, height):
        return image, None
    camera = camera.scaled(width, height)
    if not isinstance(camera, Lens):
        return image, camera
    pinhole = pinhole_of(camera)
    return np.asarray(cv2.remap(image, *_maps(camera), cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)), pinhole


@lru_cache(maxsize=8)
def _maps(lens: Lens) -> tuple[np.ndarray, np.ndarray]:
    """Where each pixel of the pinhole image lies in the lens' image, in fixed-point form, which remaps fastest."""
    size = lens.camera.width, lens.camera.height
    matrix, pinhole = _matrix(lens.camera), _matrix(pinhole_of(lens))
    coefficients = np.array(lens.coefficients, np.float64)
    make = cv2.fisheye.initUndistortRectifyMap if lens.model == "equidistant" else cv2.initUndistortRectifyMap
    first, second = make(matrix, coefficients, np.eye(3), pinhole, size, cv2.CV_16SC2)
    return first, second


def _sees_all_of(lens: Lens, pinhole: Camera) -> bool:
    """Whether every ray of a pinhole camera lies in the lens' image, further out the further it points."""
    edge = np.linspace(-0.5, 0.5, _RIM)
    unit = np.concatenate([np.stack([edge, np.full(_RIM, side)]) for side in (-0.5, 0.5)], axis=1)
    unit = np.concatenate([unit, unit[::-1]], axis=1)
    x = ((unit[0] + 0.5) * pinhole.width - 0.5 - pinhole.cx) / pinhole.fx
    y = ((unit[1] + 0.5) * pinhole.height - 0.5 - pinhole.cy) / pinhole.fy
    if max(np.abs(x).max(), np.abs(y).max()) > _WIDEST:
        return False
    fraction = np.arange(1, _ALONG + 1)[:, None] / _ALONG
    points = _projected(lens, np.stack([fraction * x, fraction * y], axis=-1).reshape(-1, 2)).reshape(_ALONG, -1, 2)
    camera = lens.camera
    outermost = points[-1] + 0.5
    if not ((outermost >= 0.0) & (outermost <= (camera.width, camera.height))).all():
        return False
    offset = (points - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
    return bool((np.diff(np.linalg.norm(offset, axis=-1), axis=0) > 0.0).all())


def rays_of(pixels: Float64[np.ndarray, "n 2"], camera: Camera | Lens) -> Float64[np.ndarray, "n 2"]:
    """The x and y of the rays (x, y, 1) that a camera sees at pixels; NaN where its distortion has no inverse."""
    if not isinstance(camera, Lens):
        return (pixels - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
    if not len(pixels):
        return np.empty((0, 2))
    matrix, coefficients = _matrix(camera.camera), np.array(camera.coefficients, np.float64)
    undo = cv2.fisheye.undistortPoints if camera.model == "equidistant" else cv2.undistortPoints
    rays = np.asarray(undo(pixels[:, None], matrix, coefficients, criteria=_UNTIL), np.float64)[:, 0]
    away = np.linalg.norm(_projected(camera, rays) - pixels, axis=1)
    return np.where((away < _INVERTED_PX)[:, None], rays, np.nan)


def _projected(lens: Lens, rays: Float64[np.ndarray, "n 2"]) -> Float64[np.ndarray, "n 2"]:
    matrix, coefficients = _matrix(lens.camera), np.array(lens.coefficients, np.float64)
    if lens.model == "equidistant":
        return cv2.fisheye.distortPoints(rays[:, None], matrix, coefficients)[:, 0]
    points = np.concatenate([rays, np.ones((len(rays), 1))], axis=1)
    return cv2.projectPoints(points, np.zeros(3), np.zeros(3), matrix, coefficients)[0][:, 0]


def _zoomed(camera: Camera, zoom: float) -> Camera:
    return replace(camera, fx=zoom * camera.fx, fy=zoom * camera.fy)


def _matrix(camera: Camera) -> Float64[np.ndarray, "3 3"]:
    return np.array([[camera.fx, 0.0, camera.cx], [0.0, camera.fy, camera.cy], [0.0, 0.0, 1.0]])
