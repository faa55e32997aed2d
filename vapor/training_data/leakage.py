"""Leakage: images that are trained on and held out as well."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from itertools import combinations, product
from math import inf
from pathlib import Path

from sequences.datasets.layout_helpers.packed import ImageFile
from sequences.datasets.listing import is_recording, list_images
from sequences.recordings.bag import bag_files
from vapor.training_data.entries import parse_entry
from vapor.training_data.training_set import TrainingError


def require_no_leakage(data: Sequence[Path | str], held_out: Sequence[Path | str] | None = None) -> None:
    """Refuse held-out images that are trained on: the same files, or the same frames of one recording.

    Args:
        data: Each `PATH` or `PATH@START:STOP`.
        held_out: Likewise; None where the last part of each of `data` is held out: then no two may share images.

    Raises:
        TrainingError: two share images, or what follows an @ is not a range.
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
                f"{other}: shares images with {entry}, which is trained on; expected none of them to be held out"
            )


def _source(entry: Path | str) -> tuple[Path, slice]:
    """Where `PATH` or `PATH@START:STOP` lies once links are followed, and which frames of it."""
    path, frames = parse_entry(entry)
    return path.resolve(), frames


def _files(entry: Path | str) -> set[ImageFile]:
    """Image files of `PATH` or `PATH@START:STOP`; of a recording all files that it is made of, for any frames."""
    path, frames = parse_entry(entry)
    files = bag_files(path) if is_recording(path) else list_images(path)[frames].files
    return {file.resolve() for file in files}
