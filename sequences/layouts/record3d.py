"""Record3D, an app for phones with ARKit: an `.r3d` file, or the folder of its export as EXR and JPG.

An `.r3d` file is a zip archive of `metadata` (JSON) and `rgbd/0.jpg`, `rgbd/1.jpg` and so on; a folder holds the same,
or `metadata.json` and `rgb/0.jpg`. `poses` of the metadata has a row `qx qy qz qw tx ty tz` a frame, the pose
camera-to-world with OpenGL's axes (y up, z backward), by the words of the app's author; metres. The world is the
camera's at the first frame. `perFrameIntrinsicCoeffs` has a row `fx fy cx cy` a frame, of which the medians are taken;
older files have only `K`, column by column. `frameTimestamps` are seconds; without them `fps` gives the stamps.
"""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from filtering.se3 import Poses
from sequences.errors import SequenceError
from sequences.frame import Camera
from sequences.layouts.intrinsics import scaled_to
from sequences.layouts.packed import Archive, ImageFile, PackedImage
from sequences.layouts.pose_rows import NOT_FINITE, from_opengl, read_pose_row, stack_poses
from sequences.layouts.posed_images import PosedImages
from sequences.tum import read_lines

LOOKED_FOR = "a Record3D recording (.r3d, or a folder with metadata and rgbd/ or metadata.json and rgb/)"
_COLUMNS = "qx qy qz qw tx ty tz"
_PLACES = (("metadata", "rgbd"), ("metadata.json", "rgb"), ("metadata.json", "rgbd"), ("metadata", "rgb"))


def list_images(path: Path) -> PosedImages | None:
    """Images of a recording; None where it is of another layout.

    Raises:
        SequenceError: a file is missing or damaged.
    """
    found = _find(path)
    if found is None:
        return None
    where, text, files = found
    try:
        metadata = json.loads(text)
    except ValueError as error:
        raise SequenceError(f"{where}: {error}; expected JSON") from error
    if not isinstance(metadata, dict) or not isinstance(metadata.get("poses"), list):
        raise SequenceError(f"{where}: no list of poses, expected `poses` with a row `{_COLUMNS}` a frame")
    rows = metadata["poses"]
    stamps, assumed_hz = _stamps(metadata, len(rows), where)
    skipped: Counter[str] = Counter({"no true pose": sum(number >= len(rows) for number in files)})
    numbers: list[int] = []
    poses: list[Poses] = []
    for number, row in enumerate(rows):
        pose = _pose(row, f"{where}: poses[{number}]")
        if pose is None:
            skipped[NOT_FINITE] += 1
        elif number not in files:
            skipped["no image"] += 1
        elif numbers and stamps[number] <= stamps[numbers[-1]]:
            skipped["time stamp not increasing"] += 1
        else:
            numbers.append(number)
            poses.append(pose)
    used = [files[number] for number in numbers]
    camera = scaled_to(_camera(metadata, where), used)
    times_ns = np.array([stamps[number] for number in numbers], np.int64)
    return PosedImages(
        "Record3D", used, times_ns, stack_poses(poses), [camera] * len(used), assumed_hz, skipped=+skipped
    )


def _find(path: Path) -> tuple[str, str | bytes, dict[int, ImageFile]] | None:
    """Where the metadata is, its text, and images by the numbers of their frames."""
    files: dict[int, ImageFile] = {}
    if path.suffix == ".r3d" and path.is_file():
        archive = Archive(path)
        for name in archive.names:
            folder, _, file = name.partition("/")
            stem, _, suffix = file.partition(".")
            if folder in ("rgbd", "rgb") and suffix in ("jpg", "png") and stem.isdecimal():
                files[int(stem)] = PackedImage(path, name, archive)
        return f"{path}:metadata", archive.read("metadata"), files
    for metadata, folder in _PLACES:
        if (path / metadata).is_file() and (path / folder).is_dir():
            for file in (path / folder).iterdir():
                if file.suffix in (".jpg", ".png") and file.stem.isdecimal():
                    files[int(file.stem)] = file
            return str(path / metadata), "\n".join(read_lines(path / metadata)), files
    return None


def _pose(row: Any, where: str) -> Poses | None:
    if not isinstance(row, list):
        raise SequenceError(f"{where}: {row!r}, expected a row `{_COLUMNS}`")
    pose = read_pose_row([str(value) for value in row], _COLUMNS, where)
    return None if pose is None else from_opengl(pose)


def _stamps(metadata: dict[str, Any], count: int, where: str) -> tuple[list[int], int | None]:
    """Of each frame, nanoseconds, and the rate they were made up with; None where they were recorded."""
    seconds = metadata.get("frameTimestamps")
    if seconds:
        values = _finite(seconds, f"{where}: frameTimestamps")
        if values.shape != (count,):
            raise SequenceError(f"{where}: {len(values)} frameTimestamps, expected {count} as there are poses")
        return [round(value * 1e9) for value in values.tolist()], None
    fps = _finite(metadata.get("fps"), f"{where}: fps")
    if fps.shape != () or not 0.1 <= fps <= 1000:
        raise SequenceError(f"{where}: fps is {metadata.get('fps')!r}, expected the rate of the images")
    return [round(number * 1e9 / float(fps)) for number in range(count)], round(float(fps))


def _camera(metadata: dict[str, Any], where: str) -> Camera:
    if metadata.get("perFrameIntrinsicCoeffs"):
        coefficients = _finite(metadata["perFrameIntrinsicCoeffs"], f"{where}: perFrameIntrinsicCoeffs")
        if coefficients.ndim != 2 or coefficients.shape[1] != 4:
            raise SequenceError(f"{where}: perFrameIntrinsicCoeffs, expected a row `fx fy cx cy` a frame")
        fx, fy, cx, cy = np.median(coefficients, axis=0).tolist()
    else:
        matrix = _finite(metadata.get("K"), f"{where}: K")
        if matrix.shape != (9,):
            raise SequenceError(f"{where}: K of shape {matrix.shape}, expected the nine numbers of a matrix")
        fx, fy, cx, cy = matrix[[0, 4, 6, 7]].tolist()
    width, height = (_finite(metadata.get(name), f"{where}: {name}") for name in ("w", "h"))
    if width.shape != () or height.shape != () or min(float(width), float(height), fx, fy) <= 0:
        raise SequenceError(f"{where}: w, h or a focal length is not positive, expected those of a camera")
    return Camera(int(width), int(height), fx, fy, cx, cy)


def _finite(values: Any, where: str) -> np.ndarray:
    try:
        array = np.array(values, np.float64)
    except (ValueError, TypeError) as error:
        raise SequenceError(f"{where}: {error}; expected numbers") from error
    if not np.isfinite(array).all():
        raise SequenceError(f"{where} is missing or not finite, expected numbers")
    return array
