"""sensor_msgs/CameraInfo -> the camera of the images beside it."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
from jaxtyping import UInt8

from sequences.errors import SequenceError
from sequences.frame import Camera
from sequences.images.undistortion import DistortionModel, Lens, pinhole_of, undistorted
from sequences.recordings.source import MessageSource, Topic
from sequences.recordings.topics import first

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
    """What a recording says of the camera of its images, and the images as a pinhole camera would have taken them.

    Attributes:
        camera: Intrinsics of the images of the stated size, undistorted if so wished; None where unknown.
        notices: What a person should know of that.
    """

    def __init__(self, bag: MessageSource, info: Topic | None, image: Topic, *, undistort: bool = True) -> None:
        """Read the first message of the intrinsics.

        Args:
            bag: The recording.
            info: Topic of the intrinsics, None for none.
            image: Topic of the images: one that ROS calls rectified is taken to be.
            undistort: Whether to undistort; else the stated intrinsics are taken as those of a pinhole camera.

        Raises:
            SequenceError: the message says what no camera has.
        """
        self.notices: list[str] = []
        self.camera: Camera | None = None
        self._lens: Camera | Lens | None = None
        if info is None or not info.num_messages:
            return
        message = first(bag, info)
        try:
            self._lens = self._read(message, rectified=is_rectified(image.name), undistort=undistort)
            self.camera = None if self._lens is None else pinhole_of(self._lens)
        except SequenceError as error:
            raise SequenceError(
                f"{bag.path}: {info.name}: {error} (--no-undistort leaves distortion alone, --camera-info-topic '' all)"
            ) from error

    def _read(self, message: SimpleNamespace, *, rectified: bool, undistort: bool) -> Camera | Lens | None:
        k = [float(value) for value in message.k]
        if not any(k):
            return None  # by ROS' convention an uncalibrated camera
        p = [float(value) for value in message.p] if rectified else []
        fx, fy, cx, cy = (p[0], p[5], p[2], p[6]) if any(p) else (k[0], k[4], k[2], k[5])
        camera = Camera(int(message.width), int(message.height), fx, fy, cx, cy)
        d = tuple(float(value) for value in message.d)
        name = message.distortion_model
        lens: Camera | Lens = camera
        if undistort and any(d) and not rectified:  # NaN counts as true
            if name not in _MODELS:
                self.notices.append(
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
        self, image: UInt8[np.ndarray, "height width 3"]
    ) -> tuple[UInt8[np.ndarray, "height width 3"], Camera | None]:
        """An image of the recording, undistorted, and its camera, as `undistorted` has it."""
        seen, camera = undistorted(image, self._lens)
        if camera is None and self._lens is not None:
            stated = self._lens.camera if isinstance(self._lens, Lens) else self._lens
            notice = (
                f"images are {image.shape[1]} x {image.shape[0]} pixels, but their camera is said to have"
                f" {stated.width} x {stated.height}: what is said of it is not used, and images are not undistorted"
            )
            if notice not in self.notices:
                self.notices.append(notice)
        return seen, camera


def is_rectified(image_topic: str) -> bool:
    """Whether ROS' names say that a topic's images are undistorted already: image_rect, image_rect_color."""
    return any(part.startswith("image_rect") for part in image_topic.split("/"))


def _binned(lens: Camera | Lens, message: SimpleNamespace) -> Camera | Lens:
    """The part of the sensor that was read out, and its pixels added up: intrinsics are stated before that."""
    roi = message.roi
    camera = lens.camera if isinstance(lens, Lens) else lens
    if roi.width and roi.height:
        camera = camera.cropped(roi.x_offset, roi.y_offset, roi.width, roi.height)
    width, height = camera.width // max(message.binning_x, 1), camera.height // max(message.binning_y, 1)
    camera = camera.scaled(width, height)
    return replace(lens, camera=camera) if isinstance(lens, Lens) else camera
