"""Record3D, an app for phones with ARKit: an `.r3d` file, or the folder of its export as EXR and JPG.

An `.r3d` file is a zip archive of `metadata` (JSON) and `rgbd/0.jpg`, `rgbd/1.jpg` and so on; a folder holds the same,
or `metadata.json` and `rgb/0.jpg`. `poses` of the metadata has a row `qx qy qz qw tx ty tz` a frame, the pose
camera-to-world with OpenGL's axes (y up, z backward), as the app's author states; metres. The world is the
camera's at the first frame. `perFrameIntrinsicCoeffs` has a row `fx fy cx cy` a frame, of which the medians are taken;
older files have only `K`, column by column. `frameTimestamps` are seconds; without them `fps` gives the stamps.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from filtering.errors import quoted
from filtering.se3 import Poses
from sequences.datasets.layout import Layout, PosedImages
from sequences.datasets.layout_helpers.image_files import camera_of, scaled_to
from sequences.datasets.layout_helpers.packed import Archive, ImageFile, PackedImage
from sequences.datasets.layout_helpers.pose_rows import from_opengl, read_pose_row, stack_poses
from sequences.errors import SequenceError
from sequences.files import Rows, parse_json, read_json, require_inside
from sequences.frame import Camera
from sequences.values import LARGEST, parse_frame_number, parse_number, parse_time_ns

_NAME = "Record3D"
_COLUMNS = "qx qy qz qw tx ty tz"
_PLACES = (("metadata", "rgbd"), ("metadata.json", "rgb"), ("metadata.json", "rgbd"), ("metadata", "rgb"))


def list_images(path: Path) -> PosedImages | None:
    """Images of a recording; None where it is of another layout."""
    found = _find(path)
    if found is None:
        return None
    where, metadata, files = found
    if not isinstance(metadata, dict) or not isinstance(metadata.get("poses"), list):
        raise SequenceError(f"{where}: no list of poses, expected `poses` with a row `{_COLUMNS}` a frame")
    stated = metadata["poses"]
    stamps, assumed_hz = _stamps(metadata, len(stated), where)
    skipped: Counter[str] = Counter({"no true pose": sum(number >= len(stated) for number in files)})
    numbers: list[int] = []
    poses: list[Poses] = []
    rows = Rows()
    for number, row in rows.each(enumerate(stated)):
        pose = rows.use(_pose, row, f"{where}: poses[{number}]")
        if isinstance(pose, str):
            skipped[pose] += 1
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
    cameras = [camera] * len(used)
    return PosedImages(_NAME, used, times_ns, stack_poses(poses), cameras, assumed_hz, +skipped, notices=rows.notices)


def _find(path: Path) -> tuple[str, Any, dict[int, ImageFile]] | None:
    """Place and content of the metadata, and images by the numbers of their frames."""
    files: dict[int, ImageFile] = {}
    if path.suffix == ".r3d" and path.is_file():
        archive, where = Archive(path), f"{path}:metadata"
        for name in archive.names:
            folder, _, file = name.partition("/")
            stem, _, suffix = file.partition(".")
            if folder in ("rgbd", "rgb") and suffix in ("jpg", "png") and stem.isdecimal():
                files[parse_frame_number(stem, f"{path}:{name}")] = PackedImage(path, name, archive)
        return where, parse_json(archive.read("metadata"), where), files
    for metadata, folder in _PLACES:
        if (path / metadata).is_file() and (path / folder).is_dir():
            for file in (path / folder).iterdir():
                if file.suffix in (".jpg", ".png") and file.stem.isdecimal():
                    files[parse_frame_number(file.stem, str(file))] = file
            require_inside(path, files.values())
            return str(path / metadata), read_json(path / metadata), files
    return None


def _pose(row: Any, where: str) -> Poses | str:
    if not isinstance(row, list):
        raise SequenceError(f"{where}: {quoted(row)}, expected a row `{_COLUMNS}`")
    return from_opengl(read_pose_row([str(value) for value in row], _COLUMNS, where))


def _stamps(metadata: dict[str, Any], count: int, where: str) -> tuple[list[int], int | None]:
    """Of each frame, nanoseconds, and the rate they were made up with; None where they were recorded."""
    seconds = metadata.get("frameTimestamps")
    if seconds:
        values = _finite(seconds, f"{where}: frameTimestamps")
        if values.shape != (count,):
            raise SequenceError(
                f"{where}: frameTimestamps of shape {values.shape}, expected {count} numbers, as there are poses"
            )
        return [parse_time_ns(repr(value), f"{where}: frameTimestamps") for value in values.tolist()], None
    fps = parse_number(metadata.get("fps"), f"{where}: fps", 0.1, 1000)
    return [round(frame * 1e9 / fps) for frame in range(count)], round(fps)


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
    return camera_of(where, (metadata.get("w"), metadata.get("h")), (fx, fy), (cx, cy))


def _finite(values: Any, where: str) -> np.ndarray:
    try:
        array = np.array(values, np.float64)
    except (ValueError, TypeError, OverflowError):
        raise SequenceError(f"{where} is {quoted(values)}, expected numbers") from None
    if not (np.abs(array) <= LARGEST).all():
        raise SequenceError(f"{where} is missing or not finite, expected numbers")
    return array


LAYOUT = Layout(_NAME, looked_for=".r3d", order=80, list_images=list_images, archive_suffixes=(".r3d",))
