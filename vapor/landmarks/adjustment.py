"""Bundle adjustment: the camera, points and poses that fit where views see points, poses near what was stated.

Source: Triggs, McLauchlan, Hartley and Fitzgibbon, "Bundle adjustment: a modern synthesis", 2000 (points eliminated by
the Schur complement, robust by weights).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sparse
from jaxtyping import Float64
from scipy.sparse.linalg import spsolve

from filtering.se3 import Poses
from vapor.landmarks.landmark_map import ViewCamera
from vapor.landmarks.points import Sightings, by_point, by_pose, seen

_ROUNDS = 8
_PIXEL = 1.0  # scale of the robust cost
_DAMPING = 1e-4
_INTRINSICS_STD = np.array([1.0, 0.03, 0.03, 0.3, 0.5])
"""Prior standard deviations of a camera: log focal length, principal point in image widths, k₁, k₂."""
_FIXED = 1e9  # information, per px²
_DENSE = 3000  # unknowns, up to which a dense solution is faster


@dataclass(frozen=True)
class Adjusted:
    """Camera, poses (n,) and points of a bundle adjustment, and the reprojection error of each sighting, pixels.

    `focal_std` is the standard deviation of the logarithm of the focal length, from pixels alone.
    """

    camera: ViewCamera
    camera_from_world: Poses
    points: Float64[np.ndarray, "p 3"]
    errors: Float64[np.ndarray, " m"]
    focal_std: float


def adjusted(
    camera: ViewCamera,
    camera_from_world: Poses,
    points: Float64[np.ndarray, "p 3"],
    of: Sightings,
    *,
    pose_std: tuple[float, float],
    principal_point: bool = True,
) -> Adjusted:
    """Fit camera, poses of n views and points to their sightings, from initial ones.

    `pose_std` are the standard deviations of the stated poses, metres and radians. The principal point stays where
    `principal_point` is false.
    """
    count, stated = len(camera_from_world), camera_from_world
    first, values = camera, np.zeros(5)
    prior = 1.0 / np.square(_INTRINSICS_STD * [1.0, camera.camera.width, camera.camera.width, 1.0, 1.0])
    if not principal_point:
        prior[1:3] = _FIXED
    pose_prior = np.repeat(1.0 / np.square(pose_std), 3)
    information = np.eye(5)
    for _ in range(_ROUNDS):
        system = _System.at(camera, camera_from_world, points, of)
        away = (camera_from_world @ stated.inverse()).log()
        diagonal = np.concatenate([np.tile(pose_prior, count), prior])
        towards = np.concatenate([(away * pose_prior).ravel(), values * prior])
        step, moved, information = system.solved(diagonal, towards)
        camera_from_world = (Poses.exp(step[:-5].reshape(-1, 6)) @ camera_from_world).orthonormal()
        values, points = values + step[-5:], points + moved
        camera = _with_intrinsics(first, values)
        if np.abs(step[-5:] * np.sqrt(prior)).max() < 1e-5:
            break
    rays = seen(camera_from_world[of.view], points[of.point]).at
    errors = np.linalg.norm(camera.pixels(rays) - of.pixels, axis=1)
    return Adjusted(camera, camera_from_world, points, errors, float(np.sqrt(np.linalg.inv(information)[0, 0])))


def _with_intrinsics(first: ViewCamera, values: Float64[np.ndarray, "5"]) -> ViewCamera:
    zoom, (x, y, k1, k2) = float(np.exp(values[0])), values[1:].tolist()
    old = first.camera
    pinhole = replace(old, fx=zoom * old.fx, fy=zoom * old.fy, cx=old.cx + x, cy=old.cy + y)
    return ViewCamera(pinhole, first.k1 + k1, first.k2 + k2)


@dataclass(frozen=True)
class _System:
    """Normal equations of one Gauss-Newton step, with Cauchy weights of the sightings.

    `cameras` is the Jacobian by poses (6 each) and intrinsics (5), `blocks` the information of each point alone.
    """

    cameras: sparse.csr_matrix
    of_points: sparse.csr_matrix
    residual: Float64[np.ndarray, " r"]
    blocks: Float64[np.ndarray, "p 3 3"]

    @staticmethod
    def at(camera: ViewCamera, poses: Poses, points: Float64[np.ndarray, "p 3"], of: Sightings) -> _System:
        own = poses[of.view]
        found = seen(own, points[of.point])
        at, squared = found.at, np.square(found.at).sum(axis=1, keepdims=True)
        bend = 1.0 + squared * (camera.k1 + camera.k2 * squared)
        slope = camera.k1 + 2.0 * camera.k2 * squared
        residual = camera.focal * bend * at + camera.centre - of.pixels
        by_ray = camera.focal[:, None] * (
            bend[:, :, None] * np.eye(2) + 2.0 * slope[:, :, None] * at[:, :, None] * at[:, None, :]
        )
        ones = np.broadcast_to(np.eye(2), (len(at), 2, 2))
        radial = (camera.focal * at * squared)[:, :, None]
        by_intrinsics = np.concatenate(
            [(camera.focal * bend * at)[:, :, None], ones, radial, radial * squared[:, :, None]], axis=2
        )
        root = np.sqrt(1.0 / (1.0 + np.square(residual).sum(axis=1) / _PIXEL**2))[:, None, None] / _PIXEL
        root = np.where(found.inverse_depth[:, None, None] > 0.0, root, 0.0)
        at_pose, at_point = root * (by_ray @ by_pose(found)), root * (by_ray @ by_point(found, own.rotation))
        count = len(poses)
        columns = np.concatenate(
            [6 * of.view[:, None] + np.arange(6), np.broadcast_to(6 * count + np.arange(5), (len(at), 5))], axis=1
        )
        both = np.concatenate([at_pose, root * by_intrinsics], axis=2)
        blocks = np.zeros((len(points), 3, 3))
        np.add.at(blocks, of.point, np.einsum("mki,mkj->mij", at_point, at_point))
        return _System(
            _sparse(both, columns, 6 * count + 5),
            _sparse(at_point, 3 * of.point[:, None] + np.arange(3), 3 * len(points)),
            (residual * root[:, :, 0]).ravel(),
            blocks,
        )

    def solved(
        self, prior: Float64[np.ndarray, " c"], towards: Float64[np.ndarray, " c"]
    ) -> tuple[Float64[np.ndarray, " c"], Float64[np.ndarray, "p 3"], Float64[np.ndarray, "5 5"]]:
        """Steps of cameras and points, and information of the intrinsics, given information and gradient of a prior."""
        count = len(self.blocks)
        scale = np.trace(self.blocks, axis1=1, axis2=2)[:, None, None] + 1e-12
        inverse = sparse.bsr_matrix(
            (np.linalg.inv(self.blocks + _DAMPING * scale * np.eye(3)), np.arange(count), np.arange(count + 1)),
            shape=(3 * count, 3 * count),
        ).tocsr()
        across = self.cameras.T @ self.of_points
        gradient, of_points = self.cameras.T @ self.residual, self.of_points.T @ self.residual
        reduced = self.cameras.T @ self.cameras - across @ inverse @ across.T + sparse.diags(prior * (1.0 + _DAMPING))
        right = -(gradient + towards - across @ (inverse @ of_points))
        dense = reduced.shape[0] <= _DENSE
        step = np.linalg.solve(reduced.toarray(), right) if dense else spsolve(reduced.tocsc(), right)
        moved = -(inverse @ (of_points + across.T @ step))
        return np.asarray(step), moved.reshape(-1, 3), reduced.tocsr()[-5:, -5:].toarray()


def _sparse(blocks: Float64[np.ndarray, "m 2 k"], columns: np.ndarray, width: int) -> sparse.csr_matrix:
    count, _, size = blocks.shape
    indices = np.repeat(columns, 2, axis=0).ravel()
    return sparse.csr_matrix(
        (blocks.ravel(), indices, np.arange(0, 2 * count * size + 1, size)), shape=(2 * count, width)
    )
