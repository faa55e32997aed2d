"""Image files of a layout: which there are, and what they hold."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

from sequences.errors import SequenceError

_SUFFIXES = (".png", ".jpg", ".jpeg")


def read_image_bytes(file: Path) -> bytes:
    """Bytes of an image file. Raises SequenceError where it cannot be read."""
    try:
        return file.read_bytes()
    except OSError as error:
        raise SequenceError(f"{file}: cannot read the image: {error.strerror or error}") from error


def images_in(folder: Path) -> list[Path]:
    """PNG and JPEG files directly in a folder, in the order of their names; none where there is no such folder."""
    if not folder.is_dir():
        return []
    return sorted(file for file in folder.iterdir() if file.suffix.lower() in _SUFFIXES and file.is_file())


def images_by_number(folder: Path, subfolders: tuple[str, ...]) -> dict[int, Path]:
    """Images by the last number in their names, from the first of the subfolders that holds any, or else the folder.

    Raises:
        SequenceError: two images have the same number, or none has one.
    """
    places = [*(folder / name for name in subfolders), folder]
    files = next((files for place in places if (files := images_in(place))), [])
    numbered: dict[int, Path] = {}
    for file in files:
        match = re.search(r"(\d+)\D*$", file.stem, flags=re.ASCII)
        if match is None:
            continue
        number = int(match[1])
        if number in numbered:
            raise SequenceError(f"{file}: frame {number} is {numbered[number].name} too, expected one image a frame")
        numbered[number] = file
    if not numbered:
        wanted = ", ".join(f"{name}/" for name in subfolders)
        raise SequenceError(f"{folder}: no images, expected PNG or JPEG files with a frame number in {wanted} or in it")
    return numbered


def num_beside(files: Iterable[Path]) -> int:
    """How many other images lie in the folders of these."""
    wanted = set(files)
    return sum(file not in wanted for folder in {file.parent for file in wanted} for file in images_in(folder))
