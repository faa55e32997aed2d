"""Image files of a layout, their content and their intrinsics."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TypeVar, get_args

import numpy as np
from jaxtyping import UInt8

from filtering.errors import quoted
from sequences.datasets.layout_helpers.packed import ImageFile, PackedImage
from sequences.errors import SequenceError
from sequences.files import read_bytes, read_json
from sequences.frame import Camera
from sequences.images.decoding import decode_image_bytes
from sequences.images.headers import is_jpeg, is_png, stated_size
from sequences.images.undistortion import DistortionModel, Lens
from sequences.outputs import listed_results
from sequences.values import parse_frame_number, parse_number

_SUFFIXES = (".png", ".jpg", ".jpeg")


def read_image_bytes(file: ImageFile) -> bytes:
    """Bytes of a JPEG or PNG. Raises SequenceError where it cannot be read, or is none."""
    data = file.read_bytes() if isinstance(file, PackedImage) else read_bytes(file)
    if stated_size(data) is None or not (is_jpeg(data) or is_png(data)):
        raise SequenceError(f"{len(data)} bytes are no image with the header of a JPEG or PNG, expected one")
    return data


def decoded_file(file: ImageFile) -> UInt8[np.ndarray, "height width 3"]:
    """A JPEG or PNG as RGB. Raises as `decode_image_bytes`; the message begins with the name of the file."""
    try:
        return decode_image_bytes(read_image_bytes(file))
    except SequenceError as error:
        raise type(error)(f"{file}: {error}") from error


def size_of_first(files: Iterable[ImageFile]) -> tuple[int, int] | None:
    """Width and height of the first of the images that can be read; None where none can."""
    for file in files:
        try:
            height, width = decode_image_bytes(read_image_bytes(file)).shape[:2]
        except SequenceError:
            continue  # counted when it is its turn
        return width, height
    return None


def images_in(folder: Path) -> list[Path]:
    """PNG and JPEG files directly in a folder, in the order of their names; none where there is no such folder.

    Pictures that are results of a command, by the manifest of the folder, are left out.
    """
    if not os.path.isdir(folder):  # Path.is_dir raises where a name is too long
        return []
    images = [file for file in folder.iterdir() if file.suffix.lower() in _SUFFIXES and file.is_file()]
    results = listed_results(folder) if images else ()
    return sorted(file for file in images if file.name not in results)


def images_in_first(folder: Path, subfolders: tuple[str, ...]) -> list[Path]:
    """Images of the first of the subfolders that holds any, or else of the folder; none where there are none."""
    places = [*(folder / name for name in subfolders), folder]
    return next((files for place in places if (files := images_in(place))), [])


def images_by_number(folder: Path, subfolders: tuple[str, ...]) -> dict[int, Path]:
    """Images by the last number in their names, from the first of the subfolders that holds any, or else the folder.

    Raises SequenceError where two images have the same number, or none has one.
    """
    numbered: dict[int, Path] = {}
    for file in images_in_first(folder, subfolders):
        match = re.search(r"(\d+)\D*$", file.stem, flags=re.ASCII)
        if match is None:
            continue
        number = parse_frame_number(match[1], str(file))
        if number in numbered:
            raise SequenceError(f"{file}: frame {number} is {numbered[number].name} too, expected one image a frame")
        numbered[number] = file
    if not numbered:
        wanted = ", ".join(f"{name}/" for name in subfolders)
        raise SequenceError(f"{folder}: no images, expected PNG or JPEG files with a frame number in {wanted} or in it")
    return numbered


def num_beside(files: Iterable[Path], folders: Iterable[Path] = ()) -> int:
    """How many other images lie in the folders of these, and in further folders."""
    wanted = set(files)
    places = {file.parent for file in wanted}.union(folders)
    return sum(file not in wanted for folder in places for file in images_in(folder))


Seen = TypeVar("Seen", Camera, Lens, Camera | Lens)


def find_camera(
    folders: Iterable[Path], files: Iterable[ImageFile], known: Camera | None = None
) -> Camera | Lens | None:
    """Intrinsics from the first `intrinsics.json` in these folders, else the known ones; scaled to the images.

    Raises SequenceError where the file is there and damaged.
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
    """The camera that a file states: size, focal lengths and principal point in pixels, as numbers or text.

    The centre of the first pixel is at (0, 0). Raises SequenceError for numbers that no camera has; `where` begins the
    message.
    """
    stated = zip(("width", "height", "fx", "fy", "cx", "cy"), (*size, *focal, *centre), strict=True)
    width, height, *others = (parse_number(value, f"{where}: {name}") for name, value in stated)
    try:
        return Camera(int(width), int(height), *others)
    except SequenceError as error:
        raise SequenceError(f"{where}: {error}") from error


def lens_of(where: str, camera: Camera, model: DistortionModel, coefficients: Sequence[float]) -> Camera | Lens:
    """The lens of a camera; the camera itself where it does not distort.

    Raises SequenceError for a distortion that no lens has. `where` begins the message.
    """
    if not any(coefficients) and model != "equidistant":
        return camera
    try:
        return Lens(camera, model, tuple(coefficients))
    except SequenceError as error:
        raise SequenceError(f"{where}: {error}") from error
