"""A sequence whose odometry is made from its images, alone or beside what was recorded."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol

from sequences.frame import Camera, Frame
from sequences.reading.counts import ImageCounts
from sequences.visual_odometry.fusion import OdometryFusion
from sequences.visual_odometry.odometry import VisualOdometry


class FrameSource(Protocol):
    """Frames in order of time: `SequenceReader`, `ImageSequence`, or one of these with visual odometry."""

    path: Path
    camera: Camera | None
    num_images: int
    has_odometry: bool
    image_description: str | None
    odometry_description: str | None

    @property
    def counts(self) -> ImageCounts:
        """Counts of the images of the latest iteration; complete after it."""
        ...

    @property
    def notices(self) -> list[str]:
        """Sentences for users; complete after an iteration."""
        ...

    @property
    def skipped(self) -> Counter[str]:
        """How many images of the latest iteration were left out, by reason."""
        ...

    @property
    def resolved(self) -> dict[str, Any]:
        """The options that would read the same."""
        ...

    def __iter__(self) -> Iterator[Frame]: ...


class VisualSequence:
    """The frames of another sequence, with visual odometry.

    Attributes: those of the other sequence, but for

        has_odometry: True.
        odometry_description: Says that it is visual.
    """

    has_odometry = True

    def __init__(self, frames: FrameSource, camera: Camera, *, beside: bool = False) -> None:
        """Around a sequence.

        Args:
            frames: The sequence.
            camera: Of the images that state none; scaled to their size.
            beside: Whether recorded odometry is used as well: both correct each other (`OdometryFusion`). Otherwise it
                is replaced.
        """
        self._frames, self._camera, self._beside = frames, camera, beside
        self.path, self.camera, self.num_images = frames.path, frames.camera, frames.num_images
        self.image_description = frames.image_description
        recorded = frames.odometry_description or "recorded"
        self.odometry_description: str | None = f"{recorded}, and visual" if beside else "visual"
        self._num_unknown = 0

    @property
    def counts(self) -> ImageCounts:
        """Counts of the images of the latest iteration; complete after it."""
        return self._frames.counts

    @property
    def skipped(self) -> Counter[str]:
        """How many images of the latest iteration were left out, by reason."""
        return self._frames.skipped

    @property
    def resolved(self) -> dict[str, Any]:
        """The options that would read the same."""
        return self._frames.resolved

    @property
    def notices(self) -> list[str]:
        """Sentences for users; complete after an iteration."""
        if not self._num_unknown:
            return self._frames.notices
        unknown = (
            f"before {self._num_unknown} images the images do not say how the camera moved: visual odometry lost it"
        )
        return [*self._frames.notices, unknown]

    def __iter__(self) -> Iterator[Frame]:
        """Frames in order of time, see the sequence."""
        self._num_unknown = 0
        visual: VisualOdometry | None = None
        fusion = OdometryFusion() if self._beside else None
        for number, frame in enumerate(self._frames):
            height, width = frame.image.shape[:2]
            camera = frame.camera or self._camera.scaled(width, height)
            visual = visual or VisualOdometry(camera)
            odometry = visual.step(frame.image, frame.time_ns, camera)
            self._num_unknown += number > 0 and odometry is None
            if fusion is not None:
                odometry = fusion.step(frame.odometry, odometry)
            yield replace(frame, odometry=odometry)
