"""The recording or data set at a path, and its images."""

from __future__ import annotations

import pkgutil
import shlex
from collections.abc import Iterator
from contextlib import suppress
from functools import cache
from importlib import import_module
from pathlib import Path

from filtering.errors import listed
from sequences.datasets import layouts
from sequences.datasets.layout import INTRINSICS_LEVELS, Layout, PosedImages
from sequences.datasets.layout_helpers.image_files import images_in
from sequences.datasets.layout_helpers.packed import VIDEO_SUFFIXES, PackedImage
from sequences.errors import SequenceError
from sequences.files import unused_part
from sequences.outputs import own_manifest
from sequences.recordings.recording_file import SUFFIXES

_NAMED = 3  # recordings and data sets in a folder, in an error


@cache
def find_layouts() -> tuple[Layout, ...]:
    """All layouts, in their order; they are imported by the first call."""
    names = [f"{layouts.__name__}.{module.name}" for module in pkgutil.iter_modules(layouts.__path__)]
    return tuple(sorted((import_module(name).LAYOUT for name in names), key=lambda layout: layout.order))


def list_images(path: Path) -> PosedImages:
    """Images and true poses of a data set, none of them read yet.

    Args:
        path: A folder of any of the `sequences.datasets.layouts`; or a file: by which 7-Scenes or Cambridge Landmarks
            list a split, such as `chess/TrainSplit.txt` or `ShopFacade/dataset_test.txt`, an `.r3d`, or nerfstudio's
            `transforms_train.json`.

    Raises:
        SequenceError: the layout is unknown, a file is missing or damaged, or no image has a true pose.
    """
    path = Path(path)
    images = found_images(path)
    if images is None:
        raise SequenceError(f"{path}: {what_is_there(path)}")
    if not len(images):
        raise SequenceError(f"{path}: no image with a true pose: {dict(images.skipped)}; expected at least one")
    return images


def as_typed(frames: slice) -> str:
    """Numbers of images as START:STOP, or START:STOP:STEP."""
    bounds = [frames.start, frames.stop, *([] if frames.step is None else [frames.step])]
    return ":".join("" if bound is None else str(bound) for bound in bounds)


def none_among(frames: slice, count: int | None, *, posed: bool = True) -> str:
    """That no image has such a number, and which numbers there are, of `count` in all; None if unknown.

    `posed`: only images with a true pose are counted.
    """
    there = f"; there are {count}, numbered 0 to {count - 1}" if count else ", expected at least one"
    return f"no image{' with a true pose' * posed} in frames {as_typed(frames)}{there}"


def clipped(frames: slice, count: int) -> str | None:
    """That fewer images were found than were asked for, of `count` in all; None where all are there."""
    if frames.stop is None or frames.stop <= count or count <= (first := frames.start or 0):
        return None
    taken = f"{first} to {count - 1} were" if first < count - 1 else f"{first} was"
    return f"images {as_typed(frames)} were asked for, and there are {count}, numbered 0 to {count - 1}: {taken} taken"


def is_data_set(path: Path) -> bool:
    """Whether a folder is of a known layout. Raises SequenceError where a file of it is missing or damaged."""
    return found_images(path) is not None


def found_images(path: Path) -> PosedImages | None:
    """As `list_images`, of which no image may have a true pose; None where a path is of no known layout."""
    return next((images for layout in find_layouts() if (images := layout.list_images(path)) is not None), None)


def is_list(path: Path) -> bool:
    """Whether a path is named like a file by which some layout lists what lies beside it."""
    return any(path.suffix in layout.list_suffixes for layout in find_layouts())


def files_read(path: Path) -> Iterator[Path]:
    """Files and folders that a recording or data set is read from, for outputs: they must be none of these.

    For a data set: its folder or the folder of the list, its images and their folders, and `intrinsics.json` above it.
    Where it cannot be read: as far as known.
    """
    path = Path(path)
    yield path
    if is_recording(path):
        return
    folder = path.parent if is_list(path) else path
    yield folder
    yield from (above / "intrinsics.json" for above in folder.absolute().parents[:INTRINSICS_LEVELS])
    with suppress(SequenceError):
        files = list_images(path).files
        yield from dict.fromkeys(file.path if isinstance(file, PackedImage) else file for file in files)
        yield from {file.parent for file in files if not isinstance(file, PackedImage)}


def require_recording(path: Path) -> None:
    """Raise SequenceError where a folder is no rosbag2 folder; the message has what was looked for beside images."""
    if path.is_dir() and not is_recording(path):
        raise SequenceError(f"{path}: {what_is_there(path, images=True)}")


def what_is_there(path: Path, *, images: bool = False) -> str:
    """What a path has that can be neither trained on nor, where images alone would do, localized: part of an error."""
    no_poses = f"images without true poses (`vapor-track map {shlex.quote(str(path))} --output place/` makes them)"
    if _is_video(path):
        return no_poses
    if path.is_file():
        return "is a file, expected the folder of a data set or the list of a split"
    found = "no sequence or data set" if path.exists() else f"no such folder or file{unused_part(path)}"
    if (results := own_manifest(path)) is not None:
        return f"{found}, but results of `{results['command']}`; expected what they were made from"
    names = dict.fromkeys(name for layout in find_layouts() for name in layout.splits)
    folders_first = sorted(names, key=lambda name: "." in name)
    if splits := [name for name in folders_first if (path / name).exists()]:
        return f"{found}, perhaps its {' or '.join(splits)} is meant"
    if inside := _found_inside(path):
        pieces = sum(each.suffix in SUFFIXES for each in inside) > 1
        reindexed = " (where they are pieces of one recording, `ros2 bag reindex` writes its metadata.yaml)" * pieces
        return f"{found} itself; expected what is in it: {listed((each.name for each in inside), _NAMED)}{reindexed}"
    looked_for = (
        f"looked for {'a video, PNG or JPEG images, ' * images}{', '.join(SUFFIXES)}, metadata.yaml,"
        f" {', '.join(layout.looked_for for layout in find_layouts())}"
    )
    if not images_in(path):
        return f"{found}; {looked_for}"
    above = path.parent if path.parent.name else path.absolute().parent
    with suppress(SequenceError):
        if is_data_set(above):
            return f"images of a data set, expected its folder, which has their true poses: {above}"
    return f"{no_poses}; {looked_for}"


def _found_inside(folder: Path) -> list[Path]:
    """Recordings and data sets directly in a folder; none where there is no such folder."""
    with suppress(OSError):
        entries = sorted(entry for entry in folder.iterdir() if not entry.name.startswith("."))
        return [entry for entry in entries if _is_sequence(entry)]
    return []


def _is_sequence(path: Path) -> bool:
    if path.is_file():
        return path.suffix in SUFFIXES
    try:
        return is_recording(path) or is_data_set(path)
    except SequenceError:  # a damaged one
        return True


def is_recording(path: Path) -> bool:
    """Whether a path is taken for an MCAP file or rosbag2 folder, rather than images on disk or the list of a split."""
    if not path.is_file():
        return (path / "metadata.yaml").is_file()
    if path.suffix in SUFFIXES:  # no layout needs to be asked
        return True
    if _is_video(path):
        return False
    return not any(path.suffix in (*layout.list_suffixes, *layout.archive_suffixes) for layout in find_layouts())


def _is_video(path: Path) -> bool:
    return path.suffix.lower() in VIDEO_SUFFIXES and path.is_file()
