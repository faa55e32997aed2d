"""Sequences whose poses are rows of a sequence's number, a frame's number and a pose."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from filtering.se3 import Poses
from sequences.datasets.layout_helpers.image_files import images_by_number, images_in_first
from sequences.datasets.layout_helpers.intrinsics import find_camera
from sequences.datasets.layout_helpers.pose_rows import read_pose_row, stack_poses
from sequences.datasets.posed_images import PosedImages
from sequences.errors import SequenceError
from sequences.files.paths import require_inside
from sequences.files.rows import Rows
from sequences.files.text import read_rows
from sequences.values import parse_frame_number


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
