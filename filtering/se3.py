"""Rigid transforms of SE(3), in batches."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float64
from scipy.spatial.transform import Rotation

from filtering.errors import VaporTrackError

_SMALL_SQ = 1e-4  # rad²: below, series are exact and quotients cancel
# v @ _SKEW is [v]×, row by row.
_SKEW = np.array([[0, 0, 0, 0, 0, -1, 0, 1, 0], [0, 0, 1, 0, 0, 0, -1, 0, 0], [0, -1, 0, 1, 0, 0, 0, 0, 0]], np.float64)
# R @ _SINE_COSINE are sin θ times the axis, which is half of R − Rᵀ, and cos θ + ½.
_SINE_COSINE = np.column_stack([_SKEW.T, np.eye(3).ravel()]) / 2
_NO_SINE = 1e-300  # squared: the quotient of an angle of 0 and its sine is then 1


@dataclass(frozen=True)
class Poses:
    """A batch of poses `a_from_b`: each maps points in frame b to points in frame a.

    Right-handed, metres. The batch shape may be empty, `()`, for one pose. Tangent vectors are
    ξ = (v, ω) = (vx, vy, vz, ωx, ωy, ωz), translation first, and act on the right: `T @ Poses.exp(ξ)`,
    so ξ and every covariance of it live in frame b.

    Attributes:
        rotation: Rotation matrices, float64.
        translation: Translations in metres, float64.
    """

    rotation: Float64[np.ndarray, "*batch 3 3"]
    translation: Float64[np.ndarray, "*batch 3"]

    # --- factories ---------------------------------------------------------------------------------

    @staticmethod
    def identity(*batch: int) -> Poses:
        """Identity poses of the given batch shape."""
        return Poses(np.broadcast_to(np.eye(3), (*batch, 3, 3)).copy(), np.zeros((*batch, 3)))

    @staticmethod
    def from_matrix(matrix: np.ndarray) -> Poses:
        """Poses from homogeneous matrices of shape (*batch, 4, 4)."""
        matrix = np.asarray(matrix, np.float64)
        return Poses(matrix[..., :3, :3].copy(), matrix[..., :3, 3].copy())

    @staticmethod
    def from_quat_xyzw(translation: np.ndarray, quat_xyzw: np.ndarray) -> Poses:
        """Poses from translations (*batch, 3) and quaternions (*batch, 4) in x, y, z, w order.

        Quaternions are normalised. Raises:
            VaporTrackError: a value is not finite, or a quaternion has no length.
        """
        translation = np.asarray(translation, np.float64)
        quat_xyzw = np.asarray(quat_xyzw, np.float64)
        norm = np.linalg.norm(quat_xyzw, axis=-1)
        if not (np.isfinite(translation).all() and np.isfinite(quat_xyzw).all()):
            raise VaporTrackError(
                f"pose is not finite: translation {translation.tolist()}, quaternion xyzw {quat_xyzw.tolist()}"
            )
        if (norm < 1e-6).any():
            raise VaporTrackError(f"quaternion xyzw {quat_xyzw.tolist()} has zero length, expected a unit quaternion")
        return Poses(rotation_from_quat_xyzw(quat_xyzw / norm[..., None]), translation.copy())

    @staticmethod
    def exp(tangent: Float64[np.ndarray, "*batch 6"]) -> Poses:
        """Exponential map of tangent vectors (v, ω)."""
        v, omega = tangent[..., :3], tangent[..., 3:]
        a, b, c = _exp_coefficients(_dot(omega, omega))
        translation = a * v + b * _cross(omega, v) + c * _dot(omega, v) * omega
        return Poses(_rodrigues(omega, a, b), translation)

    @staticmethod
    def concatenate(parts: Sequence[Poses]) -> Poses:
        """Join batches along their first axis."""
        return Poses(np.concatenate([p.rotation for p in parts]), np.concatenate([p.translation for p in parts]))

    @staticmethod
    def stack(parts: Sequence[Poses]) -> Poses:
        """Stack equally shaped batches along a new first axis."""
        shape = len(parts), *parts[0].batch_shape  # a third of np.stack's time
        rotation = np.concatenate([p.rotation for p in parts]).reshape(*shape, 3, 3)
        return Poses(rotation, np.concatenate([p.translation for p in parts]).reshape(*shape, 3))

    # --- accessors ---------------------------------------------------------------------------------

    @property
    def batch_shape(self) -> tuple[int, ...]:
        """Shape of the batch; `()` for one pose."""
        return self.translation.shape[:-1]

    def __len__(self) -> int:
        if not self.batch_shape:
            raise TypeError("a single pose has no length")
        return len(self.translation)

    def __getitem__(self, index: int | np.integer | slice | list[int] | np.ndarray) -> Poses:
        return Poses(self.rotation[index], self.translation[index])

    def as_matrix(self) -> Float64[np.ndarray, "*batch 4 4"]:
        """Homogeneous matrices."""
        matrix = np.zeros((*self.batch_shape, 4, 4))
        matrix[..., :3, :3] = self.rotation
        matrix[..., :3, 3] = self.translation
        matrix[..., 3, 3] = 1.0
        return matrix

    def as_quat_xyzw(self, *, known_valid: bool = False) -> Float64[np.ndarray, "*batch 4"]:
        """Unit quaternions in x, y, z, w order, w ≥ 0; rotations are checked unless they are known to be valid."""
        matrices = self.rotation.reshape(-1, 3, 3)
        flat = Rotation.from_matrix(matrices, assume_valid=known_valid).as_quat(canonical=True)
        return flat.reshape(*self.batch_shape, 4)

    @cached_property
    def chordal(self) -> Float64[np.ndarray, "*batch 12"]:
        """[t, vec(R)/√2]: squared Euclidean distances between these are |Δt|² and 2 − 2 cos θ."""
        flat = self.rotation.reshape(*self.batch_shape, 9)
        return np.concatenate([self.translation, flat / np.sqrt(2.0)], axis=-1)

    def is_finite(self) -> Bool[np.ndarray, "*batch"]:
        """Which poses have no NaN and no infinity."""
        return np.asarray(np.isfinite(self.rotation).all(axis=(-2, -1)) & np.isfinite(self.translation).all(axis=-1))

    @cached_property
    def is_identity(self) -> bool:
        """Whether every pose is exactly the identity."""
        return bool((self.rotation == np.eye(3)).all() and not self.translation.any())

    # --- operations --------------------------------------------------------------------------------

    def __matmul__(self, other: Poses) -> Poses:
        """Compose: `a_from_b @ b_from_c` is `a_from_c`; batch shapes broadcast."""
        rotation = self.rotation @ other.rotation
        translation = (self.rotation @ other.translation[..., None])[..., 0] + self.translation
        return Poses(rotation, translation)

    def inverse(self) -> Poses:
        """`b_from_a` of every `a_from_b`."""
        transposed = np.swapaxes(self.rotation, -1, -2)
        return Poses(np.ascontiguousarray(transposed), -(transposed @ self.translation[..., None])[..., 0])

    def between(self, other: Poses) -> Poses:
        """`b_from_c` of `a_from_b` and `a_from_c`: `self.inverse() @ other`; batch shapes broadcast."""
        transposed = np.swapaxes(self.rotation, -1, -2)
        offset = other.translation - self.translation
        return Poses(transposed @ other.rotation, (transposed @ offset[..., None])[..., 0])

    def apply(self, points: Float64[np.ndarray, "*batch_or_n 3"]) -> Float64[np.ndarray, "..."]:
        """Map points (..., 3) in frame b to frame a; the batch broadcasts against the leading axes."""
        return (self.rotation @ points[..., None])[..., 0] + self.translation

    def log(self) -> Float64[np.ndarray, "*batch 6"]:
        """Tangent vectors (v, ω), with |ω| ≤ π; the inverse of `exp`."""
        omega = rotvec_from_rotation(self.rotation)
        v, angle_sq = self.translation, _dot(omega, omega)
        twice_turned = _dot(omega, v) * omega - angle_sq * v  # ω × (ω × v)
        v = v - 0.5 * _cross(omega, v) + _log_coefficient(angle_sq) * twice_turned
        return np.concatenate([v, omega], axis=-1)

    def adjoint(self) -> Float64[np.ndarray, "*batch 6 6"]:
        """Adjoint A with `T exp(ξ) T⁻¹ = exp(A ξ)`, for the (v, ω) order."""
        adjoint = np.zeros((*self.batch_shape, 6, 6))
        adjoint[..., :3, :3] = self.rotation
        adjoint[..., 3:, 3:] = self.rotation
        adjoint[..., :3, 3:] = skew(self.translation) @ self.rotation
        return adjoint

    def orthonormal(self) -> Poses:
        """The same with rotations whose distance from orthonormal ones is squared.

        One step of Newton's iteration for the polar factor (Higham, 1986). In chains of motions, each rigid to some
        digits, it keeps errors from adding up.
        """
        rotation = self.rotation
        return Poses(1.5 * rotation - 0.5 * rotation @ (np.swapaxes(rotation, -1, -2) @ rotation), self.translation)

    def interpolate(self, other: Poses, fraction: Float64[np.ndarray, "*batch"] | float) -> Poses:
        """The pose a fraction of the way to `other` along the geodesic `self @ exp(s log(self⁻¹ other))`."""
        return self @ Poses.exp(np.asarray(fraction, np.float64)[..., None] * self.between(other).log())

    def distance(self, other: Poses) -> tuple[Float64[np.ndarray, "..."], Float64[np.ndarray, "..."]]:
        """Translation distance in metres and rotation angle in radians; batch shapes broadcast.

        The angle is 2·asin(‖R₁ − R₂‖_F / √8): exact, accurate near zero and free of NaN at π.
        """
        offset, turned = self.translation - other.translation, self.rotation - other.rotation
        turned = turned.reshape(*turned.shape[:-2], 9)
        sine = np.sqrt(np.vecdot(turned, turned) / 8.0)
        return np.asarray(np.sqrt(np.vecdot(offset, offset))), np.asarray(2.0 * np.arcsin(np.minimum(sine, 1.0)))

    def squared_distances(self, others: Poses) -> tuple[Float64[np.ndarray, "n k"], Float64[np.ndarray, "n k"]]:
        """Of each of these poses (n,) from each of others (k,): in m², and 2 − 2 cos θ, at most the squared angle.

        Exact to 1e-15 of the squared extent of all poses.
        """
        if len(others) == 0:
            return np.zeros((len(self), 0)), np.zeros((len(self), 0))
        mine, theirs = self.translation - others.translation[0], others.translation - others.translation[0]
        metres_sq = np.vecdot(mine, mine)[:, None] + np.vecdot(theirs, theirs) - 2.0 * mine @ theirs.T
        return metres_sq, 3.0 - self.rotation.reshape(-1, 9) @ others.rotation.reshape(-1, 9).T

    def mean(self, weights: Float64[np.ndarray, " n"] | None = None) -> Poses:
        """Weighted mean of a batch (n,): arithmetic for translations, chordal L2 for rotations.

        The chordal mean is the rotation nearest to the mean matrix (Hartley et al., IJCV 2013). It is a
        point between the modes of a multimodal batch: take it over one mode only.
        """
        fraction = np.full(len(self), 1.0 / len(self)) if weights is None else weights / weights.sum()
        mean_matrix = (fraction @ self.rotation.reshape(-1, 9)).reshape(3, 3)
        return Poses(nearest_rotation(mean_matrix), fraction @ self.translation)


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


def _rodrigues(omega: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(1 − bθ²) I + a [ω]× + b ω ωᵀ, with a = sin θ/θ and 1 − bθ² = cos θ."""
    rotation = (b * omega)[..., :, None] * omega[..., None, :]
    rotation += skew(a * omega)
    rotation += (1.0 - b * _dot(omega, omega))[..., None] * np.eye(3)
    return rotation


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Scalar products (..., 1) of vectors (..., 3)."""
    return np.vecdot(a, b)[..., None]


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Cross products of vectors (..., 3), several times faster than numpy's."""
    product = np.empty(np.broadcast(a, b).shape)
    for axis, (i, j) in enumerate(((1, 2), (2, 0), (0, 1))):
        product[..., axis] = a[..., i] * b[..., j] - a[..., j] * b[..., i]
    return product


def skew(v: np.ndarray) -> np.ndarray:
    """[v]× of vectors (..., 3)."""
    return (v @ _SKEW).reshape(*v.shape, 3)


def _exp_coefficients(angle_sq: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
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


def _log_coefficient(angle_sq: np.ndarray) -> np.ndarray:
    """1/θ² − (1 + cos θ)/(2 θ sin θ), by series near zero and in a form that is finite at π."""
    small = angle_sq < _SMALL_SQ
    series = 1 / 12 + angle_sq / 720 + angle_sq**2 / 30240
    if small.all():
        return series
    safe = np.maximum(angle_sq, _SMALL_SQ)
    half = np.sqrt(safe) / 2
    return np.where(small, series, (1 - half / np.tan(half)) / safe)
