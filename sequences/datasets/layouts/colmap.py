"""COLMAP's model, binary or text: `images`, `cameras` and usually `points3D`, whose points the images' keypoints name.

Where both are, the binary one is read, as by COLMAP itself. In `images.txt` two lines are an image: `IMAGE_ID QW QX QY
QZ TX TY TZ CAMERA_ID NAME`, the pose world-to-camera, and its keypoints, which may be none. Names are relative to a
folder of images that the model does not name: `images/` or the folder itself is tried, of the model's folder and of the
two above it. The unit is that of the reconstruction and taken to be metres. Images follow each other in the order of
their names, those of each folder as a sequence. Names that are time stamps (`1305031102.175304.png`), as `vapor-track
map` and other recorders give them, are their times; else they are at the assumed rate.

Of COLMAP's camera models those that OpenCV does not undistort are refused: FOV, fisheyes with a thin prism, division,
EUCM, SKEWED_PINHOLE and EQUIRECTANGULAR. COLMAP has the first pixel's centre at (0.5, 0.5), here it is at (0, 0).
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float64, Int64

from filtering.errors import quoted
from filtering.se3 import Poses
from sequences.datasets.layout import Layout, PosedImages
from sequences.datasets.layout_helpers.colmap_binary import (
    LARGEST_ID,
    UNDISTORTER,
    camera_rows,
    image_rows,
    keypoint_rows,
)
from sequences.datasets.layout_helpers.image_files import camera_of, lens_of, scaled_to
from sequences.datasets.layout_helpers.packed import ImageFile
from sequences.datasets.layout_helpers.pose_lists import list_named
from sequences.datasets.layout_helpers.pose_rows import read_pose_row
from sequences.datasets.points import PointsOfImages, point_ids, seen_points
from sequences.errors import SequenceError
from sequences.files import Rows, read_lines, read_rows
from sequences.frame import Camera
from sequences.images.undistortion import DistortionModel, Lens
from sequences.trajectories.pose_lines import stamp_ns, stamp_of
from sequences.values import parse_numbers, parse_whole

_NAME = "COLMAP"
_BETWEEN_NS = 1_000_000_000  # from a sequence to the next, where their stamps overlap
_IMAGE_COLUMNS = "id qw qx qy qz tx ty tz camera name"
_CAMERA_COLUMNS = "CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]"
# Of each model: focal lengths among its parameters, which are followed by cx and cy; how it distorts, and the names of
# the coefficients of that, which come last.
_MODELS: dict[str, tuple[int, DistortionModel, str]] = {
    "SIMPLE_PINHOLE": (1, "plumb_bob", ""),
    "PINHOLE": (2, "plumb_bob", ""),
    "SIMPLE_RADIAL": (1, "plumb_bob", "k1"),
    "RADIAL": (1, "plumb_bob", "k1 k2"),
    "OPENCV": (2, "plumb_bob", "k1 k2 p1 p2"),
    "BROWN_CONRADY": (1, "plumb_bob", "k1 k2 k3 p1 p2"),
    "FULL_OPENCV": (2, "rational_polynomial", "k1 k2 p1 p2 k3 k4 k5 k6"),
    "SIMPLE_FISHEYE": (1, "equidistant", ""),
    "FISHEYE": (2, "equidistant", ""),
    "SIMPLE_RADIAL_FISHEYE": (1, "equidistant", "k1"),
    "RADIAL_FISHEYE": (1, "equidistant", "k1 k2"),
    "OPENCV_FISHEYE": (2, "equidistant", "k1 k2 k3 k4"),
}
# OpenCV's order; coefficients that a model lacks are zero, and those behind its last one left out, but for four.
_ORDERS = {
    "equidistant": "k1 k2 k3 k4",
    "plumb_bob": "k1 k2 p1 p2 k3",
    "rational_polynomial": "k1 k2 p1 p2 k3 k4 k5 k6",
}


def list_images(path: Path) -> PosedImages | None:
    """Images of a model; None where there is none."""
    models = [path, path / "sparse" / "0", path / "sparse"]
    files = [(m / f"cameras{suffix}", m / f"images{suffix}") for m in models for suffix in (".bin", ".txt")]
    found = next((both for both in files if all(file.is_file() for file in both)), None)
    if found is None:
        return None
    cameras = _read_cameras(found[0])
    rows, skipped = Rows("images"), Counter[str]()
    poses, camera_ids = _read_images(found[1], cameras, rows, skipped)
    base, root = _image_folder(found[1], camera_ids)
    folders = [Path(each) for each, _, _ in os.walk(root)] if root != base else ()  # which may hold what not
    images = _with_stamps(list_named(_NAME, base, root, poses, folders, rows.notices))
    ids: dict[ImageFile, str] = {root / name: camera_id for name, camera_id in camera_ids.items()}
    used = [ids[file] for file in images.files]
    by_name = {name: cameras[camera_id] for name, camera_id in camera_ids.items()}
    scaled = {
        camera_id: scaled_to(cameras[camera_id], (f for f, i in zip(images.files, used, strict=True) if i == camera_id))
        for camera_id in set(used)
    }
    points = found[1].with_stem("points3D")
    return replace(
        images,
        cameras=[scaled[camera_id] for camera_id in used],
        skipped=images.skipped + skipped,
        read_points=partial(_read_points, found[1], points, root, by_name) if points.is_file() else None,
    )


def _read_points(
    file: Path, points: Path, root: Path, cameras: Mapping[str, Camera | Lens], undistort: bool
) -> PointsOfImages:
    """The points that images show, of those that there are; cameras by the names of the images."""
    keypoints = keypoint_rows(file) if file.suffix == ".bin" else _text_keypoints(file)
    stated = ((root / name, cameras[name], at - 0.5, point) for name, at, point in keypoints if name in cameras)
    return seen_points(str(file), stated, point_ids(points), undistort)


def _read_cameras(file: Path) -> dict[str, Camera | Lens]:
    cameras: dict[str, Camera | Lens] = {}
    text_rows = ((number, line.split()) for number, line in read_rows(file))
    for number, fields in camera_rows(file) if file.suffix == ".bin" else text_rows:
        where = f"{file}:{number}"
        if len(fields) < 4:
            raise SequenceError(f"{where}: {len(fields)} columns, expected `{_CAMERA_COLUMNS}`")
        camera_id, model = fields[:2]
        if camera_id in cameras:
            raise SequenceError(f"{where}: camera {quoted(camera_id)} for the second time, expected it once")
        if model not in _MODELS:
            raise SequenceError(
                f"{where}: camera model {quoted(model)} cannot be undistorted here, expected one of"
                f" {', '.join(_MODELS)}; {UNDISTORTER}"
            )
        num_focal, distortion, names = _MODELS[model]
        num_parameters = num_focal + 2 + len(names.split())
        parameters = parse_numbers(fields[4:], where, f"those of `{_CAMERA_COLUMNS}`")
        if len(parameters) != num_parameters:
            raise SequenceError(f"{where}: {len(parameters)} parameters, expected the {num_parameters} of {model}")
        centre = [value - 0.5 for value in parameters[num_focal : num_focal + 2]]
        camera = camera_of(where, fields[2:4], (parameters[0], parameters[num_focal - 1]), centre)
        stated = dict(zip(names.split(), parameters[num_focal + 2 :], strict=True))
        coefficients = [stated.get(name, 0.0) for name in _ORDERS[distortion].split()][: max(len(stated), 4)]
        cameras[camera_id] = lens_of(where, camera, distortion, coefficients)
    return cameras


def _read_images(
    file: Path, cameras: dict[str, Camera | Lens], rows: Rows, skipped: Counter[str]
) -> tuple[dict[str, Poses | str], dict[str, str]]:
    """Poses, or why there is none, and the ids of the cameras, both by the name of the image."""
    poses: dict[str, Poses | str] = {}
    camera_ids: dict[str, str] = {}
    seen: dict[str, int] = {}
    binary = file.suffix == ".bin"
    text_rows = ((number, fields) for number, fields, _ in _text_images(file))
    for number, fields in rows.each(image_rows(file) if binary else text_rows):
        where = f"{file}:{number}"
        camera_from_world = rows.use(read_pose_row, fields, _IMAGE_COLUMNS, where)
        if isinstance(camera_from_world, str) and len(fields) != len(_IMAGE_COLUMNS.split()):
            skipped[camera_from_world] += 1
            continue
        camera_id, name = fields[8:]
        if name in seen:
            place = f"image {seen[name]}" if binary else f"on line {seen[name]}"
            raise SequenceError(f"{where}: {quoted(name)} is {place} too, expected it once")
        if camera_id not in cameras:
            raise SequenceError(
                f"{where}: camera {quoted(camera_id)}, expected one of those in {file.with_stem('cameras').name}"
            )
        seen[name] = number
        camera_ids[name] = camera_id
        is_known = isinstance(camera_from_world, Poses)
        poses[name] = camera_from_world.inverse() if is_known else camera_from_world
    return poses, camera_ids


def _text_keypoints(file: Path) -> Iterator[tuple[str, Float64[np.ndarray, "k 2"], Int64[np.ndarray, " k"]]]:
    for number, fields, keypoints in _text_images(file):
        where = f"{file}:{number + 1}"
        of_points = [each for each in zip(*3 * [iter(keypoints)], strict=True) if not each[2].startswith("-")]
        pixels = parse_numbers((value for each in of_points for value in each[:2]), where, "those of `X Y POINT3D_ID`")
        points = [parse_whole(each[2], f"{where}: POINT3D_ID", 0, LARGEST_ID) for each in of_points]
        yield fields[-1], np.array(pixels, np.float64).reshape(-1, 2), np.array(points, np.int64)


def _text_images(file: Path) -> Iterator[tuple[int, list[str], list[str]]]:
    """Line and fields of each image, and those of its keypoints; names may hold blanks."""
    lines = (row for row in read_lines(file, most=None) if not row[1].startswith("#"))  # keypoints make it large
    for number, line in lines:
        if not line.strip():
            continue
        fields = [field.strip() for field in line.split(maxsplit=9)]
        next_number, line = next(lines, (number + 1, ""))
        if len(keypoints := line.split()) % 3:
            raise SequenceError(
                f"{file}:{next_number}: {len(keypoints)} columns, expected keypoints of {quoted(fields[-1])}: `X Y"
                " POINT3D_ID`, none or more of them"
            )
        yield number, fields, keypoints


def _with_stamps(images: PosedImages) -> PosedImages:
    """The images at the times that all their names state; each sequence as if after the one before it."""
    names = [file.name for file in images.files]
    if images.sequence is None or not names or any(stamp_of(name) is None for name in names):
        return images
    times_ns = np.array([stamp_ns(name, name) for name in names])
    end_ns: int | None = None
    for number in np.unique(images.sequence):
        of_it = images.sequence == number
        if (np.diff(times_ns[of_it]) <= 0).any():
            return images
        begin_ns = int(times_ns[of_it][0])
        if end_ns is not None and begin_ns <= end_ns:
            times_ns[of_it] += end_ns + _BETWEEN_NS - begin_ns
        end_ns = int(times_ns[of_it][-1])
    return replace(images, times_ns=times_ns, assumed_hz=None)


def _image_folder(file: Path, names: dict[str, str]) -> tuple[Path, Path]:
    """The folder that holds all, and the one that names are relative to."""
    model = file.absolute().parent
    bases = [model, *model.parents[:2]]
    folders = [(base, folder) for base in bases for folder in (base / "images", base)]
    for base, folder in folders:
        if any(os.path.isfile(folder / name) for name in names):
            return base, folder
    raise SequenceError(
        f"{file}: none of its images found, looked in {', '.join(str(folder) for _, folder in folders)}"
    )


LAYOUT = Layout(_NAME, looked_for="images.bin", order=100, list_images=list_images)
