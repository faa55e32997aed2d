"""Points of a reconstruction that images show -> which of our features show them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Int64
from scipy.spatial import KDTree

from sequences.datasets.points import POINTS_OF_A_MODEL, SeenPoints
from vapor.landmarks.features import Features
from vapor.landmarks.tracks import Matches
from vapor.landmarks.view_camera import ViewCamera

_NEAR_PX = 1.0  # a feature so near to where a point is seen shows it


def at_given_points(
    features: Features, given: SeenPoints | None, camera: ViewCamera
) -> tuple[Features, Int64[np.ndarray, " n"]]:
    """The features of an image, where it is given that they are, and which point each shows; −1 for none, (n,).

    A feature shows the nearest point that is seen within a pixel, a point is shown by the feature nearest to it. Where
    the point is seen says the reconstruction more exactly, as it was made of larger images.

    Args:
        features: Of the image.
        given: Points that the image shows; None for none.
        camera: That is stated for the image.
    """
    points = np.full(len(features), -1)
    if given is None or not len(given.point) or not len(features):
        return features, points
    seen_at = given.rays * camera.focal + camera.centre
    found = KDTree(features.pixels).query(seen_at, distance_upper_bound=_NEAR_PX)
    away, feature = (np.asarray(each) for each in found)
    order = np.argsort(away, kind="stable")
    order = order[np.isfinite(away[order])]
    order = order[np.unique(given.point[order], return_index=True)[1]]  # of a point seen twice the nearer
    order = order[np.argsort(away[order], kind="stable")]
    order = order[np.unique(feature[order], return_index=True)[1]]
    points[feature[order]] = given.point[order]
    pixels = features.pixels.copy()
    pixels[feature[order]] = seen_at[order]
    return replace(features, pixels=pixels), points


def with_given_points(matches: Matches, points: Sequence[Int64[np.ndarray, " n"]]) -> Matches:
    """Matches of views, in which features match that show the same point, and none that show two of one model.

    Args:
        matches: Of pairs of views, as their features look.
        points: Which point each feature of each view shows, −1 for none.
    """
    joined = {}
    for (i, j), (a, b) in matches.items():
        one, other = points[i][a], points[j][b]
        fine = (one < 0) | (other < 0) | (one == other) | (one // POINTS_OF_A_MODEL != other // POINTS_OF_A_MODEL)
        joined[i, j] = a[fine], b[fine]
    view = np.repeat(np.arange(len(points)), [len(each) for each in points])
    feature = np.concatenate([np.empty(0, np.int64), *(np.arange(len(each)) for each in points)])
    point = np.concatenate([np.empty(0, np.int64), *points])
    order = np.flatnonzero(point >= 0)
    order = order[np.lexsort((view[order], point[order]))]
    follows = np.flatnonzero(np.diff(point[order]) == 0)
    first, second = order[follows], order[follows + 1]
    pair = view[first] * len(points) + view[second]
    order = np.argsort(pair, kind="stable")
    for some in np.split(order, np.flatnonzero(np.diff(pair[order])) + 1):
        if len(some):
            i, j = int(view[first[some[0]]]), int(view[second[some[0]]])
            before = joined.get((i, j), (np.empty(0, np.int64), np.empty(0, np.int64)))
            new = feature[first[some]], feature[second[some]]
            both = np.concatenate([np.stack(before), np.stack(new)], axis=1)
            joined[i, j] = tuple(np.unique(both, axis=1))
    return joined
