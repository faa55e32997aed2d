"""Images in the places where they were taken, as Rerun shows them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from filtering.se3 import Poses
from sequences.frame import Frame
from vapor.reporting.rerun_shapes import as_jpeg, pinhole, stand_in_camera

if TYPE_CHECKING:
    import rerun as rr

_MOST = 150  # of one recording: Rerun keeps each apart, and of more in one place all are selected
_SMALL_SIDE = 240  # pixels


@dataclass(frozen=True)
class Photograph:
    """An image, and how it was projected.

    Attributes:
        jpeg: The image.
        width: Of it, pixels.
        height: Of it, pixels.
        image_from_camera: Rows of the matrix of intrinsics, in pixels of this size.
    """

    jpeg: bytes
    width: int
    height: int
    image_from_camera: list[list[float]]

    @staticmethod
    def of(frame: Frame, longest_side: int = 480) -> Photograph:
        """The image of a frame, with its longer side at most so many pixels."""
        jpeg, width, height = as_jpeg(frame.image, longest_side)
        camera = frame.camera or stand_in_camera(frame.image)
        return Photograph(jpeg, width, height, pinhole(camera, width, height))

    def log(
        self, stream: rr.RecordingStream, entity: str, pose: Poses, *, color: tuple[int, int, int], size_m: float
    ) -> None:
        """Show it where it was taken.

        Args:
            stream: Where to.
            entity: Its path.
            pose: world_from_camera, one pose.
            color: Of the camera.
            size_m: How far in front of the camera the image is.
        """
        import rerun as rr

        camera = rr.Pinhole(
            image_from_camera=self.image_from_camera,
            resolution=[self.width, self.height],
            image_plane_distance=size_m,
            color=color,
        )
        stream.log(entity, rr.Transform3D(translation=pose.translation, mat3x3=pose.rotation), static=True)
        stream.log(entity, camera, static=True)
        stream.log(entity, rr.EncodedImage(contents=self.jpeg, media_type="image/jpeg"), static=True)


class Photographs:
    """Images of frames with a true pose, small, and evenly spaced where there are more than 150."""

    def __init__(self) -> None:
        self._every, self._seen = 1, 0
        self.of_frame: dict[int, Photograph] = {}
        """By the number of the frame among those with a true pose."""

    def take(self, frame: Frame) -> None:
        """Take the next frame."""
        if frame.world_from_camera is None:
            return
        if self._seen % self._every == 0:
            self.of_frame[self._seen] = Photograph.of(frame, _SMALL_SIDE)
        self._seen += 1
        if len(self.of_frame) > _MOST:
            self._every *= 2
            self.of_frame = {number: each for number, each in self.of_frame.items() if number % self._every == 0}
