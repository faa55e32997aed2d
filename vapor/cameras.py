"""Images of any pinhole camera -> images as the training camera would have taken them."""

from __future__ import annotations

from collections import Counter

import cv2
import numpy as np
from jaxtyping import Float64, UInt8

from filtering.errors import counted
from sequences.frame import Camera
from sequences.images.undistortion import same_aspect, undistorted
from vapor.images import cover_size

_SAME_PX = 0.5  # of the images that a network sees: too little for a network to notice
_LEAST_FRACTION = 0.8  # of the view, below which there is a notice
_ALLOWANCE = 1.5  # of the OOD score, for an image of which nothing is seen: parts need 0.5 to 1.6 times theirs


class AsTakenBy:
    """Images of any camera, resampled as one camera would have taken them; unchanged where that camera is unknown.

    Parts that the other camera did not see are filled with the colours of its border, which disturbs a network least:
    black looks like objects, and enlarging the image makes everything seem nearer.

    Attributes:
        cameras: Numbers of the images of cameras with another view.
        fraction: Fraction of the view that the latest image shows; 1 where its camera is unknown.
    """

    def __init__(self, camera: Camera | None, frame_size: tuple[int, int]) -> None:
        """Set up for images that will be scaled to cover a frame of this width and height, pixels."""
        self.camera, self.frame_size = camera, frame_size
        self.cameras: Counter[Camera] = Counter()
        self.fraction = 1.0
        self._fractions: dict[Camera, float] = {}
        self._like = None if camera is None else camera.scaled(*cover_size(camera.width, camera.height, *frame_size))
        self._aspects: Counter[tuple[int, int]] = Counter()

    def __call__(self, image: UInt8[np.ndarray, "h w 3"], camera: Camera | None) -> UInt8[np.ndarray, "h2 w2 3"]:
        """An image; where it has to be resampled, it is as large as to just cover the frame.

        Args:
            image: Undistorted.
            camera: The camera that took it, at this or another image size; None where unknown.
        """
        self.fraction = 1.0
        if self._like is None or self.camera is None:
            return image
        _, camera = undistorted(image, camera)
        if camera is None:
            height, width = image.shape[:2]
            if not same_aspect(self.camera, width, height):
                self._aspects[width, height] += 1
            return image
        if same_view(camera, self._like):
            return image
        self.cameras[camera] += 1
        if camera not in self._fractions:
            self._fractions[camera] = fraction_seen(camera, of=self._like)
        self.fraction = self._fractions[camera]
        return resampled(image, camera, self._like)

    @property
    def notices(self) -> list[str]:
        """Warnings and hints on the images so far, each once."""
        if self.camera is None:
            return []
        found = [
            f"{counted(count, 'image')} of {width} x {height} pixels from a camera of unknown intrinsics: their middle"
            f" is used, but the camera learned with is {described(self.camera)}"
            for (width, height), count in self._aspects.items()
        ]
        narrowest = min(self._fractions, key=self._fractions.__getitem__, default=None)
        if narrowest is not None and self._fractions[narrowest] < _LEAST_FRACTION:
            found.append(
                f"the camera ({described(narrowest)}) sees {self._fractions[narrowest]:.0%} of what the camera"
                f" learned with saw ({described(self.camera)}): expect larger errors, and certainty later;"
                " only those of its images that look very unlike the training are taken for ones of another place"
            )
        return found


def ood_allowance(fraction: float) -> float:
    """How much is added to the OOD score of an image at most, as only a fraction of the view is seen."""
    return _ALLOWANCE * (1.0 - fraction)


def described(camera: Camera) -> str:
    """A camera in words: size and horizontal field of view."""
    return f"{camera.width} x {camera.height} pixels, {_degrees(camera):.0f}° wide"


def fraction_seen(camera: Camera, *, of: Camera) -> float:
    """Fraction of the image of the camera `of` that another camera sees."""
    low, high = _corners(camera, of)
    size = np.array([of.width, of.height])
    return float((np.minimum(high, size) - np.maximum(low, 0.0)).clip(0.0).prod() / size.prod())


def resampled(image: UInt8[np.ndarray, "h w 3"], camera: Camera, like: Camera) -> UInt8[np.ndarray, "height width 3"]:
    """The image that another camera would have taken from the same place, looking the same way.

    It has the size of the other camera. Shrinking averages over areas, enlarging interpolates. Parts that the camera
    did not see have the colour of the nearest pixel.
    """
    # Areas of whole pixels first; the rest, less than a pixel, is interpolated.
    size = (
        max(1, round(camera.width * min(1.0, like.fx / camera.fx))),
        max(1, round(camera.height * min(1.0, like.fy / camera.fy))),
    )
    if size != (camera.width, camera.height):
        image, camera = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA)), camera.scaled(*size)
    sx, sy = camera.fx / like.fx, camera.fy / like.fy
    from_like = np.array([[sx, 0.0, camera.cx - sx * like.cx], [0.0, sy, camera.cy - sy * like.cy]])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return np.asarray(
        cv2.warpAffine(image, from_like, (like.width, like.height), flags=flags, borderMode=cv2.BORDER_REPLICATE)
    )


def same_view(camera: Camera, like: Camera) -> bool:
    """Whether both see the same with pixels of the same shape, to within half a pixel of the latter at every edge."""
    low, high = _corners(camera, like)
    if abs(camera.width * like.height - camera.height * like.width) > _SAME_PX * max(camera.width, camera.height):
        return False
    return bool(max(np.abs(low).max(), np.abs(high - (like.width, like.height)).max()) <= _SAME_PX)


def _corners(camera: Camera, of: Camera) -> tuple[Float64[np.ndarray, "2"], Float64[np.ndarray, "2"]]:
    """Upper left and lower right corner of a camera's image, in pixels of another one from its upper left corner."""
    ratio = np.array([of.fx / camera.fx, of.fy / camera.fy])
    low = np.array([of.cx, of.cy]) + 0.5 - ratio * (np.array([camera.cx, camera.cy]) + 0.5)
    return low, low + ratio * (camera.width, camera.height)


def _degrees(camera: Camera) -> float:
    half = (camera.cx + 0.5) / camera.fx, (camera.width - 0.5 - camera.cx) / camera.fx
    return float(np.degrees(np.arctan(half).sum()))
