"""Points of a reconstruction, and where its images show them: as COLMAP's models state it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float64, Int64

from sequences.datasets.layout_helpers.packed import ImageFile
from sequences.frame import Camera
from sequences.images.undistortion import Lens, rays_of

_MOST = 20_000_000
"""Sightings of a model, in all; 24 bytes each."""
POINTS_OF_A_MODEL = 2**32
"""Those of another model are numbered from another multiple of this."""


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
        notices: What a person should know of what was left out.
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
    """What images show of the points of a model, without what cannot be.

    Left out, counted and said are sightings that are not finite, lie outside of their image or where its distortion
    folds, or are of a point that is not known. Of a model with more than 20 million sightings none is used.

    Args:
        where: Begins notices.
        stated: What the model says of each image.
        known: Ids of the points that there are.
        undistort: Whether images are undistorted.
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
