"""Intrinsics of the images of a layout."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import TypeVar

from sequences.errors import SequenceError
from sequences.frame import Camera
from sequences.layouts.image_files import size_of_first
from sequences.layouts.packed import ImageFile
from sequences.tum import read_lines
from sequences.undistortion import Lens

Seen = TypeVar("Seen", Camera, Lens, Camera | Lens)


def find_camera(folders: Iterable[Path], files: Iterable[ImageFile], known: Camera | None = None) -> Camera | None:
    """Intrinsics from the first `intrinsics.json` in these folders, else the known ones; scaled to the images.

    Raises:
        SequenceError: the file is there and damaged.
    """
    described = next((file for folder in folders if (file := folder / "intrinsics.json").is_file()), None)
    camera = _read_intrinsics(described) if described else known
    return camera if camera is None else scaled_to(camera, files)


def scaled_to(camera: Seen, files: Iterable[ImageFile]) -> Seen:
    """The same camera or lens at the size of the first of the images that can be read."""
    size = size_of_first(files)
    return camera if size is None else camera.scaled(*size)


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
