"""7-Scenes: `frame-000000.color.png` with `frame-000000.pose.txt`, a folder a sequence.

A pose is a 4 x 4 camera-to-world matrix. The data set has no time stamps; the rate of its sensor is assumed. A scene
holds `seq-01`, `seq-02` and so on, and `TrainSplit.txt` and `TestSplit.txt`, which name some of them: `sequence1`.
"""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path

import numpy as np

from filtering.se3 import Poses
from sequences.errors import SequenceError
from sequences.frame import Camera
from sequences.layouts.intrinsics import find_camera
from sequences.layouts.pose_rows import NOT_FINITE
from sequences.layouts.posed_images import PosedImages
from sequences.tum import read_lines

LOOKED_FOR = (
    "a 7-Scenes sequence folder (frame-*.color.png or .jpg with frame-*.pose.txt), a folder of such seq-*"
    " or its TrainSplit.txt or TestSplit.txt"
)
_CAMERA = Camera(640, 480, 585.0, 585.0, 320.0, 240.0)


def list_images(path: Path) -> PosedImages | None:
    """Images of a sequence, of all sequences of a scene, or of those that a split names; None where it is none of them.

    Raises:
        SequenceError: a file is missing or damaged, or a split names a sequence that is not there, or names it twice.
    """
    sequences = _split(path) if path.name.endswith("Split.txt") and path.is_file() else _sequences(path)
    return _list(sequences) if sequences else None


def _split(path: Path) -> list[Path]:
    """The sequences that a split names, in its order."""
    folders: list[Path] = []
    for number, line in enumerate(read_lines(path), start=1):
        name = line.strip()
        if not name or name.startswith("#"):
            continue
        match = re.fullmatch(r"sequence(\d+)", name, flags=re.ASCII)
        if match is None:
            raise SequenceError(f"{path}:{number}: {name!r}, expected the name of a sequence, such as sequence1")
        folder = path.parent / f"seq-{int(match[1]):02d}"
        if folder in folders:
            raise SequenceError(f"{path}:{number}: {name} for the second time, expected it once")
        if not _holds_frames(folder):
            raise SequenceError(f"{path}:{number}: {name}, expected frame-*.pose.txt in {folder}")
        folders.append(folder)
    if not folders:
        raise SequenceError(f"{path}: names no sequence, expected lines such as sequence1")
    return folders


def _sequences(path: Path) -> list[Path]:
    """The folder itself where it holds frames, else its seq-* that do."""
    if _holds_frames(path):
        return [path]
    return [folder for folder in sorted(path.glob("seq-*")) if _holds_frames(folder)] if path.is_dir() else []


def _holds_frames(folder: Path) -> bool:
    return folder.is_dir() and next(folder.glob("frame-*.pose.txt"), None) is not None


def _list(sequences: list[Path]) -> PosedImages:
    skipped: Counter[str] = Counter()
    files: list[Path] = []
    matrices: list[np.ndarray] = []
    numbers: list[list[int]] = []
    for folder in sequences:
        images = {_frame_number(p): p for ext in ("png", "jpg") for p in folder.glob(f"frame-*.color.{ext}")}
        poses = {_frame_number(p): p for p in folder.glob("frame-*.pose.txt")}
        skipped["no true pose"] += len(images.keys() - poses.keys())
        skipped["no image"] += len(poses.keys() - images.keys())
        numbers.append([])
        for number in sorted(images.keys() & poses.keys()):
            matrix = _read_matrix(poses[number])
            if matrix is None:
                skipped[NOT_FINITE] += 1
                continue
            files.append(images[number])
            matrices.append(matrix)
            numbers[-1].append(number)
    camera = find_camera((sequences[0], sequences[0].parent), files, _CAMERA)
    poses = Poses.from_matrix(np.array(matrices).reshape(-1, 4, 4))
    return PosedImages.numbered("7-Scenes", files, poses, numbers, skipped, camera)


def _frame_number(path: Path) -> int:
    match = re.match(r"frame-(\d+)\.", path.name)
    if match is None:
        raise SequenceError(f"{path}: expected a name such as frame-000000.color.png")
    return int(match[1])


def _read_matrix(file: Path) -> np.ndarray | None:
    """A 4 x 4 camera-to-world matrix, its rotation made exact; None where it is not finite."""
    try:
        matrix = np.array([[float(value) for value in line.split()] for line in read_lines(file) if line.strip()])
    except ValueError as error:
        raise SequenceError(f"{file}: {error}; expected a 4 x 4 matrix of numbers") from error
    if matrix.shape != (4, 4):
        raise SequenceError(f"{file}: shape {matrix.shape}, expected a 4 x 4 matrix")
    if not np.isfinite(matrix).all():
        return None
    u, _, vt = np.linalg.svd(matrix[:3, :3])
    if np.abs(u @ vt - matrix[:3, :3]).max() > 1e-2 or np.linalg.det(u @ vt) < 0:
        raise SequenceError(f"{file}: the upper left 3 x 3 is no rotation, expected a camera-to-world matrix")
    if np.abs(matrix[3] - (0, 0, 0, 1)).max() > 1e-3:
        raise SequenceError(f"{file}: last row {matrix[3].tolist()}, expected 0 0 0 1 of a camera-to-world matrix")
    matrix[:3, :3] = u @ vt
    return matrix
