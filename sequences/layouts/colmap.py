"""COLMAP's text model: `images.txt`, `cameras.txt` and usually `points3D.txt`, which is not read.

In `images.txt` two lines are an image: `IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME`, the pose world-to-camera, and
its keypoints, which may be none. Names are relative to a folder of images that the model does not name: `images/` or
the folder itself is tried, of the model's folder and of the two above it. The unit is that of the reconstruction and
taken to be metres. There are no time stamps: images follow each other in the order of their names at the assumed rate,
those of each folder as a sequence.

Intrinsics are of SIMPLE_PINHOLE, PINHOLE, SIMPLE_RADIAL, RADIAL or OPENCV cameras, whose distortion is ignored. COLMAP
has the first pixel's centre at (0.5, 0.5), here it is at (0, 0).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from filtering.se3 import Poses
from sequences.errors import SequenceError
from sequences.frame import Camera
from sequences.layouts.intrinsics import scaled_to
from sequences.layouts.named import list_named
from sequences.layouts.pose_rows import NOT_FINITE, read_pose_row
from sequences.layouts.posed_images import PosedImages
from sequences.tum import read_lines

LOOKED_FOR = "a COLMAP text model (images.txt and cameras.txt, in it, in sparse/0 or in sparse)"
_IMAGE_COLUMNS = "id qw qx qy qz tx ty tz camera name"
_CAMERA_COLUMNS = "CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]"
# Of each model: focal lengths among its parameters, which are followed by cx and cy, and parameters in all.
_MODELS = {"SIMPLE_PINHOLE": (1, 3), "PINHOLE": (2, 4), "SIMPLE_RADIAL": (1, 4), "RADIAL": (1, 5), "OPENCV": (2, 8)}


def list_images(path: Path) -> PosedImages | None:
    """Images of a model; None where there is none.

    Raises:
        SequenceError: the model is binary, a line is damaged, an image or a camera is there twice, a camera is missing
            or of another kind, or no image is found.
    """
    models = [path, path / "sparse" / "0", path / "sparse"]
    model = next((m for m in models if (m / "images.txt").is_file() and (m / "cameras.txt").is_file()), None)
    if model is None:
        for m in models:
            if (m / "images.bin").is_file():
                raise SequenceError(f"{m / 'images.bin'}: a binary model, expected it as text (colmap model_converter)")
        return None
    cameras = _read_cameras(model / "cameras.txt")
    poses, camera_ids = _read_images(model / "images.txt", cameras)
    root = _image_folder(model, camera_ids)
    images = list_named("COLMAP", root, poses)
    ids = {root / name: camera_id for name, camera_id in camera_ids.items()}
    used = [ids[file] for file in images.files]
    scaled = {
        camera_id: scaled_to(cameras[camera_id], (f for f, i in zip(images.files, used, strict=True) if i == camera_id))
        for camera_id in set(used)
    }
    return replace(images, cameras=[scaled[camera_id] for camera_id in used])


def _read_cameras(file: Path) -> dict[str, Camera]:
    """Cameras by their ids."""
    cameras: dict[str, Camera] = {}
    for number, line in enumerate(read_lines(file), start=1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        where, fields = f"{file}:{number}", line.split()
        if len(fields) < 4:
            raise SequenceError(f"{where}: {len(fields)} columns, expected `{_CAMERA_COLUMNS}`")
        camera_id, model = fields[:2]
        if camera_id in cameras:
            raise SequenceError(f"{where}: camera {camera_id} for the second time, expected it once")
        if model not in _MODELS:
            raise SequenceError(f"{where}: camera model {model}, expected one of {', '.join(_MODELS)}")
        num_focal, num_parameters = _MODELS[model]
        try:
            width, height = int(fields[2]), int(fields[3])
            parameters = [float(text) for text in fields[4:]]
        except ValueError as error:
            raise SequenceError(f"{where}: {error}; expected numbers in `{_CAMERA_COLUMNS}`") from error
        if len(parameters) != num_parameters:
            raise SequenceError(f"{where}: {len(parameters)} parameters, expected the {num_parameters} of {model}")
        if not np.isfinite(parameters).all() or min(width, height, *parameters[:num_focal]) <= 0:
            raise SequenceError(
                f"{where}: {line.strip()!r}, expected finite parameters, positive sizes and focal lengths"
            )
        cx, cy = parameters[num_focal : num_focal + 2]
        cameras[camera_id] = Camera(width, height, parameters[0], parameters[num_focal - 1], cx - 0.5, cy - 0.5)
    return cameras


def _read_images(file: Path, cameras: dict[str, Camera]) -> tuple[dict[str, Poses | str], dict[str, str]]:
    """Poses, or why there is none, and the ids of the cameras, both by the name of the image."""
    poses: dict[str, Poses | str] = {}
    camera_ids: dict[str, str] = {}
    seen: dict[str, int] = {}
    lines = _lines(file)
    for number, line in lines:
        if not line.strip():
            continue
        where, fields = f"{file}:{number}", line.split(maxsplit=9)
        camera_from_world = read_pose_row([field.strip() for field in fields], _IMAGE_COLUMNS, where)
        camera_id, name = fields[8], fields[9].strip()
        if name in seen:
            raise SequenceError(f"{where}: {name} is on line {seen[name]} too, expected it once")
        if camera_id not in cameras:
            raise SequenceError(f"{where}: camera {camera_id}, expected one of those in cameras.txt")
        seen[name] = number
        camera_ids[name] = camera_id
        poses[name] = NOT_FINITE if camera_from_world is None else camera_from_world.inverse()
        next_number, keypoints = next(lines, (number + 1, ""))
        if (num_columns := len(keypoints.split())) % 3:
            raise SequenceError(
                f"{file}:{next_number}: {num_columns} columns, expected keypoints of {name}: `X Y POINT3D_ID`, none or"
                " more of them"
            )
    return poses, camera_ids


def _lines(file: Path) -> Iterator[tuple[int, str]]:
    """Lines with their numbers, without comments, one at a time: keypoints make such files large."""
    try:
        with open(file, encoding="utf-8") as stream:
            for number, line in enumerate(stream, start=1):
                if not line.startswith("#"):
                    yield number, line
    except OSError as error:
        raise SequenceError(f"{file}: cannot read: {error.strerror or error}") from error
    except UnicodeDecodeError as error:
        raise SequenceError(f"{file}: byte {error.start} is no UTF-8 text, expected a text file") from error


def _image_folder(model: Path, names: dict[str, str]) -> Path:
    model = model.absolute()
    bases = [model, *model.parents[:2]]
    folders = [folder for base in bases for folder in (base / "images", base)]
    for folder in folders:
        if any((folder / name).is_file() for name in names):
            return folder
    raise SequenceError(f"{model / 'images.txt'}: none of its images found, looked in {', '.join(map(str, folders))}")
