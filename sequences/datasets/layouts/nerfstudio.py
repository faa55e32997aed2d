"""nerfstudio's `transforms.json`, as `ns-process-data` and instant-ngp's scripts write it.

`frames` has an entry an image: `file_path`, relative to the file, and `transform_matrix`, the pose camera-to-world with
OpenGL's axes (y up, z backward). Intrinsics `fl_x fl_y cx cy w h`, `camera_model`, or instant-ngp's `is_fisheye`, and
the distortion `k1 k2 k3 k4 p1 p2` stand in the entry or at the top; `camera_angle_x`, as of synthetic scenes, gives the
focal length where `fl_x` does not. Pixel centres are at half-integers, as COLMAP's. The unit is that of the
reconstruction, `applied_scale` undone, and taken to be metres. There are no time stamps: images follow each other in
the order of their names at the assumed rate, those of each folder as a sequence. A split is named by its file, such as
`transforms_train.json`.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import tan
from pathlib import Path
from typing import Any

from filtering.errors import quoted
from filtering.se3 import Poses
from sequences.datasets.layout import Layout, PosedImages
from sequences.datasets.layout_helpers.image_files import camera_of, lens_of, scaled_to, size_of_first
from sequences.datasets.layout_helpers.packed import ImageFile
from sequences.datasets.layout_helpers.pose_lists import list_named
from sequences.datasets.layout_helpers.pose_rows import from_opengl, read_pose_matrix
from sequences.errors import SequenceError
from sequences.files import Rows, read_json
from sequences.frame import Camera
from sequences.images.undistortion import DistortionModel, Lens
from sequences.values import LARGEST, parse_number

_NAME = "nerfstudio"
# How nerfstudio takes each model, and the names of the coefficients in OpenCV's order: those that it lacks are 0.
_MODELS: dict[str, DistortionModel] = {
    **dict.fromkeys(("SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV"), "plumb_bob"),
    "OPENCV_FISHEYE": "equidistant",
}
_COEFFICIENTS: dict[DistortionModel, tuple[str, ...]] = {
    "plumb_bob": ("k1", "k2", "p1", "p2", "k3"),
    "equidistant": ("k1", "k2", "k3", "k4"),
}
# Keys by which instant-ngp marks images of other cameras than pinholes and fisheyes.
_OTHER_IMAGES = ("equirectangular", "latlong", "orthographic", "ftheta_p0")
_PANORAMAS = ("EQUIRECTANGULAR", "equirectangular", "latlong")
_SMALLEST = 1e-6  # of positive numbers
_SUFFIXES = ("", ".png", ".jpg", ".jpeg")  # that names may lack


def list_images(path: Path) -> PosedImages | None:
    """Images of a file; None where there is none.

    Args:
        path: The file, or the folder of `transforms.json`.

    Raises:
        SequenceError: the file is damaged, an image is there twice, or a camera is missing or of another kind.
    """
    file = path / "transforms.json" if path.is_dir() else path
    if not (file.is_file() and file.name.startswith("transforms") and file.suffix == ".json"):
        return None
    content = read_json(file)
    if not isinstance(content, dict) or not isinstance(content.get("frames"), list):
        raise SequenceError(f"{file}: no list of frames, expected `frames` with file_path and transform_matrix each")
    scale = _number(content, "applied_scale", str(file), 1.0, low=_SMALLEST)
    root = file.parent
    poses: dict[str, Poses | str] = {}
    stated: dict[ImageFile, _Stated] = {}
    rows = Rows("frames")
    for number, frame in rows.each(enumerate(content["frames"])):
        where = f"{file}: frames[{number}]"
        if not isinstance(frame, dict) or not isinstance(frame.get("file_path"), str):
            raise SequenceError(f"{where}: no file_path, expected the name of an image")
        name = _existing(root, frame["file_path"].replace("\\", "/"))
        if name in poses:
            raise SequenceError(f"{where}: {quoted(name)} for the second time, expected it once")
        pose = from_opengl(rows.use(read_pose_matrix, frame.get("transform_matrix"), f"{where}: transform_matrix"))
        poses[name] = pose if isinstance(pose, str) else _scaled(pose, 1.0 / scale)
        stated[root / name] = _read_stated(content | frame, where)
    images = list_named(_NAME, root, root, poses, notices=rows.notices)
    used = [stated[image] for image in images.files]
    cameras = {
        one: _camera(one, [image for image, its in zip(images.files, used, strict=True) if its == one], str(file))
        for one in set(used)
    }
    return replace(images, cameras=[cameras[one] for one in used])


def _existing(root: Path, name: str) -> str:
    """The name with the suffix that it lacks, as those of synthetic scenes do."""
    return next((name + suffix for suffix in _SUFFIXES if os.path.isfile(root / (name + suffix))), name)


def _scaled(pose: Poses, factor: float) -> Poses:
    return Poses(pose.rotation, pose.translation * factor)


@dataclass(frozen=True)
class _Stated:
    """A camera as the file states it; None where it does not."""

    w: float | None
    h: float | None
    fl_x: float | None
    fl_y: float | None
    cx: float | None
    cy: float | None
    camera_angle_x: float | None
    model: DistortionModel
    coefficients: tuple[float, ...]


def _read_stated(values: dict[str, Any], where: str) -> _Stated:
    name = _camera_model(values, where)
    coefficients = _COEFFICIENTS[_MODELS[name]]
    for key in ("k1", "k2", "k3", "k4", "p1", "p2"):
        if key not in coefficients and _number(values, key, where, 0.0):
            raise SequenceError(f"{where}: {key} of {name} is not 0, expected a distortion that OpenCV knows")
    names = ("w", "h", "fl_x", "fl_y", "cx", "cy", "camera_angle_x")
    positive = ("w", "h", "fl_x", "fl_y")
    stated = {key: _number(values, key, where, None, low=_SMALLEST if key in positive else -LARGEST) for key in names}
    distortion = tuple(_number(values, key, where, 0.0) for key in coefficients)
    return _Stated(**stated, model=_MODELS[name], coefficients=distortion)


def _camera_model(values: dict[str, Any], where: str) -> str:
    fisheye = values.get("is_fisheye") or False
    if not isinstance(fisheye, bool):
        raise SequenceError(f"{where}: is_fisheye is {quoted(fisheye)}, expected true or false")
    name = values.get("camera_model") or next((key for key in _OTHER_IMAGES if values.get(key)), None)
    if name is None:
        return "OPENCV_FISHEYE" if fisheye else "OPENCV"
    if not isinstance(name, str) or name not in _MODELS:
        way_out = f"expected one of {', '.join(_MODELS)}"
        if name in _PANORAMAS:
            way_out = "expected perspective images, as `ns-process-data images --camera-type equirectangular` cuts out"
        raise SequenceError(f"{where}: camera_model {quoted(name)}, {way_out}")
    if fisheye and name != "OPENCV_FISHEYE":
        raise SequenceError(f"{where}: camera_model {name} and is_fisheye, expected OPENCV_FISHEYE or no camera_model")
    return name


def _number(values: dict[str, Any], key: str, where: str, default: Any, low: float = -LARGEST) -> Any:
    value = values.get(key)
    return default if value is None else parse_number(value, f"{where}: {key}", low)


def _camera(stated: _Stated, files: Sequence[ImageFile], where: str) -> Camera | Lens | None:
    """Intrinsics in pixels of the images; None where no focal length is stated, or no size and no image to be read."""
    width, height, angle = stated.w, stated.h, stated.camera_angle_x
    if width is None or height is None:
        size = size_of_first(files)
        if size is None:
            return None
        width, height = size
    fx = stated.fl_x
    if fx is None and angle is not None and 0 < angle < 3:
        fx = width / (2 * tan(angle / 2))
    if fx is None:
        return None
    fy = fx if stated.fl_y is None else stated.fl_y
    cx, cy = width / 2 if stated.cx is None else stated.cx, height / 2 if stated.cy is None else stated.cy
    camera = camera_of(where, (width, height), (fx, fy), (cx - 0.5, cy - 0.5))
    return scaled_to(lens_of(where, camera, stated.model, stated.coefficients), files)


LAYOUT = Layout(_NAME, looked_for="transforms.json", order=90, list_images=list_images, list_suffixes=(".json",))
