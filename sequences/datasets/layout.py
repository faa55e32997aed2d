"""The definition of a layout: how a data set of images with true poses lies on disk.

A layout is a module of `sequences.datasets.layouts`, which is found by
itself, with a `Layout` of this name:

    LAYOUT = Layout("My Phone", looked_for="phone_poses.csv", order=110, list_images=list_images)

where `list_images(path)` keeps to these rules:

- It gives None where a path is of another layout. Layouts are asked one after the other, by `order`, and the first that
  does not give None has the path.
- It reads poses, stamps and intrinsics, and gives `PosedImages` in order of time. It decodes no image but the first, to
  learn their size: `posed_frames` decodes, undistorts and counts them.
- Poses are world-from-camera in metres, with OpenCV's axes (x right, y down, z forward). Intrinsics are in pixels, with
  the centre of the first at (0, 0). Stamps are integer nanoseconds and increase; where a layout has none,
  `PosedImages.numbered` makes them up.
- Intrinsics that a layout does not state come from an `intrinsics.json`, in the folder of the images or at most
  `INTRINSICS_LEVELS` folders above.
- An image or a pose that is not used is counted in `skipped` under its reason, in the words of the other layouts. A row
  that is damaged is left out by `sequences.files`, which refuses a file of which more than half is, and `notices`
  name the first. A header, a file that is missing, or rows that contradict each other raise SequenceError, which names
  the file and the line, the value found and the value expected.
- Files are read by `sequences.files`, and their numbers by `sequences.values`, within limits. No name in a file may
  lead out of the folder of the data set: `sequences.files` checks that.

`sequences.datasets.layout_helpers` has what several layouts have in common.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from jaxtyping import Int64

from filtering.se3 import Poses
from sequences.datasets.layout_helpers.packed import ImageFile
from sequences.datasets.points import ReadPoints
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
        notices: Sentences on skipped rows and images.
        read_points: Reads which points of a reconstruction the images show; None where there is none.
        others: Images of other cameras on the same body, by name, and where each is mounted on this one:
            reference_from_camera. `convert` writes them, too.
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
    others: Mapping[str, tuple[PosedImages, Poses]] = field(default_factory=dict)

    @classmethod
    def numbered(
        cls,
        layout: str,
        files: Sequence[ImageFile],
        world_from_camera: Poses,
        numbers: Sequence[Sequence[int]],
        skipped: Counter[str],
        notices: Sequence[str] = (),
    ) -> PosedImages:
        """Images of sequences without time stamps, which are made up at the assumed rate, and without intrinsics yet.

        Files and poses, n of each, are those of one sequence together; `numbers` are the increasing frame numbers of
        each sequence, n in all. Zeros in `skipped` are dropped.
        """
        return cls(
            layout,
            files,
            _assumed_times_ns(numbers),
            world_from_camera,
            [None] * len(files),
            ASSUMED_HZ,
            +skipped,
            np.repeat(np.arange(len(numbers)), [len(some) for some in numbers]),
            notices,
        )

    def __len__(self) -> int:
        return len(self.files)

    def __getitem__(self, index: slice) -> PosedImages:
        return self.select(np.arange(len(self))[index])

    @property
    def has_several(self) -> bool:
        """Whether the images are of several sequences."""
        return self.sequence is not None and len(np.unique(self.sequence)) > 1

    def with_camera(self, camera: Camera | Lens | None) -> PosedImages:
        """The same images, all of one camera."""
        return replace(self, cameras=[camera] * len(self))

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


INTRINSICS_LEVELS = 3
"""Folders above a data set in which layouts look for `intrinsics.json`, at most."""


@dataclass(frozen=True)
class Layout:
    """One layout of data sets.

    Attributes:
        name: Its name, such as "TUM RGB-D".
        looked_for: The file or files that it is recognised by, for messages.
        order: Layouts are asked from the lowest on, and listed so; no two have the same.
        list_images: Images of a data set, none of them read yet; None where a path is of another layout. Raises
            SequenceError where a file is missing or damaged.
        list_suffixes: Of files by which it lists what lies beside them, which are given in place of a folder.
        archive_suffixes: Of files that hold all, likewise.
        video: Name of the video whose images have the poses, where it has one.
        splits: Names of folders and lists in a data set, proposed where the data set itself is given.
    """

    name: str
    looked_for: str
    order: int
    list_images: Callable[[Path], PosedImages | None]
    list_suffixes: tuple[str, ...] = ()
    archive_suffixes: tuple[str, ...] = ()
    video: str = ""
    splits: tuple[str, ...] = ()
