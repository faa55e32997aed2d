"""What a sequence of frames offers, wherever they come from."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from sequences.frame import Camera, Frame
from sequences.reading.counts import ImageCounts


@runtime_checkable
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
