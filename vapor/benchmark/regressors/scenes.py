"""Scenes to train and test on, rendered where they are synthetic, and what identifies them."""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from sequences.datasets.listing import is_list
from sequences.synthesize import SYNTHESIS, synthesize, write_synthetic
from vapor.parallel.jobs import Workers, in_parallel
from vapor.storage import absent, is_url, published, url_of
from vapor.training_data.entries import parse_entry

_LEAST_HEIGHT, _SPARE = 96, 1.4  # of rendered images: pixels, and times what covers a frame


@dataclass(frozen=True)
class Scene:
    """What networks are trained on and tested on.

    Attributes:
        name: For people, and for names of files.
        train: Files and folders, as `vapor-track train` takes them.
        test: Likewise; no image of them is trained on.
    """

    name: str
    train: tuple[str, ...]
    test: tuple[str, ...]

    @property
    def anywhere(self) -> Scene:
        """The same scene for processes elsewhere: by absolute paths, and by URLs where these are copies of some."""
        return Scene(self.name, *(tuple(map(_anywhere, entries)) for entries in (self.train, self.test)))


def _anywhere(entry: str) -> str:
    path = Path(entry).absolute()
    return entry if is_url(entry) else url_of(path) or str(path)


def identities(entries: Sequence[str]) -> list[list[str | int]]:
    """What tells each of some files and folders from others and from itself after a change."""
    return [identity(entry) for entry in entries]


def identity(entry: str) -> list[str | int]:
    """Where an entry lies, and sizes and times of change of its files: of a folder or a split, all of the folder."""
    place = _anywhere(entry)
    path, _ = parse_entry(place)
    folder = path.parent if is_list(path) else path
    walked = (Path(at, name) for at, _, names in os.walk(folder, followlinks=True) for name in names)
    about: list[list[str | int]] = []
    for file in sorted(walked if folder.is_dir() else [path]):
        with suppress(FileNotFoundError):
            stat = file.stat()
            about.append([os.path.relpath(file, folder), stat.st_size, stat.st_mtime_ns])
    content = hashlib.sha256(json.dumps(about).encode()).hexdigest()
    return [place if is_url(place) else str(Path(entry).resolve()), len(about), content]


def render_scenes(
    names: Sequence[str],
    directory: Path,
    *,
    train_walks: int,
    train_frames: int,
    test_walks: int,
    test_frames: int,
    height: int,
    workers: Workers,
) -> Iterator[tuple[int, int, list[Scene]]]:
    """Render what is missing of synthetic scenes; yields the number of walks done, of all, and the scenes they make.

    Args:
        names: Of synthetic scenes.
        directory: Sequences lie in its `images`.
        train_walks: Sequences to train on, of `train_frames` images each, seeds from 0.
        train_frames: See there.
        test_walks: Sequences to test on, of `test_frames` images each.
        test_frames: See there.
        height: Of the images, pixels; they are 4:3.
        workers: Where they are rendered.
    """
    size = round(height * 4 / 3), height
    folder = directory / "images"
    folder.mkdir(parents=True, exist_ok=True)
    walks = {
        name: {
            split: [
                (
                    folder / f"{name}-{split}-{seed}-{frames}-{size[0]}x{size[1]}-{SYNTHESIS}.mcap",
                    name,
                    split,
                    seed,
                    frames,
                )
                for seed in range(number)
            ]
            for split, number, frames in (("train", train_walks, train_frames), ("test", test_walks, test_frames))
        }
        for name in names
    }
    scenes = [Scene(n, *(tuple(str(w[0]) for w in w[split]) for split in ("train", "test"))) for n, w in walks.items()]
    every = [walk for splits in walks.values() for some in splits.values() for walk in some]
    lacking = absent([walk[0] for walk in every], folder)
    missing = [(*walk, size) for walk in every if walk[0] in lacking]
    yield len(every) - len(missing), len(every), scenes
    for done, _ in enumerate(in_parallel(_render, missing, workers), len(every) - len(missing) + 1):
        yield done, len(every), scenes


def rendered_height(frame_size: tuple[int, int]) -> int:
    """Height of 4:3 images that cover a frame (width, height) when they are scaled down, pixels."""
    return max(_LEAST_HEIGHT, math.ceil(_SPARE * max(frame_size[1], frame_size[0] * 3 / 4)))


def _render(
    file: Path, scene: str, split: Literal["train", "test"], seed: int, frames: int, size: tuple[int, int]
) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)  # a worker may have no copy of the folder yet
    write_synthetic(synthesize(scene, seed=seed, num_frames=frames, split=split, width=size[0], height=size[1]), file)
    published(file)
