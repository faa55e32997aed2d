"""Rotations in three dimensions, in batches, and what the exponential map of SE(3) needs of them."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64
from scipy.spatial.transform import Rotation

# v @ _SKEW is [v]×, row by row.
_SKEW = np.array([[0, 0, 0, 0, 0, -1, 0, 1, 0], [0, 0, 1, 0, 0, 0, -1, 0, 0], [0, -1, 0, 1, 0, 0, 0, 0, 0]], np.float64)
# R @ _SINE_COSINE are sin θ times the axis, which is half of R − Rᵀ, and cos θ + ½.
_SINE_COSINE = np.column_stack([_SKEW.T, np.eye(3).ravel()]) / 2
_NO_ANGLE = 1e-300  # squared: quotients of a vanishing angle are then their limits


def nearest_rotation(matrix: Float64[np.ndarray, "*batch 3 3"]) -> Float64[np.ndarray, "*batch 3 3"]:
    """The rotations nearest to matrices in the Frobenius norm: of a mean of rotations, their chordal L2 mean."""
    u, _, vt = np.linalg.svd(matrix)
    u[..., :, 2] *= np.linalg.det(u @ vt)[..., None]
    return u @ vt


def rotation_from_quat_xyzw(quat_xyzw: Float64[np.ndarray, "*batch 4"]) -> Float64[np.ndarray, "*batch 3 3"]:
    """Rotation matrices of unit quaternions in x, y, z, w order."""
    flat = Rotation.from_quat(quat_xyzw.reshape(-1, 4)).as_matrix()
    return flat.reshape(*quat_xyzw.shape[:-1], 3, 3)


def rotvec_from_rotation(rotation: Float64[np.ndarray, "*batch 3 3"]) -> Float64[np.ndarray, "*batch 3"]:
    """Rotation vectors of rotation matrices, with angles up to π."""
    return _rotvec(rotation.reshape(-1, 9))[0].T.reshape(*rotation.shape[:-2], 3)


def skew(v: np.ndarray) -> np.ndarray:
    """[v]× of vectors (..., 3)."""
    return (v @ _SKEW).reshape(*v.shape, 3)


# In what follows the batch comes last, where numpy is fast.


def exp(tangent: Float64[np.ndarray, "n 6"]) -> tuple[Float64[np.ndarray, "n 9"], Float64[np.ndarray, "n 3"]]:
    """Rotations, row by row, and translations of exp(v, ω): I + a Ω + b Ω² and v + b Ω v + c Ω² v with Ω = [ω]×.

    a = sin θ/θ, b = (1 − cos θ)/θ² and c = (θ − sin θ)/θ³. c cancels as θ falls, and its factor Ω² is as small then.
    """
    v, omega = tangent.T.copy().reshape(2, 3, -1)
    angle_sq = _squared(omega) + _NO_ANGLE
    angle = np.sqrt(angle_sq)
    half = 0.5 * angle
    a, b = np.sin(angle) / angle, 0.5 * np.square(np.sin(half) / half)
    c = (1.0 - a) / angle_sq
    skewed, turned, turned_twice = _turned(omega, v)
    rotation = ((b * omega)[:, None] * omega).reshape(9, -1)
    rotation[::4] += 1.0 - b * angle_sq
    rotation += a * skewed
    translation = v + b * turned + c * turned_twice
    return rotation.T.copy(), translation.T.copy()


def log(rotation: Float64[np.ndarray, "n 9"], translation: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "n 6"]:
    """The inverse of `exp`: v = t − Ω t/2 + k Ω² t with k = 1/θ² − (1 + cos θ)/(2 θ sin θ), and ω up to π.

    k cancels as θ falls, and its factor Ω² is as small then.
    """
    (omega, angle), t = _rotvec(rotation), translation.T
    half = 0.5 * angle
    k = (1.0 - half / np.tan(half)) / np.square(angle)
    _, turned, turned_twice = _turned(omega, t)
    return np.concatenate([t - 0.5 * turned + k * turned_twice, omega]).T.copy()


def _rotvec(rotation: Float64[np.ndarray, "n 9"]) -> tuple[Float64[np.ndarray, "3 n"], Float64[np.ndarray, " n"]]:
    """Rotation vectors, and their angles: above 0, at most π."""
    # Half of R − Rᵀ is sin θ times the axis: exact and fast except near π, where it vanishes.
    parts = _SINE_COSINE.T @ rotation.T
    sine_axis, cosine = parts[:3], parts[3] - 0.5
    sine = np.sqrt(_squared(sine_axis) + _NO_ANGLE)
    angle = np.arctan2(sine, cosine)
    rotvec = sine_axis * (angle / sine)
    far = (cosine < -0.9).nonzero()[0]
    if len(far):
        rotvec[:, far] = Rotation.from_matrix(rotation[far].reshape(-1, 3, 3), assume_valid=True).as_rotvec().T
    return rotvec, angle


def _turned(omega: Float64[np.ndarray, "3 n"], v: Float64[np.ndarray, "3 n"]) -> tuple[np.ndarray, ...]:
    """Ω = [ω]×, row by row (9, n), Ω v and Ω² v, (3, n) each."""
    skewed = _SKEW.T @ omega
    matrix = skewed.reshape(3, 3, -1)
    turned = np.einsum("ijn,jn->in", matrix, v)
    return skewed, turned, np.einsum("ijn,jn->in", matrix, turned)


def _squared(vectors: Float64[np.ndarray, "3 n"]) -> Float64[np.ndarray, " n"]:
    return np.einsum("in,in->n", vectors, vectors)
