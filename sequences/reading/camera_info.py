"""sensor_msgs/CameraInfo -> the camera of the images beside it."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import UInt8

from sequences.errors import SequenceError
from sequences.frame import Camera
from sequences.images.undistortion import DistortionModel, Lens, pinhole_of, undistorted
from sequences.recordings.messages import stamp_ns
from sequences.recordings.source import MessageSource, Topic, first

_MODELS: dict[str, DistortionModel] = {
    "": "plumb_bob",
    "plumb_bob": "plumb_bob",
    "rational_polynomial": "rational_polynomial",
    "equidistant": "equidistant",
    "fisheye": "equidistant",
    "kannala_brandt": "equidistant",
    "kannala_brandt4": "equidistant",
}


class ImageCamera:
    """The camera of a recording's images, which may zoom or change its mode, and the images as of a pinhole camera.

    Attributes:
        camera: Intrinsics of the first images, of the stated size, undistorted unless declined; None where unknown.
        notices: Sentences for users.
    """

    def __init__(self, bag: MessageSource, info: Topic | None, image: Topic, *, undistort: bool = True) -> None:
        """Read the first message of the intrinsics; None for no topic of them.

        Images whose topic has a name such as image_rect are undistorted already. Without `undistort` the intrinsics are
        taken as those of a pinhole camera. Raises SequenceError where they are impossible.
        """
        self.notices: list[str] = []
        self.camera: Camera | None = None
        self._rectified = any(part.startswith("image_rect") for part in image.name.split("/"))
        self._undistort = undistort
        self._from_ns: list[int] = []  # when each of the lenses came into force
        self._lenses: list[Camera | Lens | None] = []
        if info is None or not info.num_messages:
            return
        message = first(bag, info)
        try:
            self.take(message)
        except SequenceError as error:
            raise SequenceError(
                f"{bag.path}: {info.name}: {error} (--no-undistort leaves distortion alone, --camera-info-topic '' all)"
            ) from error

    def take(self, message: Any) -> None:
        """Take a message of the intrinsics. Raises SequenceError where they are impossible."""
        lens = self._read(message)
        pinhole = None if lens is None else pinhole_of(lens)  # raises where the distortion folds the image
        if not self._lenses:
            self.camera = pinhole
        time_ns = stamp_ns(message.header)
        at = bisect_right(self._from_ns, time_ns)
        if at and self._lenses[at - 1] == lens:
            return
        self._from_ns.insert(at, time_ns)
        self._lenses.insert(at, lens)

    def _read(self, message: Any) -> Camera | Lens | None:
        k = [float(value) for value in message.k]
        if not any(k):
            return None  # by ROS' convention an uncalibrated camera
        p = [float(value) for value in message.p] if self._rectified else []
        fx, fy, cx, cy = (p[0], p[5], p[2], p[6]) if any(p) else (k[0], k[4], k[2], k[5])
        camera = Camera(int(message.width), int(message.height), fx, fy, cx, cy)
        d = tuple(float(value) for value in message.d)
        name = message.distortion_model
        lens: Camera | Lens = camera
        if self._undistort and any(d) and not self._rectified:  # NaN counts as true
            if name not in _MODELS:
                self._notice(
                    f"distortion model {name!r} of the camera is not known, expected one of"
                    f" {', '.join(filter(None, _MODELS))}: images are used as they are, and intrinsics not at all"
                )
                return None
            model = _MODELS[name]
            while model == "equidistant" and len(d) > 4 and d[-1] == 0.0:  # some drivers add a fifth
                d = d[:-1]
            lens = Lens(camera, model, d)
        return _binned(lens, message)

    def seen(
        self, image: UInt8[np.ndarray, "height width 3"], time_ns: int
    ) -> tuple[UInt8[np.ndarray, "height width 3"], Camera | None]:
        """An image, undistorted, and its camera, see `undistorted`; stamps must not decrease from call to call."""
        if before := max(bisect_right(self._from_ns, time_ns) - 1, 0):
            del self._from_ns[:before], self._lenses[:before]
        lens = self._lenses[0] if self._lenses else None
        seen, camera = undistorted(image, lens)
        if camera is None and lens is not None:
            stated = lens.camera if isinstance(lens, Lens) else lens
            self._notice(
                f"images have {image.shape[1]} x {image.shape[0]} pixels, but their camera info states"
                f" {stated.width} x {stated.height}: it is not used, and images are not undistorted"
            )
        return seen, camera

    def _notice(self, notice: str) -> None:
        if notice not in self.notices:
            self.notices.append(notice)


def _binned(lens: Camera | Lens, message: Any) -> Camera | Lens:
    """The lens after cropping to the region of interest and binning, before which intrinsics are stated."""
    roi = message.roi
    camera = lens.camera if isinstance(lens, Lens) else lens
    if roi.width and roi.height:
        camera = camera.cropped(roi.x_offset, roi.y_offset, roi.width, roi.height)
    width, height = camera.width // max(message.binning_x, 1), camera.height // max(message.binning_y, 1)
    camera = camera.scaled(width, height)
    return replace(lens, camera=camera) if isinstance(lens, Lens) else camera
