"""Features of views of known pose -> sightings of points: matched where poses state that views show the same."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float64, Int64
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from filtering.se3 import Poses
from sequences.datasets.points import POINTS_OF_A_MODEL, SeenPoints
from vapor.landmarks.features import Features, mutual_matches
from vapor.landmarks.landmark_map import ViewCamera
from vapor.landmarks.points import Sightings

Matches = dict[tuple[int, int], tuple[np.ndarray, np.ndarray]]
"""Of pairs of views, by their numbers: which features of the one, (k,), match which of the other, (k,)."""

RATIO = 0.85
"""Of the distances of nearest and second nearest feature, in a match of two views."""
_PARTNERS = 14  # matched views of each view
_AS_FAR, _TURNED = 0.5, np.deg2rad(25.0)  # in depths: views that differ by as much show as much of the same
_LEAST_BASELINE = 0.03  # in depths
_MOST_TURNED = np.deg2rad(50.0)
_TRIED = 12  # views from which depths are measured
_RANKS = 1, 2, 4, 8, 16, 32  # of their neighbours
_LEAST_PARALLAX = np.deg2rad(2.0)
_FARTHEST = 20.0  # depths: nothing that is further away is a landmark
_CHUNK = 256
_NEAR_PX = 1.0  # a feature so near to where a point is seen shows it


def view_change(poses: Poses, depth_m: float) -> Float64[np.ndarray, " n"]:
    """Change of the view since the pose before, (n,): 1 for half a depth moved, and for 25° turned."""
    change = np.zeros(len(poses))
    if len(poses) > 1:
        metres, turned = poses[:-1].distance(poses[1:])
        change[1:] = metres / (_AS_FAR * depth_m) + turned / _TURNED
    return change


def neighbours(poses: Poses, depth_m: float, *, most: int = _PARTNERS) -> Iterator[tuple[int, Int64[np.ndarray, " k"]]]:
    """Each view with at most `most` other views that show most of the same from elsewhere."""
    for begin in range(0, len(poses), _CHUNK):
        own = np.arange(begin, min(begin + _CHUNK, len(poses)))
        pairs = np.indices((len(own), len(poses)))
        metres, turned = poses[own[pairs[0]]].distance(poses[pairs[1]])
        cost = metres / (_AS_FAR * depth_m) + turned / _TURNED
        cost[(metres < _LEAST_BASELINE * depth_m) | (turned > _MOST_TURNED)] = np.inf
        count = min(most, cost.shape[1])
        nearest = np.argpartition(cost, count - 1, axis=1)[:, :count]
        for row, columns in enumerate(nearest):
            yield begin + row, columns[np.isfinite(cost[row, columns])]


def typical_depth_m(
    poses: Poses, features: Callable[[int], Features], camera: ViewCamera, *, scale_m: float
) -> float | None:
    """Median distance of what views show, metres; None where no two views show the same from two sides.

    Args:
        poses: world_from_camera, (n,), in order of time.
        features: Gives the features of a view, by its number.
        camera: Camera of the views.
        scale_m: Initial distance that changes a view as much as a radian.
    """
    depths: list[Float64[np.ndarray, " k"]] = []
    for i in np.unique(np.linspace(0, len(poses) - 1, min(_TRIED, len(poses))).astype(np.int64)).tolist():
        metres, turned = (each for each in poses[i].distance(poses))
        cost = np.where((metres > 0.0) & (turned < np.pi / 6), metres / scale_m + turned, np.inf)
        order = np.argsort(cost, kind="stable")
        for rank in _RANKS:
            if rank <= len(order) and np.isfinite(cost[order[rank - 1]]):
                depths.append(_depths(poses, i, int(order[rank - 1]), features, camera))
    found = np.concatenate([np.empty(0), *depths])
    return float(np.median(found)) if len(found) else None


def _depths(
    poses: Poses, i: int, j: int, features: Callable[[int], Features], camera: ViewCamera
) -> Float64[np.ndarray, " k"]:
    one, other = features(i), features(j)
    a, b = mutual_matches(one.descriptors, other.descriptors, RATIO)
    if not len(a):
        return np.empty(0)
    here, there = (_bearings(camera.rays(each.pixels[k])) for each, k in ((one, a), (other, b)))
    towards = there @ poses[j].rotation.T @ poses[i].rotation  # in the frame of view i
    baseline = poses[i].inverse().apply(poses[j].translation)
    across = np.cross(here, towards)
    squared = np.vecdot(across, across)
    enough = squared > np.sin(_LEAST_PARALLAX) ** 2
    # along · here meets baseline + t · towards where both are nearest; it is off by what is along `across`.
    along = np.vecdot(np.cross(baseline, towards), across) / np.maximum(squared, 1e-12)
    off = np.abs(across @ baseline) / np.sqrt(np.maximum(squared, 1e-12))
    good = enough & (along > 0.0) & (off < 0.02 * along)
    return (along * here[:, 2])[good]


def _bearings(rays: Float64[np.ndarray, "n 2"]) -> Float64[np.ndarray, "n 3"]:
    full = np.concatenate([rays, np.ones((len(rays), 1))], axis=1)
    return full / np.linalg.norm(full, axis=1, keepdims=True)


def epipolar_errors(
    first: Float64[np.ndarray, "k 2"],
    second: Float64[np.ndarray, "k 2"],
    second_from_first: Poses,
) -> Float64[np.ndarray, " k"]:
    """Sampson distances of the x and y of rays of two views, in units of the rays (times the focal length: pixels)."""
    x, y, z = second_from_first.translation / max(float(np.linalg.norm(second_from_first.translation)), 1e-300)
    essential = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]) @ second_from_first.rotation
    one, other = (np.concatenate([rays, np.ones((len(rays), 1))], axis=1) for rays in (first, second))
    line, back = one @ essential.T, other @ essential
    squares = np.square(line[:, :2]).sum(axis=1) + np.square(back[:, :2]).sum(axis=1)
    return np.abs(np.vecdot(other, line)) / np.sqrt(np.maximum(squares, 1e-300))


def inverse_distances(
    first: Float64[np.ndarray, "k 2"],
    second: Float64[np.ndarray, "k 2"],
    second_from_first: Poses,
) -> tuple[Float64[np.ndarray, " k"], Float64[np.ndarray, " k"]]:
    """Inverse distance in the first view where rays of two views meet, 1/m, and its change by a radian."""
    here, there = _bearings(first), _bearings(second)
    across = np.cross(there, second_from_first.translation)  # there × (R here + t / distance) = 0
    length = np.linalg.norm(across, axis=1)
    turned = np.cross(there, here @ second_from_first.rotation.T)
    found = -np.vecdot(across, turned) / np.maximum(np.square(length), 1e-300)
    return found, 1.0 / np.maximum(length, 1e-300)


def find_sightings(
    poses: Poses, features: Sequence[Features], camera: ViewCamera, matches: Matches, *, depth_m: float, most_px: float
) -> tuple[Sightings, Float64[np.ndarray, " e"]]:
    """Sightings of points by matches of n views, and the epipolar errors of all matches, pixels.

    Rays that meet behind the first camera, or far beyond the scene, have an infinite error: they show two points that
    look alike, such as parallel rays on two storeys. Matches with an error above `most_px` are dropped.
    """
    offset = np.concatenate([[0], np.cumsum([len(each) for each in features])])
    rays = [camera.rays(each.pixels) for each in features]
    pixel = float(camera.focal.mean())
    firsts, seconds = [np.empty(0, np.int64)], [np.empty(0, np.int64)]
    errors = [np.empty(0)]
    camera_from_world = poses.inverse()
    for (i, j), (a, b) in matches.items():
        second_from_first = camera_from_world[j] @ poses[i]
        away = pixel * epipolar_errors(rays[i][a], rays[j][b], second_from_first)
        inverse, by_angle = inverse_distances(rays[i][a], rays[j][b], second_from_first)
        away[inverse + by_angle * most_px / pixel < 1.0 / (_FARTHEST * depth_m)] = np.inf
        good = away < most_px
        errors.append(away)
        firsts.append(offset[i] + a[good])
        seconds.append(offset[j] + b[good])
    total = int(offset[-1])
    first, second = np.concatenate(firsts), np.concatenate(seconds)
    graph = coo_matrix((np.ones(len(first), np.int8), (first, second)), shape=(total, total))
    _, label = connected_components(graph, directed=False)
    feature = np.flatnonzero(np.bincount(label, minlength=total)[label] >= 2)
    view = np.searchsorted(offset, feature, side="right") - 1
    # Of a point that a view shows twice, the first is taken.
    _, once = np.unique(label[feature] * len(poses) + view, return_index=True)
    feature, view = feature[once], view[once]
    _, point = np.unique(label[feature], return_inverse=True)
    pixels = np.concatenate([np.empty((0, 2)), *(each.pixels for each in features)])[feature]
    found = Sightings(view, point, feature, pixels)
    return found.kept(np.ones(len(found), bool))[0], np.concatenate(errors)


def at_given_points(
    features: Features, given: SeenPoints | None, camera: ViewCamera
) -> tuple[Features, Int64[np.ndarray, " n"]]:
    """The features of an image at the exact pixels of given points, and the point that each shows; −1 for none, (n,).

    A feature shows the nearest point within a pixel, and a point is shown by the nearest feature.
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
    """Matches of views with features that show the same point, and without those that show two points of one model.

    `points` has the point of each feature of each view, −1 for none.
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
