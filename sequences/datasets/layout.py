"""What a layout of data sets is.

A layout says how images with true poses lie on disk. It is a module of `sequences.datasets.layouts`, which is found by
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
  that is damaged is left out by `sequences.files.rows`, which refuses a file of which more than half is, and `notices`
  name the first. A header, a file that is missing, or rows that contradict each other raise SequenceError, which names
  the file and the line, what was found and what was expected.
- Files are read by `sequences.files`, and their numbers by `sequences.values`, within limits. No name in a file may
  lead out of the folder of the data set: `sequences.files.paths` checks that.

`sequences.datasets.layout_helpers` has what several layouts have in common.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from sequences.datasets.posed_images import PosedImages

INTRINSICS_LEVELS = 3
"""Folders above a data set in which layouts look for `intrinsics.json`, at most."""


@dataclass(frozen=True)
class Layout:
    """One layout of data sets.

    Attributes:
        name: What it is called, such as "TUM RGB-D".
        looked_for: The file or files that it is recognised by, for messages.
        order: Layouts are asked from the lowest on, and listed so; no two have the same.
        list_images: Images of a data set, none of them read yet; None where a path is of another layout. Raises
            SequenceError where a file is missing or damaged.
        list_suffixes: Of files by which it lists what lies beside them, which are given in place of a folder.
        archive_suffixes: Of files that hold all, likewise.
        splits: Names of folders and lists in a data set of which one is meant where someone gives the data set.
    """

    name: str
    looked_for: str
    order: int
    list_images: Callable[[Path], PosedImages | None]
    list_suffixes: tuple[str, ...] = ()
    archive_suffixes: tuple[str, ...] = ()
    splits: tuple[str, ...] = ()
