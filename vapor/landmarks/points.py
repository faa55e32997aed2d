"""Points from the rays along which views of known pose see them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int64
from scipy.sparse import csc_matrix

from filtering.se3 import Poses

_ROUNDS = 4


@dataclass(frozen=True)
class Sightings:
    """m sightings of points by views, at least one for each point. Features are numbered over all views."""

    view: Int64[np.ndarray, " m"]
    point: Int64[np.ndarray, " m"]
    feature: Int64[np.ndarray, " m"]
    pixels: Float64[np.ndarray, "m 2"]

    def __len__(self) -> int:
        return len(self.view)

    def kept(self, mask: Bool[np.ndarray, " m"], least: int = 2) -> tuple[Sightings, Int64[np.ndarray, " q"]]:
        """The masked sightings of points with at least `least` of them, and the numbers of these points."""
        points = np.bincount(self.point[mask], minlength=int(self.point.max(initial=-1)) + 1)
        mask = mask & (points >= least)[self.point]
        left, number = np.unique(self.point[mask], return_inverse=True)
        return Sightings(self.view[mask], number, self.feature[mask], self.pixels[mask]), left


@dataclass(frozen=True)
class Seen:
    """Points in the view of a pinhole camera: x and y of the rays, inverse depth (0 behind), metres."""

    at: Float64[np.ndarray, "m 2"]
    inverse_depth: Float64[np.ndarray, " m"]
    in_camera: Float64[np.ndarray, "m 3"]


def seen(camera_from_world: Poses, points: Float64[np.ndarray, "m 3"]) -> Seen:
    """Project each of m points into the view of its pose, (m,) or one for all."""
    in_camera = np.einsum("...ij,...j->...i", camera_from_world.rotation, points) + camera_from_world.translation
    depth = in_camera[:, 2]
    with np.errstate(divide="ignore"):
        inverse = np.where(depth > 0.0, 1.0 / depth, 0.0)
    return Seen(in_camera[:, :2] * inverse[:, None], inverse, in_camera)


def triangulated(
    camera_from_world: Poses, rays: Float64[np.ndarray, "m 2"], of: Sightings
) -> Float64[np.ndarray, "p 3"]:
    """Points by least squares: first of the distances from the rays' planes, then of the rays' x and y."""
    count = int(of.point.max(initial=-1)) + 1
    rotation, translation = camera_from_world.rotation[of.view], camera_from_world.translation[of.view]
    normal, right = np.zeros((count, 3, 3)), np.zeros((count, 3))
    for axis in (0, 1):
        plane = rays[:, axis, None] * rotation[:, 2] - rotation[:, axis]
        offset = rays[:, axis] * translation[:, 2] - translation[:, axis]
        length = np.linalg.norm(plane, axis=1)
        plane, offset = plane / length[:, None], offset / length
        normal += summed(plane[:, :, None] * plane[:, None, :], of.point, count)
        right -= summed(plane * offset[:, None], of.point, count)
    points = _solved(normal, right, 1e-9)
    poses = camera_from_world[of.view]
    for _ in range(_ROUNDS):
        found = seen(poses, points[of.point])
        jacobian = by_point(found, rotation)
        residual = found.at - rays
        x, y = jacobian[:, 0], jacobian[:, 1]
        normal = summed(x[:, :, None] * x[:, None] + y[:, :, None] * y[:, None], of.point, count)
        right = summed(x * residual[:, :1] + y * residual[:, 1:], of.point, count)
        points = points - _solved(normal, right, 1e-3)
    return points


def by_point(found: Seen, rotation: Float64[np.ndarray, "m 3 3"]) -> Float64[np.ndarray, "m 2 3"]:
    """Derivative of `Seen.at` by the points."""
    return (rotation[:, :2] - found.at[:, :, None] * rotation[:, 2:]) * found.inverse_depth[:, None, None]


def by_pose(found: Seen) -> Float64[np.ndarray, "m 2 6"]:
    """Derivative of `Seen.at` by ξ = (v, ω), where exp(ξ) is on the left of camera_from_world."""
    x, y, inverse = found.at[:, 0], found.at[:, 1], found.inverse_depth
    zero = np.zeros_like(x)
    rows = [[inverse, zero, -x * inverse, -x * y, 1 + x * x, -y], [zero, inverse, -y * inverse, -1 - y * y, x * y, x]]
    return np.moveaxis(np.array(rows), 2, 0)


def parallax(camera_from_world: Poses, points: Float64[np.ndarray, "p 3"], of: Sightings) -> Float64[np.ndarray, " p"]:
    """Angle between the rays of each point, about: twice the largest from their mean, radians."""
    centres = camera_from_world.inverse().translation
    towards = points[of.point] - centres[of.view]
    towards /= np.maximum(np.linalg.norm(towards, axis=1, keepdims=True), 1e-12)
    mean = summed(towards, of.point, len(points))
    mean /= np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), 1e-12)
    away = np.arccos(np.clip(np.vecdot(towards, mean[of.point]), -1.0, 1.0))
    widest = np.zeros(len(points))
    np.maximum.at(widest, of.point, away)
    return 2.0 * widest


def summed(values: np.ndarray, group: Int64[np.ndarray, " m"], count: int) -> np.ndarray:
    """Sums of the m values of each of `count` groups, in double precision."""
    each = np.arange(len(group) + 1)
    member = csc_matrix((np.ones(len(group)), group, each), shape=(count, len(group)))
    return (member @ values.reshape(len(values), -1)).reshape(count, *values.shape[1:])


def _solved(normal: np.ndarray, right: np.ndarray, damping: float) -> Float64[np.ndarray, "p 3"]:
    scale = np.trace(normal, axis1=1, axis2=2)[:, None, None] + 1e-12
    return np.linalg.solve(normal + damping * scale * np.eye(3), right[:, :, None])[:, :, 0]
