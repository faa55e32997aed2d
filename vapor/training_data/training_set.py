"""Images with true poses that networks learn from, small and in memory only as far as they are used."""

from __future__ import annotations

import mmap
from collections import Counter
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Bool, Float32, Int64, UInt8

from filtering.errors import VaporTrackError
from filtering.motion import Odometry
from filtering.se3 import Poses
from sequences.datasets.points import SeenPoints
from sequences.frame import Camera


class TrainingError(VaporTrackError):
    """A network cannot be trained on this data, or with this configuration."""


@dataclass
class SeenImages:
    """What a backbone that never learns makes of m images, as far as it was shown them.

    Attributes:
        backbone: Checksum of its weights, and of the size of the crops that it was shown.
        shown: Mask of the images that it was shown, (m,).
        numbers: Its numbers of each of these, (m, f).
        descriptions: Description of each of these, (m, d).
    """

    backbone: int | None = None
    shown: Bool[np.ndarray, " m"] = field(default_factory=lambda: np.zeros(0, bool))
    numbers: Float32[np.ndarray, "m f"] = field(default_factory=lambda: np.zeros((0, 0), np.float32))
    descriptions: Float32[np.ndarray, "m d"] = field(default_factory=lambda: np.zeros((0, 0), np.float32))


@dataclass(frozen=True)
class TrainingSet:
    """n scaled images with their poses, a selection of the m images that were read.

    Attributes:
        images: All m images that were read, RGB of one size, memory-mapped.
        rows: Index in `images` of each selected image, (n,).
        poses: world_from_camera, batch (n,).
        sequence: Index of the sequence of each image; images of one sequence lie together, in its order.
        names: File or folder of each sequence, by that index.
        camera_size: Width and height of the camera's images, pixels; of the first image where no camera is known.
        times_ns: Stamps of the images, integer nanoseconds, (n,).
        odometry: Motion since the previous image of the recording; None where unknown or not selected.
        skipped: Number of images and poses that were skipped in reading, by reason.
        notices: Facts about the data for the user.
        camera: The camera that took the images, or to which they were resampled; None where unknown.
        views: The m images, grey and larger, for landmarks, memory-mapped; empty if not requested.
        view_camera: The stated camera of `views`; where none is stated, with a guessed focal length.
        seen_points: Points of a reconstruction that each of the m images shows; empty without a reconstruction.
        walks: Number of the walk of each sequence, by its index: several cameras record one walk, each a sequence of
            its own. Empty where each sequence is a walk.
        cameras: Names of the cameras of recordings; empty where none is known.
        numbers: Number of each image in its file or folder, by which `PATH@START:STOP` counts, (n,); None where they
            are not counted.
        seen: What a backbone that never learns makes of the m images; one for all selections.
    """

    images: UInt8[np.ndarray, "m h w 3"]
    rows: Int64[np.ndarray, " n"]
    poses: Poses
    sequence: Int64[np.ndarray, " n"]
    names: tuple[str, ...]
    camera_size: tuple[int, int]
    times_ns: Int64[np.ndarray, " n"]
    odometry: tuple[Odometry | None, ...]
    skipped: Counter[str] = field(default_factory=Counter)
    notices: tuple[str, ...] = ()
    camera: Camera | None = None
    views: UInt8[np.ndarray, "v h2 w2"] = field(default_factory=lambda: np.zeros((0, 1, 1), np.uint8))
    view_camera: Camera | None = None
    seen_points: tuple[SeenPoints | None, ...] = ()
    walks: tuple[int, ...] = ()
    cameras: tuple[str, ...] = ()
    numbers: Int64[np.ndarray, " n"] | None = None
    seen: SeenImages = field(default_factory=SeenImages, compare=False, repr=False)

    def __len__(self) -> int:
        return len(self.sequence)

    @property
    def walk(self) -> Int64[np.ndarray, " n"]:
        """Number of the walk of each image, (n,)."""
        return np.array(self.walks, np.int64)[self.sequence] if self.walks else self.sequence

    @property
    def number(self) -> Int64[np.ndarray, " n"]:
        """`numbers`; where there are none, each image's number in its sequence, (n,)."""
        if self.numbers is not None:
            return self.numbers
        begins = np.searchsorted(self.sequence, self.sequence)
        return np.arange(len(self)) - begins

    def unload(self) -> None:
        """Free the memory of images read from disk; they are read again when they are used."""
        for mapped in (self.images, self.views):
            if isinstance(mapped.base, mmap.mmap) and hasattr(mmap, "MADV_DONTNEED"):
                mapped.base.madvise(mmap.MADV_DONTNEED)

    def select(self, indices: Int64[np.ndarray, " k"]) -> TrainingSet:
        """The images with these indices, (k,), in increasing order, without copying any."""
        follows = np.diff(indices, prepend=-2) == 1
        return replace(
            self,
            rows=self.rows[indices],
            poses=self.poses[indices],
            sequence=self.sequence[indices],
            times_ns=self.times_ns[indices],
            numbers=None if self.numbers is None else self.numbers[indices],
            odometry=tuple(self.odometry[i] if after else None for i, after in zip(indices, follows, strict=True)),
        )
