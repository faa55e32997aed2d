"""The sparse points of a data set that is a COLMAP model: `points3D.bin` or `points3D.txt` beside its images."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import isfinite
from pathlib import Path

import numpy as np
from jaxtyping import Float64, Int64, UInt8

from sequences.datasets.layout_helpers.colmap_binary import LARGEST_ID, point_rows
from sequences.errors import SequenceError
from sequences.files.text import read_lines
from sequences.values import parse_numbers, parse_whole

_COLUMNS = "POINT3D_ID X Y Z R G B ERROR TRACK[]"
_BRIGHTEST = 255


@dataclass(frozen=True)
class ScenePoints:
    """Points of a place.

    Attributes:
        positions: In the world, in the unit of the poses, (n, 3).
        colors: RGB, (n, 3).
    """

    positions: Float64[np.ndarray, "n 3"]
    colors: UInt8[np.ndarray, "n 3"]

    def __len__(self) -> int:
        return len(self.positions)


def scene_points(path: Path) -> ScenePoints | None:
    """Sparse points of a data set; None where it has none.

    Args:
        path: The data set: a folder with a COLMAP model, in itself, in `sparse/0` or in `sparse`.

    Raises:
        SequenceError: the file cannot be read, is cut off, or a line of it is damaged.
    """
    for model in (path, path / "sparse" / "0", path / "sparse"):
        for suffix in (".bin", ".txt"):
            file = model / f"points3D{suffix}"
            if file.is_file() and (model / f"images{suffix}").is_file():
                return read_points(file)
    return None


def read_points(file: Path) -> ScenePoints:
    """The points of a `points3D.bin` or `points3D.txt`; those that are not finite are left out.

    Raises:
        SequenceError: it cannot be read, is cut off, or a line of it is damaged.
    """
    table = np.array([row[1:] for row in _rows(file)], np.float64).reshape(-1, 6)
    table = table[np.isfinite(table).all(axis=1)]
    return ScenePoints(table[:, :3], np.clip(table[:, 3:], 0, _BRIGHTEST).astype(np.uint8))


def point_ids(file: Path) -> Int64[np.ndarray, " n"]:
    """POINT3D_ID of each point of a `points3D.bin` or `points3D.txt` that is finite, as they come.

    Raises:
        SequenceError: it cannot be read, is cut off, or a line of it is damaged.
    """
    return np.fromiter((row[0] for row in _rows(file) if all(map(isfinite, row[1:]))), np.int64)


def _rows(file: Path) -> Iterator[tuple[int, *tuple[float, ...]]]:
    for _, row in point_rows(file) if file.suffix == ".bin" else _text_rows(file):
        yield row


def _text_rows(file: Path) -> Iterator[tuple[int, tuple[int, *tuple[float, ...]]]]:
    for number, line in read_lines(file, most=None):  # the images that show each point make it large
        fields = line.split(maxsplit=8)
        if not fields or fields[0].startswith("#"):
            continue
        where = f"{file}:{number}"
        if len(fields) < 8:
            raise SequenceError(f"{where}: {len(fields)} columns, expected `{_COLUMNS}`")
        expected = f"those of `{_COLUMNS}`"
        point_id = parse_whole(fields[0], f"{where}: POINT3D_ID", 0, LARGEST_ID)
        yield number, (point_id, *parse_numbers(fields[1:7], where, expected))
