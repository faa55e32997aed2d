"""Stray Scanner, an app for phones with ARKit: `odometry.csv`, `camera_matrix.csv` and `rgb.mp4`, a folder a recording.

A row of `odometry.csv` is `timestamp, frame, x, y, z, qx, qy, qz, qw`: seconds since the phone was started, the number
of the frame of the video, and the pose camera-to-world. The app turns ARKit's axes (y up, z backward) into OpenCV's
before it writes them, as its source shows and its author states, so they are taken as they are. `rgb/000000.jpg` (or
.png) and so on are taken for the video where there are such files. `camera_matrix.csv` is a 3 x 3 matrix in pixels of
the video; of columns fx, fy, cx and cy of the rows, where there are any, the medians are taken for it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from filtering.errors import quoted
from filtering.se3 import Poses
from sequences.datasets.layout import Layout, PosedImages
from sequences.datasets.layout_helpers.image_files import images_by_number, images_in, size_of_first
from sequences.datasets.layout_helpers.packed import ImageFile, VideoFile
from sequences.datasets.layout_helpers.pose_rows import read_pose_row, stack_poses
from sequences.errors import SequenceError
from sequences.files import Rows, read_rows, require_inside
from sequences.frame import Camera
from sequences.values import parse_frame_number, parse_numbers, parse_time_ns

_NAME, _VIDEO = "Stray Scanner", "rgb.mp4"
_COLUMNS = ["timestamp", "frame", "x", "y", "z", "qx", "qy", "qz", "qw"]
_POSITION = {"x": "tx", "y": "ty", "z": "tz"}
_FOCAL = ["fx", "fy", "cx", "cy"]


def list_images(path: Path) -> PosedImages | None:
    """Images of a recording; None where it is of another layout."""
    if not ((path / "odometry.csv").is_file() and (path / "camera_matrix.csv").is_file()):
        return None
    skipped: Counter[str] = Counter()
    times_ns: list[int] = []
    numbers: list[int] = []
    poses: list[Poses] = []
    focal: list[list[float]] = []
    frames = _Frames(path)
    seen: dict[int, str] = {}
    names, lines = _table(path / "odometry.csv")
    columns = " ".join(_POSITION.get(name, name) for name in names)
    rows = Rows()
    for line_number, line in rows.each(lines):
        where, fields = f"{path / 'odometry.csv'}:{line_number}", [field.strip() for field in line.split(",")]
        row = rows.use(_read_row, names, fields, where)
        if isinstance(row, str):
            skipped[row] += 1
            continue
        number, found_ns, focal_of_row = row
        if number in seen:
            raise SequenceError(f"{where}: frame {number} is on {seen[number]} too, expected it once")
        seen[number] = f"line {line_number}"
        pose = rows.use(read_pose_row, fields, columns, where)
        if times_ns and (found_ns <= times_ns[-1] or number <= numbers[-1]):
            skipped["time stamp not increasing"] += 1
        elif isinstance(pose, str):
            skipped[pose] += 1
        elif number not in frames:
            skipped["no image"] += 1
        else:
            times_ns.append(found_ns)
            numbers.append(number)
            poses.append(pose)
            focal += [focal_of_row] if focal_of_row else []
    skipped["no true pose"] += frames.num_beside(seen)
    files = [frames[number] for number in numbers]
    camera = _camera(path / "camera_matrix.csv", files, focal, frames.size)
    times = np.array(times_ns, np.int64)
    cameras = [camera] * len(files)
    return PosedImages(_NAME, files, times, stack_poses(poses), cameras, skipped=+skipped, notices=rows.notices)


class _Frames:
    """Images by the numbers of their frames: files of a folder, or those of a video."""

    def __init__(self, folder: Path) -> None:
        self._files: dict[int, Path] | None = None
        if images_in(folder / "rgb"):
            self._files = images_by_number(folder / "rgb", ())
            require_inside(folder, self._files.values())
            return
        if not (folder / _VIDEO).is_file():
            raise SequenceError(f"{folder / _VIDEO}: no such file, expected the video, or its frames in rgb/")
        self._video = VideoFile(folder / _VIDEO)

    def __contains__(self, number: int) -> bool:
        if self._files is not None:
            return number in self._files
        return self._video.num_frames is None or number < self._video.num_frames

    def __getitem__(self, number: int) -> ImageFile:
        return self._files[number] if self._files is not None else self._video.frame(number)

    def num_beside(self, numbers: Mapping[int, str]) -> int:
        """How many images there are beside these."""
        if self._files is not None:
            return len(self._files.keys() - numbers.keys())
        stated = self._video.num_frames or 0
        return stated - sum(number < stated for number in numbers)

    @property
    def size(self) -> tuple[int, int] | None:
        """Width and height where they are known without decoding an image."""
        return None if self._files is not None else (self._video.width, self._video.height)


def _table(file: Path) -> tuple[list[str], list[tuple[int, str]]]:
    lines = list(read_rows(file))
    if not lines:
        raise SequenceError(f"{file}: empty, expected the header `{', '.join(_COLUMNS)}` and rows")
    names = [name.strip() for name in lines[0][1].split(",")]
    if not set(_COLUMNS) <= set(names) or len(set(names)) != len(names):
        raise SequenceError(f"{file}:{lines[0][0]}: {quoted(lines[0][1])}, expected the header {', '.join(_COLUMNS)}")
    return names, lines[1:]


def _read_row(names: list[str], fields: list[str], where: str) -> tuple[int, int, list[float]]:
    """Number of the frame, stamp, and `_FOCAL` of a row, empty where it has none."""
    if len(fields) != len(names):
        raise SequenceError(f"{where}: {len(fields)} columns, expected the {len(names)} of the header")
    row = dict(zip(names, fields, strict=True))
    focal = parse_numbers([row[name] for name in _FOCAL], where) if set(_FOCAL) <= row.keys() else []
    return parse_frame_number(row["frame"], where), parse_time_ns(row["timestamp"], where), focal


def _camera(
    file: Path, files: list[ImageFile], focal: list[list[float]], size: tuple[int, int] | None
) -> Camera | None:
    """Intrinsics of the images; None where none of them can be read."""
    matrix = [parse_numbers(line.split(","), f"{file}:{number}") for number, line in read_rows(file)]
    if [len(row) for row in matrix] != [3, 3, 3]:
        raise SequenceError(f"{file}: rows of {quoted([len(row) for row in matrix])} columns, expected a 3 x 3 matrix")
    fx, fy, cx, cy = matrix[0][0], matrix[1][1], matrix[0][2], matrix[1][2]
    if focal:
        fx, fy, cx, cy = np.median(np.array(focal), axis=0).tolist()
    size = size or size_of_first(files)
    if size is None:
        return None
    width, height = size
    if not (np.isfinite([fx, fy]).all() and min(fx, fy) > 0 and 0 < cx < width and 0 < cy < height):
        raise SequenceError(
            f"{file}: fx {fx:g}, fy {fy:g}, cx {cx:g}, cy {cy:g}, expected those of images of {width} x {height} pixels"
        )
    return Camera(width, height, fx, fy, cx, cy)


LAYOUT = Layout(_NAME, looked_for="odometry.csv", order=70, list_images=list_images, video=_VIDEO)
