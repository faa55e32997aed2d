"""Rotations in three dimensions, in batches, and what the exponential map of SE(3) needs of them."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64
from scipy.spatial.transform import Rotation

_SMALL_SQ = 1e-4  # rad²: below, series are exact and quotients cancel
# v @ _SKEW is [v]×, row by row.
_SKEW = np.array([[0, 0, 0, 0, 0, -1, 0, 1, 0], [0, 0, 1, 0, 0, 0, -1, 0, 0], [0, -1, 0, 1, 0, 0, 0, 0, 0]], np.float64)
# R @ _SINE_COSINE are sin θ times the axis, which is half of R − Rᵀ, and cos θ + ½.
_SINE_COSINE = np.column_stack([_SKEW.T, np.eye(3).ravel()]) / 2
_NO_SINE = 1e-300  # squared: the quotient of an angle of 0 and its sine is then 1


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
    # Half of R − Rᵀ is sin θ times the axis: exact and fast except near π, where it vanishes.
    parts = rotation.reshape(*rotation.shape[:-2], 9) @ _SINE_COSINE
    sine_axis, cosine = parts[..., :3], parts[..., 3] - 0.5
    sine = np.sqrt(np.maximum(np.vecdot(sine_axis, sine_axis), _NO_SINE))
    rotvec = sine_axis * (np.arctan2(sine, cosine) / sine)[..., None]
    far = cosine < -0.9
    if far.any():
        rotvec[far] = Rotation.from_matrix(rotation[far], assume_valid=True).as_rotvec()
    return rotvec


def rodrigues(omega: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(1 − bθ²) I + a [ω]× + b ω ωᵀ, with a = sin θ/θ and 1 − bθ² = cos θ."""
    rotation = (b * omega)[..., :, None] * omega[..., None, :]
    rotation += skew(a * omega)
    rotation += (1.0 - b * dot(omega, omega))[..., None] * np.eye(3)
    return rotation


def dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Scalar products (..., 1) of vectors (..., 3)."""
    return np.vecdot(a, b)[..., None]


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Cross products of vectors (..., 3), several times faster than numpy's."""
    product = np.empty(np.broadcast(a, b).shape)
    for axis, (i, j) in enumerate(((1, 2), (2, 0), (0, 1))):
        product[..., axis] = a[..., i] * b[..., j] - a[..., j] * b[..., i]
    return product


def skew(v: np.ndarray) -> np.ndarray:
    """[v]× of vectors (..., 3)."""
    return (v @ _SKEW).reshape(*v.shape, 3)


def exp_coefficients(angle_sq: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """sin θ/θ, (1 − cos θ)/θ², (θ − sin θ)/θ³, by series below 1e-2 rad where the quotients cancel."""
    small = angle_sq < _SMALL_SQ
    if small.all():
        return _exp_series(angle_sq)
    safe = np.where(small, 1.0, angle_sq)
    angle = np.sqrt(safe)
    sine = np.sin(angle)
    quotients = sine / angle, 2 * np.sin(angle / 2) ** 2 / safe, (angle - sine) / (safe * angle)
    if not small.any():
        return quotients
    a, b, c = (np.where(small, near, far) for near, far in zip(_exp_series(angle_sq), quotients, strict=True))
    return a, b, c


def _exp_series(angle_sq: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    fourth = angle_sq**2
    return (
        1 - angle_sq / 6 + fourth / 120,
        0.5 - angle_sq / 24 + fourth / 720,
        1 / 6 - angle_sq / 120 + fourth / 5040,
    )


def log_coefficient(angle_sq: np.ndarray) -> np.ndarray:
    """1/θ² − (1 + cos θ)/(2 θ sin θ), by series near zero and in a form that is finite at π."""
    small = angle_sq < _SMALL_SQ
    series = 1 / 12 + angle_sq / 720 + angle_sq**2 / 30240
    if small.all():
        return series
    safe = np.maximum(angle_sq, _SMALL_SQ)
    half = np.sqrt(safe) / 2
    return np.where(small, series, (1 - half / np.tan(half)) / safe)
