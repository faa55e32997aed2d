"""Data as named on the command line, `PATH` or `PATH@START:STOP`: their frames, and images that two of them share."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator, Sequence
from functools import cache
from itertools import combinations, product
from math import inf
from pathlib import Path

from sequences.datasets import listing
from sequences.datasets.frames import posed_frames
from sequences.datasets.layout_helpers.packed import ImageFile
from sequences.datasets.listing import is_recording, list_images
from sequences.frame import Frame
from sequences.options import OdometryUse, SequenceOptions
from sequences.recordings.bag import bag_files
from vapor.training_data.training_set import TrainingError


def open_sequences(
    data: Sequence[Path | str],
    reading: SequenceOptions | None = None,
    odometry: OdometryUse = "optional",
    usual_cameras: Sequence[str] = (),
) -> dict[str, Iterable[Frame]]:
    """Frames of each `PATH` or `PATH@START:STOP`, by a name without its folder; cameras are as in `posed_frames`.

    Raises:
        TrainingError: the text after the @ is not a range.
    """
    return {
        name: posed_frames(path, frames=frames, options=reading, odometry=odometry, usual_cameras=usual_cameras)
        for name, (path, frames) in name_entries(data).items()
    }


def name_entries(data: Sequence[Path | str]) -> dict[str, tuple[Path, slice]]:
    """Path and frames of each `PATH` or `PATH@START:STOP`, by a name without its folder.

    Raises:
        TrainingError: the text after the @ is not a range.
    """
    named: dict[str, tuple[Path, slice]] = {}
    for number, entry in enumerate(data):
        path, frames = parse_entry(entry)
        parts = as_entry(entry).parts[-2 if listing.is_list(path) else -1 :]  # lists of splits are all named alike
        name = "/".join(parts)
        named[name if name not in named else f"{name} ({number + 1})"] = path, frames
    return named


def as_entry(entry: Path | str) -> Path:
    """`PATH` or `PATH@START:STOP` without a slash before the @, as completion leaves one: its last part is its name."""
    return Path(re.sub(r"(?<=[^/])/+(?=@\d*:\d*$)", "", str(entry)))


def parse_entry(entry: Path | str) -> tuple[Path, slice]:
    """Path and frames of `PATH` or `PATH@START:STOP`; all frames of a path that exists as it stands.

    Raises:
        TrainingError: the text after the @ is not a range.
    """
    if os.path.exists(entry):
        return Path(entry), slice(None)
    match = re.fullmatch(r"(?P<path>.+)@(?P<start>\d*):(?P<stop>\d*)", str(entry))
    if match:
        start, stop = int(match["start"] or 0), int(match["stop"]) if match["stop"] else None
        if stop is not None and stop <= start:
            raise TrainingError(f"{entry}: @{start}:{stop} has no image, expected START:STOP with STOP above START")
        return Path(match["path"]), slice(start, stop)
    before, at, part = str(entry).rpartition("@")
    if at and (re.fullmatch("[^/]*:[^/]*", part) or (before and Path(before).exists())):
        raise TrainingError(
            f"{entry}: @{part} is no part, expected @START:STOP, whole numbers of which one may be left out"
        )
    return Path(entry), slice(None)


def files_read(data: Sequence[Path | str], reading: SequenceOptions | None = None) -> Iterator[Path]:
    """Files and folders that the data are read from; an output must not be one of these.

    Raises:
        TrainingError: the text after an @ is not a range.
    """
    for entry in data:
        yield from listing.files_read(parse_entry(entry)[0])
    yield from () if reading is None else reading.files_read


def require_no_leakage(data: Sequence[Path | str], held_out: Sequence[Path | str] | None = None) -> None:
    """Refuse held-out images that are trained on: the same files, or the same frames of one recording.

    Without `held_out`, parts of `data` are held out, and no two of these may share images.

    Raises:
        TrainingError: two share images, or the text after an @ is not a range.
        SequenceError: unreadable data.
    """
    source, files = cache(_source), cache(_files)
    for entry, other in combinations(data, 2) if held_out is None else product(data, held_out):
        (path, frames), (its_path, its_frames) = source(entry), source(other)
        if path == its_path:
            stop = min(inf if part.stop is None else part.stop for part in (frames, its_frames))
            shared = max(frames.start or 0, its_frames.start or 0) < stop
        else:
            shared = not files(entry).isdisjoint(files(other))
        if shared:
            raise TrainingError(
                f"{other}: shares images with {entry}; expected each image once, trained on or held out"
            )


def _source(entry: Path | str) -> tuple[Path, slice]:
    """The resolved path, and the frames, of `PATH` or `PATH@START:STOP`."""
    path, frames = parse_entry(entry)
    return path.resolve(), frames


def _files(entry: Path | str) -> set[ImageFile]:
    """Image files of `PATH` or `PATH@START:STOP`; of a recording all its files, for any frames."""
    path, frames = parse_entry(entry)
    files = bag_files(path) if is_recording(path) else list_images(path)[frames].files
    return {file.resolve() for file in files}
