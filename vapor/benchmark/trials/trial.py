"""A trial: one or two segments of recorded walks."""

from __future__ import annotations

from dataclasses import dataclass

from vapor.benchmark.trials.kinds import Kind


@dataclass(frozen=True)
class Segment:
    """A segment of a recording.

    Attributes:
        seed: Of the recording.
        start: The first image.
        length: The number of images.
        stop: The image of the recording at which its camera stops to stand for `STAND_S`; None if it keeps walking.
    """

    seed: int
    start: int
    length: int
    stop: int | None = None


@dataclass(frozen=True)
class Trial:
    """One run of a benchmark.

    Attributes:
        scene: Name of the scene.
        kind: What happens.
        segments: What the camera sees, one after the other: two if it is carried off, else one.
        stride: Only every so many of the images are seen; odometry between them adds up.
        scale: Factor on all lengths.
    """

    scene: str
    kind: Kind
    segments: tuple[Segment, ...]
    stride: int = 1
    scale: float = 1.0

    @property
    def name(self) -> str:
        """Scene, kind, and seed and first image of every segment."""
        return "-".join([self.scene, self.kind, *(f"{segment.seed}-{segment.start}" for segment in self.segments)])

    @property
    def kidnap_index(self) -> int | None:
        """The first image after the camera was carried off; None if it was not."""
        return self.segments[0].length if len(self.segments) > 1 else None
