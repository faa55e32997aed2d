"""Sequences whose poses are listed by the names of images, or by the numbers of frames."""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path, PurePosixPath

from filtering.se3 import Poses
from sequences.datasets.layout import PosedImages
from sequences.datasets.layout_helpers.image_files import find_camera, images_by_number, images_in_first, num_beside
from sequences.datasets.layout_helpers.pose_rows import read_pose_row, stack_poses
from sequences.errors import SequenceError
from sequences.files import Rows, read_rows, require_inside
from sequences.values import natural, parse_frame_number


def list_named(
    layout: str,
    folder: Path,
    root: Path,
    world_from_camera: Mapping[str, Poses | str],
    folders: Iterable[Path] = (),
    notices: Sequence[str] = (),
) -> PosedImages:
    """Images in the order of their names, those of one folder as one sequence, without intrinsics yet.

    Args:
        layout: Name of the layout.
        folder: Where the data set lies: no name leads out of it.
        root: What the names are relative to.
        world_from_camera: One pose by the name of each image, or why it has none.
        folders: Where other images than these should not be, beside their own folders: they are counted as left out.
        notices: What a person should know of what was left out.

    Raises:
        SequenceError: a name leads out of the folder.
    """
    require_inside(folder, (root / name for name in world_from_camera))
    skipped: Counter[str] = Counter()
    files: list[Path] = []
    poses: list[Poses] = []
    numbers: list[list[int]] = []
    ordered = sorted(world_from_camera, key=lambda name: (natural(_folder(name)), natural(name)))
    for _, names in groupby(ordered, key=_folder):
        numbers.append([])
        for number, name in enumerate(names):
            pose = world_from_camera[name]
            if not os.path.isfile(root / name):
                skipped["no image"] += 1
            elif isinstance(pose, str):
                skipped[pose] += 1
            else:
                files.append(root / name)
                poses.append(pose)
                numbers[-1].append(number)
    skipped["image not in the list"] += num_beside((root / name for name in ordered), folders)
    return PosedImages.numbered(layout, files, stack_poses(poses), numbers, skipped, notices=notices)


def _folder(name: str) -> str:
    return str(PurePosixPath(name).parent)


@dataclass(frozen=True)
class NumberedLayout:
    """How one layout of this kind differs from another.

    Attributes:
        name: What it is called.
        columns: Names of the columns of a row, `seq frame` first.
        separator: What stands between columns; None for blanks.
        image_folders: Where in a sequence's folder its images are looked for, before the folder itself.
        levels: How many folders above a sequence `intrinsics.json` is looked for.
    """

    name: str
    columns: str
    separator: str | None
    image_folders: tuple[str, ...]
    levels: int

    def list_images(self, pose_files: Sequence[Path], unposed: Iterable[Path] = ()) -> PosedImages:
        """Images of sequences, each in the folder of its pose file, camera-to-world poses as they stand.

        Args:
            pose_files: One a sequence, at least one.
            unposed: Folders of sequences without one, if they are any: their images are counted as left out.

        Raises:
            SequenceError: a file is missing or damaged, or a frame is there twice.
        """
        skipped = Counter({"no true pose": sum(len(images_in_first(each, self.image_folders)) for each in unposed)})
        files: list[Path] = []
        poses: list[Poses] = []
        numbers: list[list[int]] = []
        notices: list[str] = []
        for pose_file in pose_files:
            images = images_by_number(pose_file.parent, self.image_folders)
            require_inside(pose_file.parent, images.values())
            posed = self._read(pose_file, skipped, notices)
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
        sequence = pose_files[0].parent.absolute()
        camera = find_camera([sequence, *sequence.parents[: self.levels]], files)
        return PosedImages.numbered(self.name, files, stack_poses(poses), numbers, skipped, camera, notices)

    def _read(self, pose_file: Path, skipped: Counter[str], notices: list[str]) -> dict[int, Poses | str]:
        """Poses, or why there is none, by the number of their frame."""
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
