"""Bundle adjustment of the latest key frames and the depths of the features in the latest one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64, Int64

from filtering.se3 import Poses
from filtering.so3 import skew
from sequences.visual_odometry.tracks import LEAST_DEPTH, KeyFrame, Tracks, pixel_jacobian

_ITERATIONS, _TRIES = 8, 4
_ENOUGH = 1e-3  # of the cost: less is no progress
_CAUCHY = 4.0  # squared standard deviations
_FIXED = 2  # key frames that hold the unit
_PRIOR_STD = 0.7  # of an inverse depth, over its mean
_KNOWN_STD, _KNOWN_WEIGHT = 0.69, 0.05  # a depth that was estimated before keeps so much of that prior
_MOST_CHANGE = 3.0  # of a depth in an iteration, factor
_LEAST_INVERSE_DEPTH = 1e-4


@dataclass(frozen=True)
class _Observations:
    """Of features in key frames other than their anchors, m of them.

    Attributes:
        feature: Which feature, (m,).
        frame: In which key frame, (m,).
        anchor: Its anchor among the key frames, (m,).
        pixels: Where it is, less the principal point, (m, 2).
        whitening: W of each with WᵀW the inverse of its covariance, (m, 2, 2).
    """

    feature: Int64[np.ndarray, " m"]
    frame: Int64[np.ndarray, " m"]
    anchor: Int64[np.ndarray, " m"]
    pixels: Float64[np.ndarray, "m 2"]
    whitening: Float64[np.ndarray, "m 2 2"]

    @staticmethod
    def of(tracks: Tracks, key_frames: Sequence[KeyFrame], centre: Float64[np.ndarray, " 2"]) -> _Observations:
        features, frames, pixels = [], [], []
        for number, frame in enumerate(key_frames):
            _, of_tracks, of_frame = np.intersect1d(tracks.ids, frame.ids, return_indices=True)
            elsewhere = tracks.anchor[of_tracks] != frame.number
            features.append(of_tracks[elsewhere])
            frames.append(np.full(int(elsewhere.sum()), number))
            pixels.append(frame.pixels[of_frame[elsewhere]] - centre)
        feature = np.concatenate(features)
        anchors = np.searchsorted([frame.number for frame in key_frames], tracks.anchor)
        whitening = np.linalg.inv(np.linalg.cholesky(tracks.covariance))
        return _Observations(
            feature, np.concatenate(frames), anchors[feature], np.concatenate(pixels), whitening[feature]
        )


@dataclass(frozen=True)
class _Linearized:
    """The observations at some poses and depths: cost, whitened residuals, and what they depend on."""

    poses: Poses
    inverse_depth: Float64[np.ndarray, " n"]
    relative: Poses
    points: Float64[np.ndarray, "m 3"]
    residual: Float64[np.ndarray, "m 2"]
    cost: float


class _Problem:
    def __init__(
        self,
        tracks: Tracks,
        key_frames: Sequence[KeyFrame],
        focal: Float64[np.ndarray, " 2"],
        centre: Float64[np.ndarray, " 2"],
    ) -> None:
        self.seen = _Observations.of(tracks, key_frames, centre)
        self.focal, self.num_features = focal, len(tracks)
        self.rays = np.column_stack([tracks.ray, np.ones(len(tracks))])[self.seen.feature]
        self.expected = tracks.inverse_depth
        was_known = tracks.variance < np.square(_KNOWN_STD * tracks.inverse_depth)
        self.prior = np.where(was_known, _KNOWN_WEIGHT, 1.0) / np.square(_PRIOR_STD * tracks.inverse_depth)

    def at(self, poses: Poses, inverse_depth: Float64[np.ndarray, " n"]) -> _Linearized:
        seen = self.seen
        relative = poses[seen.frame] @ poses[seen.anchor].inverse()
        ray = (relative.rotation @ self.rays[:, :, None])[:, :, 0]
        points = ray + inverse_depth[seen.feature][:, None] * relative.translation
        depth = np.maximum(points[:, 2], LEAST_DEPTH)
        off = points[:, :2] / depth[:, None] * self.focal - seen.pixels
        residual = (seen.whitening @ off[:, :, None])[:, :, 0]
        squared = np.where(points[:, 2] < LEAST_DEPTH, 1e4, np.square(residual).sum(axis=1))
        cost = _CAUCHY * np.log1p(squared / _CAUCHY).sum()
        cost += (self.prior * np.square(inverse_depth - self.expected)).sum()
        return _Linearized(poses, inverse_depth, relative, points, residual, float(cost))

    def normal_equations(self, at: _Linearized) -> _NormalEquations:
        seen, count, frames = self.seen, len(self.seen.feature), len(at.poses)
        trust = np.sqrt(1.0 / (1.0 + np.square(at.residual).sum(axis=1) / _CAUCHY))
        trust[at.points[:, 2] < LEAST_DEPTH] = 0.0
        projects = trust[:, None, None] * (seen.whitening @ pixel_jacobian(at.points, self.focal))
        residual = trust[:, None] * at.residual
        inverse_depth = at.inverse_depth[seen.feature][:, None, None]
        jacobian, index = np.zeros((count, 2, frames, 6)), np.arange(count)
        jacobian[index, :, seen.frame] = np.concatenate([projects * inverse_depth, -projects @ skew(at.points)], axis=2)
        back = projects @ at.relative.rotation
        jacobian[index, :, seen.anchor] -= np.concatenate([back * inverse_depth, -back @ skew(self.rays)], axis=2)
        jacobian = jacobian.reshape(count, 2, 6 * frames)[:, :, 6 * min(_FIXED, frames - 1) :]
        by_depth = (projects @ at.relative.translation[:, :, None])[:, :, 0]
        flat = jacobian.reshape(2 * count, -1)
        cross = np.zeros((self.num_features, flat.shape[1]))
        np.add.at(cross, seen.feature, (by_depth[:, :, None] * jacobian).sum(axis=1))
        of = {"minlength": self.num_features}
        return _NormalEquations(
            flat.T @ flat,
            flat.T @ residual.reshape(-1),
            cross,
            self.prior + np.bincount(seen.feature, np.square(by_depth).sum(axis=1), **of),
            self.prior * (at.inverse_depth - self.expected)
            + np.bincount(seen.feature, (by_depth * residual).sum(axis=1), **of),
        )


@dataclass(frozen=True)
class _NormalEquations:
    """Of p parameters of poses and n inverse depths: information, its cross terms, and gradients."""

    of_poses: Float64[np.ndarray, "p p"]
    gradient_of_poses: Float64[np.ndarray, " p"]
    cross: Float64[np.ndarray, "n p"]
    of_depths: Float64[np.ndarray, " n"]
    gradient_of_depths: Float64[np.ndarray, " n"]

    def solve(self, damping: float) -> tuple[Float64[np.ndarray, " p"], Float64[np.ndarray, " n"]]:
        """The change of poses and depths, by the Schur complement of the depths."""
        of_depths = (1.0 + damping) * self.of_depths
        poses = self.of_poses + np.diag(damping * np.diag(self.of_poses) + 1e-6)
        reduced = poses - (self.cross / of_depths[:, None]).T @ self.cross
        gradient = self.gradient_of_poses - self.cross.T @ (self.gradient_of_depths / of_depths)
        change = -np.linalg.solve(reduced, gradient)
        return change, -(self.gradient_of_depths + self.cross @ change) / of_depths


def adjust(
    tracks: Tracks,
    key_frames: Sequence[KeyFrame],
    focal: Float64[np.ndarray, " 2"],
    centre: Float64[np.ndarray, " 2"],
) -> tuple[Tracks, tuple[KeyFrame, ...]]:
    """The features with better depths, and the key frames with better poses; the first two keep theirs.

    Source: Triggs et al., "Bundle adjustment: a modern synthesis", 2000; inverse depths as of Civera et al., 2008.

    Args:
        tracks: Features of the latest key frame.
        key_frames: At least two.
        focal: Focal lengths, pixels.
        centre: Principal point, pixels.
    """
    problem = _Problem(tracks, key_frames, focal, centre)
    at = problem.at(Poses.stack([frame.pose for frame in key_frames]), tracks.inverse_depth)
    damping, of_depths = 1e-3, problem.prior
    for _ in range(_ITERATIONS):
        equations = problem.normal_equations(at)
        of_depths = equations.of_depths
        found = _descend(problem, at, equations, damping)
        if found is None:
            break
        better, damping = found
        progress = at.cost - better.cost
        done, at = progress < _ENOUGH * at.cost, better
        if done:
            break
    adjusted = [replace(frame, pose=at.poses[i]) for i, frame in enumerate(key_frames)]
    return replace(tracks, inverse_depth=at.inverse_depth, variance=1.0 / of_depths), tuple(adjusted)


def _descend(
    problem: _Problem, at: _Linearized, equations: _NormalEquations, damping: float
) -> tuple[_Linearized, float] | None:
    """A step of Levenberg and Marquardt, with the damping of the next one; None where none is better."""
    fixed = min(_FIXED, len(at.poses) - 1)
    for _ in range(_TRIES):
        change, deeper = equations.solve(damping)
        moves = np.zeros((len(at.poses), 6))
        moves[fixed:] = change.reshape(-1, 6)
        poses = (Poses.exp(moves) @ at.poses).orthonormal()
        low, high = at.inverse_depth / _MOST_CHANGE, at.inverse_depth * _MOST_CHANGE
        inverse_depth = np.maximum(np.clip(at.inverse_depth + deeper, low, high), _LEAST_INVERSE_DEPTH)
        next_one = problem.at(poses, inverse_depth)
        if next_one.cost < at.cost:
            return next_one, max(0.2 * damping, 1e-6)
        damping *= 10.0
    return None
