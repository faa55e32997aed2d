"""What a sequence of frames offers, wherever they come from."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from filtering.motion import Odometry
from sequences.frame import Camera, Frame
from sequences.options import OdometryOrigin
from sequences.reading.counts import ImageCounts


@runtime_checkable
class FrameSource(Protocol):
    """Frames in order of time: `SequenceReader`, `ImageSequence`, or a `ChangedSequence` of one of these."""

    @property
    def path(self) -> Path:
        """The file or folder."""
        ...

    @property
    def camera(self) -> Camera | None:
        """Intrinsics of the camera that is localized; None where unknown."""
        ...

    @property
    def num_images(self) -> int:
        """An upper bound of all images, for progress."""
        ...

    @property
    def odometry_origin(self) -> OdometryOrigin | None:
        """What shows the motion between frames; None where nothing does."""
        ...

    @property
    def no_odometry(self) -> str:
        """What was looked for where no odometry is recorded, for users; empty where some is, or none is wanted."""
        ...

    @property
    def image_description(self) -> str | None:
        """What the file says of the images, as `synthetic`; None where it says nothing."""
        ...

    @property
    def odometry_description(self) -> str | None:
        """What the file says of the odometry, likewise."""
        ...

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


class ChangedSequence:
    """The frames of another sequence; a subclass says what is changed, the rest is as of the other."""

    def __init__(self, frames: FrameSource) -> None:
        self._frames = frames

    @property
    def path(self) -> Path:
        """See `FrameSource`."""
        return self._frames.path

    @property
    def camera(self) -> Camera | None:
        """See `FrameSource`."""
        return self._frames.camera

    @property
    def num_images(self) -> int:
        """See `FrameSource`."""
        return self._frames.num_images

    @property
    def odometry_origin(self) -> OdometryOrigin | None:
        """See `FrameSource`."""
        return self._frames.odometry_origin

    @property
    def no_odometry(self) -> str:
        """See `FrameSource`."""
        return self._frames.no_odometry

    @property
    def image_description(self) -> str | None:
        """See `FrameSource`."""
        return self._frames.image_description

    @property
    def odometry_description(self) -> str | None:
        """See `FrameSource`."""
        return self._frames.odometry_description

    @property
    def counts(self) -> ImageCounts:
        """See `FrameSource`."""
        return self._frames.counts

    @property
    def notices(self) -> list[str]:
        """See `FrameSource`."""
        return self._frames.notices

    @property
    def skipped(self) -> Counter[str]:
        """See `FrameSource`."""
        return self._frames.skipped

    @property
    def resolved(self) -> dict[str, Any]:
        """See `FrameSource`."""
        return self._frames.resolved

    def __iter__(self) -> Iterator[Frame]:
        """Frames in order of time."""
        return iter(self._frames)


class RestatedSequence(ChangedSequence):
    """The frames of another sequence, whose odometry gets the noise that was fitted."""

    def __init__(self, frames: FrameSource, restated: Callable[[Odometry], Odometry]) -> None:
        """Around a sequence; `restated` gives odometry with the noise, as `OdometryFit.restated`."""
        super().__init__(frames)
        self._restated = restated

    def __iter__(self) -> Iterator[Frame]:
        """Frames in order of time."""
        for frame in self._frames:
            yield frame if frame.odometry is None else replace(frame, odometry=self._restated(frame.odometry))
