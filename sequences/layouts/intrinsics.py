"""Intrinsics of the images of a layout."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path

from sequences.errors import SequenceError
from sequences.frame import Camera
from sequences.layouts.image_files import read_image_bytes
from sequences.messages import decode_image_bytes
from sequences.tum import read_lines


def find_camera(folders: Iterable[Path], files: Iterable[Path], known: Camera | None = None) -> Camera | None:
    """Intrinsics from the first `intrinsics.json` in these folders, else the known ones; scaled to the images.

    Raises:
        SequenceError: the file is there and damaged.
    """
    described = next((file for folder in folders if (file := folder / "intrinsics.json").is_file()), None)
    camera = _read_intrinsics(described) if described else known
    return camera if camera is None else scaled_to(camera, files)


def scaled_to(camera: Camera, files: Iterable[Path]) -> Camera:
    """The same camera at the size of the first of the images that can be read."""
    for file in files:
        try:
            height, width = decode_image_bytes(read_image_bytes(file)).shape[:2]
        except SequenceError:
            continue  # counted when it is its turn
        return _scaled(camera, width, height)
    return camera


def _read_intrinsics(file: Path) -> Camera:
    keys = ("width", "height", "fx", "fy", "cx", "cy")
    try:
        values = json.loads("\n".join(read_lines(file)))
        width, height, fx, fy, cx, cy = (float(values[key]) for key in keys)
    except (ValueError, KeyError, TypeError) as error:
        raise SequenceError(
            f"{file}: {type(error).__name__}: {error}; expected JSON with {', '.join(keys)} in pixels"
        ) from error
    return Camera(int(width), int(height), fx, fy, cx, cy)


def _scaled(camera: Camera, width: int, height: int) -> Camera:
    """The same camera at another image size; the image's edge, half a pixel from the first centre, stays the edge."""
    if (width, height) == (camera.width, camera.height):
        return camera
    sx, sy = width / camera.width, height / camera.height
    return Camera(
        width, height, camera.fx * sx, camera.fy * sy, (camera.cx + 0.5) * sx - 0.5, (camera.cy + 0.5) * sy - 0.5
    )
