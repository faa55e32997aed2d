"""What every layout is read as: image files with stamps, true poses and intrinsics."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Int64

from filtering.se3 import Poses
from sequences.datasets.layout_helpers.packed import ImageFile
from sequences.datasets.seen_points import ReadPoints
from sequences.frame import ASSUMED_HZ, Camera
from sequences.images.undistortion import Lens


@dataclass(frozen=True)
class PosedImages:
    """Images on disk with their true poses, in order of time.

    Attributes:
        layout: Name of the layout, such as "TUM RGB-D" or "7-Scenes".
        files: Image files, or images in an archive or a video.
        times_ns: Their stamps, strictly increasing.
        world_from_camera: True poses, batch (n,).
        cameras: Intrinsics of each, in pixels of the image, and distortion where it is stated; None where unknown.
        assumed_hz: The rate that stamps were made up with; None where they were recorded.
        skipped: Images and poses left out, by reason.
        sequence: Index of the sequence each image is from, (n,); None where all are from one.
        notices: What a person should know of what was left out.
        read_points: Reads which points of a reconstruction the images show; None where there is none.
    """

    layout: str
    files: Sequence[ImageFile]
    times_ns: Int64[np.ndarray, " n"]
    world_from_camera: Poses
    cameras: Sequence[Camera | Lens | None]
    assumed_hz: int | None = None
    skipped: Counter[str] = field(default_factory=Counter)
    sequence: Int64[np.ndarray, " n"] | None = None
    notices: Sequence[str] = ()
    read_points: ReadPoints | None = None

    @classmethod
    def numbered(
        cls,
        layout: str,
        files: Sequence[ImageFile],
        world_from_camera: Poses,
        numbers: Sequence[Sequence[int]],
        skipped: Counter[str],
        camera: Camera | Lens | None = None,
        notices: Sequence[str] = (),
    ) -> PosedImages:
        """Images of sequences without time stamps, which are made up at the assumed rate.

        Args:
            layout: Name of the layout.
            files: Image files, n of them, those of one sequence together.
            world_from_camera: True poses, batch (n,).
            numbers: Increasing frame numbers of each sequence, n in all.
            skipped: Images and poses left out, by reason; zeros are dropped.
            camera: Intrinsics of all, in pixels of the image; None where unknown.
            notices: What a person should know of what was left out.
        """
        return cls(
            layout,
            files,
            _assumed_times_ns(numbers),
            world_from_camera,
            [camera] * len(files),
            ASSUMED_HZ,
            +skipped,
            np.repeat(np.arange(len(numbers)), [len(some) for some in numbers]),
            notices,
        )

    def __len__(self) -> int:
        return len(self.files)

    def __getitem__(self, index: slice) -> PosedImages:
        return self.select(np.arange(len(self))[index])

    def select(self, indices: Int64[np.ndarray, " k"]) -> PosedImages:
        """Some of the images, (k,), in increasing order."""
        return replace(
            self,
            files=[self.files[i] for i in indices],
            times_ns=self.times_ns[indices],
            world_from_camera=self.world_from_camera[indices],
            cameras=[self.cameras[i] for i in indices],
            sequence=None if self.sequence is None else self.sequence[indices],
        )


def _assumed_times_ns(sequences: Iterable[Sequence[int]]) -> Int64[np.ndarray, " n"]:
    """Stamps for the frame numbers of sequences: at the assumed rate, and a second from sequence to sequence."""
    times_ns: list[int] = []
    begin_ns = 0
    for numbers in sequences:
        times_ns += [begin_ns + number * 1_000_000_000 // ASSUMED_HZ for number in numbers]
        begin_ns = (times_ns[-1] if numbers else begin_ns) + 1_000_000_000
    return np.array(times_ns, np.int64)
