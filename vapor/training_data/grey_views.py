"""Training images in which landmarks are found: grey, larger than a network sees them, in a nameless temporary file."""

from __future__ import annotations

import tempfile
from types import TracebackType

import numpy as np
from jaxtyping import UInt8

from sequences.frame import Camera, Frame
from vapor.cameras import AsTakenBy
from vapor.landmarks.build import VIEW_PX
from vapor.landmarks.verify import grey_view

_USUAL_FOCAL = 0.8  # of the longer edge, where no focal length is stated: about 64° wide


class GreyViews:
    """Takes images one by one; their camera is that of most of them, or a guess by the size of the first.

    Attributes:
        camera: Of the views; None as long as that is not known.
    """

    def __init__(self, camera: Camera | None, *, wanted: bool) -> None:
        """Set up for images of a camera, None where unknown; where they are not wanted, none is kept."""
        self._wanted = wanted
        self.camera = None if camera is None else shrunk(camera)
        self._as_taken: AsTakenBy | None = None
        self._file = tempfile.TemporaryFile() if wanted else None  # noqa: SIM115 - closed on leaving
        self._count = 0

    def __enter__(self) -> GreyViews:
        """Itself."""
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        """Close the file, whose content stays where it is mapped."""
        if self._file is not None:
            self._file.close()

    def take(self, frame: Frame) -> None:
        """Keep an image."""
        if self._file is None:
            return
        if self.camera is None:
            self.camera = shrunk(usual_camera(frame.image.shape[1], frame.image.shape[0]))
        if self._as_taken is None:
            self._as_taken = AsTakenBy(self.camera, (self.camera.width, self.camera.height))
        self._file.write(grey_view(self._as_taken(frame.image, frame.camera), self.camera).data)
        self._count += 1

    def kept(self) -> UInt8[np.ndarray, "m h w"]:
        """All of them, mapped into memory."""
        if self._file is None or self.camera is None:
            return np.zeros((0, 1, 1), np.uint8)
        self._file.flush()
        return np.memmap(self._file, np.uint8, mode="r", shape=(self._count, self.camera.height, self.camera.width))


def usual_camera(width: int, height: int) -> Camera:
    """A guess at the camera of images of so many pixels, of which nothing is stated."""
    focal = _USUAL_FOCAL * max(width, height)
    return Camera(width, height, focal, focal, 0.5 * (width - 1), 0.5 * (height - 1))


def shrunk(camera: Camera) -> Camera:
    """The camera at the size at which landmarks are found."""
    scale = min(1.0, VIEW_PX / max(camera.width, camera.height))
    return camera.scaled(max(1, round(scale * camera.width)), max(1, round(scale * camera.height)))
