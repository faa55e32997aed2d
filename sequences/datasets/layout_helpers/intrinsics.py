"""Intrinsics of the images of a layout."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TypeVar, get_args

from filtering.errors import quoted
from sequences.datasets.layout_helpers.image_files import size_of_first
from sequences.datasets.layout_helpers.packed import ImageFile
from sequences.errors import SequenceError
from sequences.files.structured import read_json
from sequences.frame import Camera
from sequences.images.undistortion import DistortionModel, Lens
from sequences.values import parse_number

Seen = TypeVar("Seen", Camera, Lens, Camera | Lens)


def find_camera(
    folders: Iterable[Path], files: Iterable[ImageFile], known: Camera | None = None
) -> Camera | Lens | None:
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


def _read_intrinsics(file: Path) -> Camera | Lens:
    keys = ("width", "height", "fx", "fy", "cx", "cy")
    values = read_json(file)
    missing = [key for key in keys if not isinstance(values, dict) or key not in values]
    if missing:
        raise SequenceError(f"{file}: no {', '.join(missing)}, expected JSON with {', '.join(keys)} in pixels")
    width, height, fx, fy, cx, cy = (values[key] for key in keys)
    camera = camera_of(str(file), (width, height), (fx, fy), (cx, cy))
    coefficients = values.get("distortion")
    if coefficients is None:
        return camera
    if not isinstance(coefficients, list):
        raise SequenceError(f"{file}: distortion is {quoted(coefficients)}, expected a list such as [k1, k2, p1, p2]")
    numbers = [parse_number(value, f"{file}: distortion") for value in coefficients]
    model = values.get("distortion_model", "plumb_bob")
    if model not in (models := get_args(DistortionModel)):
        raise SequenceError(f"{file}: distortion model {quoted(model)}, expected one of {', '.join(models)}")
    return lens_of(str(file), camera, model, numbers)


def camera_of(where: str, size: Sequence[object], focal: Sequence[object], centre: Sequence[object]) -> Camera:
    """The camera that a file states, in pixels; numbers, or text that is one.

    Args:
        where: Begins the message of an error.
        size: Width and height.
        focal: fx and fy.
        centre: cx and cy of the principal point, 0 at the centre of the first pixel.

    Raises:
        SequenceError: numbers that no camera has.
    """
    stated = zip(("width", "height", "fx", "fy", "cx", "cy"), (*size, *focal, *centre), strict=True)
    width, height, *others = (parse_number(value, f"{where}: {name}") for name, value in stated)
    try:
        return Camera(int(width), int(height), *others)
    except SequenceError as error:
        raise SequenceError(f"{where}: {error}") from error


def lens_of(where: str, camera: Camera, model: DistortionModel, coefficients: Sequence[float]) -> Camera | Lens:
    """The lens of a camera; the camera itself where it does not distort.

    Raises:
        SequenceError: a distortion that no lens has. `where` begins the message.
    """
    if not any(coefficients) and model != "equidistant":
        return camera
    try:
        return Lens(camera, model, tuple(coefficients))
    except SequenceError as error:
        raise SequenceError(f"{where}: {error}") from error
