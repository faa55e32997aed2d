"""Images whose poses are listed by their names, by the numbers of frames, or by stamps."""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path, PurePosixPath

import numpy as np

from filtering.se3 import Poses
from sequences.datasets.layout import PosedImages
from sequences.datasets.layout_helpers.image_files import find_camera, images_by_number, images_in_first, num_beside
from sequences.datasets.layout_helpers.pose_rows import read_pose_row, stack_poses
from sequences.errors import SequenceError
from sequences.files import Rows, read_rows, require_inside
from sequences.frame import Trajectory
from sequences.trajectories.interpolation import MAX_TRUE_POSE_GAP_S, interpolate
from sequences.values import natural, parse_frame_number

NumberedSequence = tuple[Mapping[int, Path], Mapping[int, Poses | str]]
"""Images, and poses or why there is none, by the numbers of their frames."""


def list_named(
    layout: str,
    folder: Path,
    root: Path,
    world_from_camera: Mapping[str, Poses | str],
    folders: Iterable[Path] = (),
    notices: Sequence[str] = (),
) -> PosedImages:
    """Images in the order of their names, those of one folder as one sequence, without intrinsics yet.

    `world_from_camera` has one pose by the name of each image, relative to `root`, or why it has none. Other images in
    their folders, and in further `folders`, are counted as left out. Raises SequenceError where a name leads out of
    `folder`.
    """
    require_inside(folder, (root / name for name in world_from_camera))
    ordered = sorted(world_from_camera, key=lambda name: (natural(_folder(name)), natural(name)))
    sequences: list[NumberedSequence] = []
    for _, names in groupby(ordered, key=_folder):
        numbered = dict(enumerate(names))
        images = {number: root / name for number, name in numbered.items() if os.path.isfile(root / name)}
        sequences.append((images, {number: world_from_camera[name] for number, name in numbered.items()}))
    skipped = Counter({"image not in the list": num_beside((root / name for name in ordered), folders)})
    return list_numbered(layout, sequences, skipped, notices)


def list_numbered(
    layout: str, sequences: Iterable[NumberedSequence], skipped: Counter[str], notices: Sequence[str] = ()
) -> PosedImages:
    """Images of sequences in the order of their numbers, without intrinsics yet.

    Images without a pose, and poses without an image, are added to `skipped`.
    """
    files: list[Path] = []
    poses: list[Poses] = []
    numbers: list[list[int]] = []
    for images, posed in sequences:
        skipped["no true pose"] += len(images.keys() - posed.keys())
        skipped["no image"] += len(posed.keys() - images.keys())
        numbers.append([])
        for number in sorted(images.keys() & posed.keys()):
            if isinstance(pose := posed[number], str):
                skipped[pose] += 1
                continue
            files.append(images[number])
            poses.append(pose)
            numbers[-1].append(number)
    return PosedImages.numbered(layout, files, stack_poses(poses), numbers, skipped, notices)


def list_stamped(
    layout: str,
    folder: Path,
    listing: Path,
    root: Path,
    read: Callable[[str, str], tuple[int, str]],
    truth: Trajectory,
) -> PosedImages:
    """Images of a list with stamps, the true pose interpolated to each, without intrinsics yet.

    `read` gives stamp, ns, and name, relative to `root`, of a line; it takes the line and the beginning of errors.
    Raises SequenceError as `Rows`, and where a name leads out of `folder`.
    """
    rows, skipped = Rows("images"), Counter[str]()
    times_ns: list[int] = []
    files: list[Path] = []
    listed: list[Path] = []
    for number, line in rows.each(read_rows(listing)):
        row = rows.use(read, line, f"{listing}:{number}")
        if isinstance(row, str):
            skipped[row] += 1
            continue
        time_ns, name = row
        listed.append(root / name)
        if times_ns and time_ns <= times_ns[-1]:
            skipped["time stamp not increasing"] += 1
        elif not os.path.isfile(listed[-1]):
            skipped["no image"] += 1
        else:
            times_ns.append(time_ns)
            files.append(listed[-1])
    require_inside(folder, listed)
    skipped["image not in the list"] += num_beside(listed)
    times = np.array(times_ns, np.int64)
    poses, covered = interpolate(truth.times_ns, truth.poses, times, max_gap_s=MAX_TRUE_POSE_GAP_S)
    kept = np.flatnonzero(covered)
    skipped["no true pose near its time"] += len(times) - len(kept)
    cameras = [None] * len(kept)
    used = [files[i] for i in kept]
    return PosedImages(layout, used, times[kept], poses[kept], cameras, skipped=+skipped, notices=rows.notices)


def _folder(name: str) -> str:
    return str(PurePosixPath(name).parent)


@dataclass(frozen=True)
class NumberedLayout:
    """How one layout of this kind differs from another.

    Attributes:
        name: Its name.
        columns: Names of the columns of a row, `seq frame` first.
        separator: Between columns; None for blanks.
        image_folders: Where in a sequence's folder its images are looked for, before the folder itself.
        levels: How many folders above a sequence `intrinsics.json` is looked for.
    """

    name: str
    columns: str
    separator: str | None
    image_folders: tuple[str, ...]
    levels: int

    def list_images(self, pose_files: Sequence[Path], unposed: Iterable[Path] = ()) -> PosedImages:
        """Images of sequences, each in the folder of its pose file, with camera-to-world poses as they stand.

        Images of `unposed` folders are counted as left out. Raises SequenceError where a file is missing or damaged, or
        a frame is there twice.
        """
        skipped = Counter({"no true pose": sum(len(images_in_first(each, self.image_folders)) for each in unposed)})
        notices: list[str] = []
        sequences: list[NumberedSequence] = []
        for pose_file in pose_files:
            found = images_by_number(pose_file.parent, self.image_folders)
            require_inside(pose_file.parent, found.values())
            sequences.append((found, self._read(pose_file, skipped, notices)))
        images = list_numbered(self.name, sequences, skipped, notices)
        first = pose_files[0].parent.absolute()
        return images.with_camera(find_camera([first, *first.parents[: self.levels]], images.files))

    def _read(self, pose_file: Path, skipped: Counter[str], notices: list[str]) -> dict[int, Poses | str]:
        poses: dict[int, Poses | str] = {}
        lines: dict[int, int] = {}
        sequence: int | None = None
        rows = Rows()
        for line_number, line in rows.each(read_rows(pose_file)):
            where = f"{pose_file}:{line_number}"
            fields = [text.strip() for text in line.split(self.separator)]
            if isinstance(known := rows.use(_sequence_and_frame, fields, where), str):
                skipped[known] += 1
                continue
            found, number = known
            if sequence not in (None, found):
                raise SequenceError(f"{where}: sequence {found} after sequence {sequence}, expected one a file")
            sequence = found
            if number in lines:
                raise SequenceError(f"{where}: frame {number} is on line {lines[number]} too, expected it once")
            lines[number] = line_number
            poses[number] = rows.use(read_pose_row, fields, self.columns, where)
        notices += rows.notices
        return poses


def _sequence_and_frame(fields: Sequence[str], where: str) -> tuple[int, int]:
    if len(fields) < 2:
        raise SequenceError(f"{where}: {len(fields)} columns, expected the numbers of a sequence and a frame first")
    return _whole(fields[0], where), _whole(fields[1], where)


def _whole(text: str, where: str) -> int:
    match = re.fullmatch(r"(\d+)(\.0*)?", text, flags=re.ASCII)
    return parse_frame_number(text if match is None else match[1], where)
