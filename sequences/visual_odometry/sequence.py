"""A sequence whose odometry is made from its images, alone or beside what was recorded."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from filtering.errors import counted
from sequences.frame import Camera, Frame
from sequences.frame_source import ChangedSequence, FrameSource
from sequences.options import OdometryOrigin
from sequences.reading.counts import BETWEEN, ImageCounts
from sequences.visual_odometry.frames import VisualFrames
from sequences.visual_odometry.odometry import USUAL_DEPTH_M


class VisualSequence(ChangedSequence):
    """The frames of another sequence, with visual odometry (`VisualFrames`)."""

    def __init__(
        self,
        frames: FrameSource,
        camera: Camera,
        *,
        beside: bool = False,
        most_hz: float = np.inf,
        usual_depth_m: float = USUAL_DEPTH_M,
    ) -> None:
        """Around a sequence.

        Args:
            frames: The sequence.
            camera: Of the images that state none and have its aspect ratio; scaled to their size.
            beside: Whether recorded odometry is used as well: both correct each other (`OdometryFusion`). Otherwise it
                is replaced.
            most_hz: Frames a second that are given at most, on average; the images between them only show how the
                camera moved.
            usual_depth_m: How far away the scene usually is, metres.
        """
        super().__init__(frames)
        self._camera, self._beside, self._most_hz, self._usual_depth_m = camera, beside, most_hz, usual_depth_m
        self._visual = self._begin()

    def _begin(self) -> VisualFrames:
        return VisualFrames(self._camera, beside=self._beside, most_hz=self._most_hz, usual_depth_m=self._usual_depth_m)

    @property
    def odometry_origin(self) -> OdometryOrigin:
        """Visual, or both."""
        return "both" if self._beside else "visual"

    @property
    def odometry_description(self) -> str:
        """Says that it is visual."""
        return f"{self._frames.odometry_description or 'recorded'}, and visual" if self._beside else "visual"

    @property
    def counts(self) -> ImageCounts:
        """Those of the other sequence, less images that only showed the motion."""
        counts = self._frames.counts
        return replace(counts, used=counts.used - self._visual.num_between, skipped=counts.skipped + self._between)

    @property
    def _between(self) -> Counter[str]:
        return +Counter({BETWEEN: self._visual.num_between})

    @property
    def skipped(self) -> Counter[str]:
        """Those of the other sequence, and images that only showed the motion."""
        return self._frames.skipped + self._between

    @property
    def notices(self) -> list[str]:
        """Those of the other sequence, and where the motion was unknown or disputed."""
        notices, visual = [*self._frames.notices], self._visual
        if visual.num_unknown:
            notices.append(f"before {counted(visual.num_unknown, 'image')} the images do not say how the camera moved")
        return [*notices, *visual.disagreement]

    def __iter__(self) -> Iterator[Frame]:
        """Frames in order of time, see the sequence."""
        self._visual = self._begin()
        for frame in self._frames:
            yield from self._visual.take(frame)
        yield from self._visual.finish()
