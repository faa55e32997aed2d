"""7-Scenes: `frame-000000.color.png` with `frame-000000.pose.txt`, a folder a sequence.

A pose is a 4 x 4 camera-to-world matrix. The data set has no time stamps; the rate of its sensor is assumed. A scene
holds `seq-01`, `seq-02` and so on, and `TrainSplit.txt` and `TestSplit.txt`, which name some of them: `sequence1`.
"""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path

from filtering.errors import quoted
from filtering.se3 import Poses
from sequences.datasets.layout import Layout, PosedImages
from sequences.datasets.layout_helpers.image_files import find_camera
from sequences.datasets.layout_helpers.pose_lists import NumberedSequence, list_numbered
from sequences.datasets.layout_helpers.pose_rows import read_pose_matrix
from sequences.errors import SequenceError
from sequences.files import Rows, read_rows, require_inside
from sequences.frame import Camera
from sequences.values import parse_frame_number, parse_numbers

_NAME = "7-Scenes"
_CAMERA = Camera(640, 480, 585.0, 585.0, 320.0, 240.0)


def list_images(path: Path) -> PosedImages | None:
    """Images of a sequence, of a scene, or of the sequences that a split names; None for any other path."""
    sequences = _split(path) if path.name.endswith("Split.txt") and path.is_file() else _sequences(path)
    return _list(sequences) if sequences else None


def _split(path: Path) -> list[Path]:
    """The sequences that a split names, in its order."""
    folders: list[Path] = []
    for number, name in read_rows(path):
        match = re.fullmatch(r"sequence(\d+)", name, flags=re.ASCII)
        where = f"{path}:{number}"
        if match is None:
            raise SequenceError(f"{path}:{number}: {quoted(name)}, expected the name of a sequence, such as sequence1")
        folder = path.parent / f"seq-{parse_frame_number(match[1], where):02d}"
        if folder in folders:
            raise SequenceError(f"{path}:{number}: {name} for the second time, expected it once")
        if not _holds_frames(folder):
            raise SequenceError(f"{path}:{number}: {name}, expected frame-*.pose.txt in {folder}")
        folders.append(folder)
    if not folders:
        raise SequenceError(f"{path}: names no sequence, expected lines such as sequence1")
    return folders


def _sequences(path: Path) -> list[Path]:
    """The folder itself where it holds poses, else its seq-* where one of them does."""
    if _holds_frames(path):
        return [path]
    folders = [folder for folder in sorted(path.glob("seq-*")) if folder.is_dir()] if path.is_dir() else []
    return folders if any(map(_holds_frames, folders)) else []


def _holds_frames(folder: Path) -> bool:
    return folder.is_dir() and next(folder.glob("frame-*.pose.txt"), None) is not None


def _list(folders: list[Path]) -> PosedImages:
    rows = Rows("poses")
    sequences: list[NumberedSequence] = []
    for folder in folders:
        images = {_frame_number(p): p for ext in ("png", "jpg") for p in folder.glob(f"frame-*.color.{ext}")}
        files = {_frame_number(p): p for p in folder.glob("frame-*.pose.txt")}
        require_inside(folder, [*images.values(), *files.values()])
        posed: dict[int, Poses | str] = dict.fromkeys(files, "no image")
        for number in rows.each(sorted(images.keys() & files.keys())):
            posed[number] = rows.use(_read_pose, files[number])
        sequences.append((images, posed))
    listed = list_numbered(_NAME, sequences, Counter(), rows.notices)
    return listed.with_camera(find_camera((folders[0], folders[0].parent), listed.files, _CAMERA))


def _frame_number(path: Path) -> int:
    match = re.match(r"frame-(\d+)\.", path.name)
    if match is None:
        raise SequenceError(f"{path}: expected a name such as frame-000000.color.png")
    return parse_frame_number(match[1], str(path))


def _read_pose(file: Path) -> Poses | str:
    """One pose, or why there is none."""
    rows = [parse_numbers(line.split(), f"{file}:{number}", "a 4 x 4 matrix") for number, line in read_rows(file)]
    return read_pose_matrix(rows, str(file))


LAYOUT = Layout(
    _NAME,
    looked_for="frame-*.pose.txt",
    order=30,
    list_images=list_images,
    list_suffixes=(".txt",),
    splits=("TrainSplit.txt", "TestSplit.txt"),
)
