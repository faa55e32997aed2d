"""Points of a COLMAP model, and where its images show them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from math import isfinite
from pathlib import Path

import numpy as np
from jaxtyping import Float64, Int64, UInt8

from sequences.datasets.layout_helpers.colmap_binary import LARGEST_ID, point_rows
from sequences.datasets.layout_helpers.packed import ImageFile
from sequences.errors import SequenceError
from sequences.files import read_lines
from sequences.frame import Camera
from sequences.images.undistortion import Lens, rays_of
from sequences.values import parse_numbers, parse_whole

_MOST = 20_000_000
"""Sightings of a model, in all; 24 bytes each."""
POINTS_OF_A_MODEL = 2**32
"""Those of another model are numbered from another multiple of this."""
_COLUMNS = "POINT3D_ID X Y Z R G B ERROR TRACK[]"
_BRIGHTEST = 255


@dataclass(frozen=True)
class SeenPoints:
    """Which points one image shows, and where.

    Attributes:
        point: Their numbers, from 0, or for another model from another multiple of `POINTS_OF_A_MODEL`, (k,).
        rays: x and y of the rays (x, y, 1) to them in the camera's frame, (k, 2): whatever is done to its pixels.
    """

    point: Int64[np.ndarray, " k"]
    rays: Float64[np.ndarray, "k 2"]


@dataclass(frozen=True)
class PointsOfImages:
    """The points that images show.

    Attributes:
        of: By the image.
        notices: Sentences on skipped rows and images.
    """

    of: Mapping[ImageFile, SeenPoints] = field(default_factory=dict)
    notices: tuple[str, ...] = ()


ReadPoints = Callable[[bool], PointsOfImages]
"""Reads the points of a data set; its argument is whether images are undistorted."""

Stated = tuple[ImageFile, Camera | Lens, Float64[np.ndarray, "k 2"], Int64[np.ndarray, " k"]]
"""An image, its camera, and pixels and ids of the points that it shows, 0 at the centre of the first pixel."""


def seen_points(
    where: str, stated: Iterable[Stated], known: Int64[np.ndarray, " p"], undistort: bool
) -> PointsOfImages:
    """Sightings of the points of a model whose ids are `known`; `where` begins notices.

    Sightings are left out and counted that are not finite, outside of their image, where its distortion folds, or of an
    unknown point. A model with more than 20 million sightings gives none.
    """
    found: dict[ImageFile, SeenPoints] = {}
    known = np.unique(known)
    total = kept = 0
    for file, camera, pixels, point in stated:
        pinhole = camera.camera if isinstance(camera, Lens) else camera
        total += len(point)
        if total > _MOST:
            return PointsOfImages({}, (f"{where}: more than {_MOST} sightings of points, so none is used",))
        inside = ((pixels >= -0.5) & (pixels <= (pinhole.width - 0.5, pinhole.height - 0.5))).all(axis=1)  # none if NaN
        at = np.searchsorted(known, point)
        fine = inside & (known[np.minimum(at, len(known) - 1)] == point) if len(known) else np.zeros(len(point), bool)
        rays = rays_of(pixels[fine], camera if undistort else pinhole)
        usable = np.isfinite(rays).all(axis=1)
        kept += int(usable.sum())
        found[file] = SeenPoints(at[fine][usable], rays[usable])
    if kept == total:
        return PointsOfImages(found)
    left_out = f"{total - kept} of {total} sightings of points left out: outside of their image, or of unknown points"
    return PointsOfImages(found, (f"{where}: {left_out}",))


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
    """Sparse points of a data set with a COLMAP model, in itself, in `sparse/0` or in `sparse`; None where it has none.

    Raises SequenceError where the file cannot be read, is cut off, or a line of it is damaged.
    """
    for model in (path, path / "sparse" / "0", path / "sparse"):
        for suffix in (".bin", ".txt"):
            file = model / f"points3D{suffix}"
            if file.is_file() and (model / f"images{suffix}").is_file():
                return read_points(file)
    return None


def read_points(file: Path) -> ScenePoints:
    """The points of a `points3D.bin` or `points3D.txt`; those that are not finite are left out.

    Raises SequenceError where it cannot be read, is cut off, or a line of it is damaged.
    """
    table = np.array([row[1:] for row in _point_rows(file)], np.float64).reshape(-1, 6)
    table = table[np.isfinite(table).all(axis=1)]
    return ScenePoints(table[:, :3], np.clip(table[:, 3:], 0, _BRIGHTEST).astype(np.uint8))


def point_ids(file: Path) -> Int64[np.ndarray, " n"]:
    """POINT3D_ID of each point of a `points3D.bin` or `points3D.txt` that is finite, as they come.

    Raises SequenceError where it cannot be read, is cut off, or a line of it is damaged.
    """
    return np.fromiter((row[0] for row in _point_rows(file) if all(map(isfinite, row[1:]))), np.int64)


def _point_rows(file: Path) -> Iterator[tuple[int, *tuple[float, ...]]]:
    if file.suffix == ".bin":
        yield from point_rows(file)
        return
    for number, line in read_lines(file, most=None):  # the images that show each point make it large
        fields = line.split(maxsplit=8)
        if not fields or fields[0].startswith("#"):
            continue
        where = f"{file}:{number}"
        if len(fields) < 8:
            raise SequenceError(f"{where}: {len(fields)} columns, expected `{_COLUMNS}`")
        expected = f"those of `{_COLUMNS}`"
        point_id = parse_whole(fields[0], f"{where}: POINT3D_ID", 0, LARGEST_ID)
        yield point_id, *parse_numbers(fields[1:7], where, expected)
