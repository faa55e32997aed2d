"""Rigid transforms of SE(3), in batches."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float64
from scipy.spatial.transform import Rotation

from filtering import so3
from filtering.errors import VaporTrackError, quoted
from filtering.so3 import nearest_rotation, rotation_from_quat_xyzw, skew

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

_NO_ROTATION, _ROUNDING = 0.01, 1e-12  # of RRᵀ − I: beyond, other numbers; below, that of double precision
_NO_LENGTH = 1e-6  # of a quaternion


@dataclass(frozen=True)
class Poses:
    """A batch of poses `a_from_b`: each maps points in frame b to points in frame a.

    Right-handed, metres. The batch shape may be empty, `()`, for one pose. Tangent vectors are
    ξ = (v, ω) = (vx, vy, vz, ωx, ωy, ωz), translation first, and act on the right: `T @ Poses.exp(ξ)`,
    so ξ and every covariance of it live in frame b.

    Attributes:
        rotation: Rotation matrices, float64.
        translation: Translations in metres, float64.

    Example:
        >>> import numpy as np
        >>> import vapor
        >>> from scipy.spatial.transform import Rotation
        >>> turned = vapor.Poses.from_rotation([1, 2, 0], Rotation.from_euler("z", 90, degrees=True))
        >>> turned.as_matrix().round(3).tolist()
        [[0.0, -1.0, 0.0, 1.0], [1.0, 0.0, 0.0, 2.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
        >>> turned.as_quat_xyzw().round(3)
        array([0.   , 0.   , 0.707, 0.707])
        >>> turned.as_rotation().magnitude().round(3)
        np.float64(1.571)
        >>> quat_wxyz = turned.as_quat_xyzw()[[3, 0, 1, 2]]
        >>> metres, radians = turned.distance(vapor.Poses.from_matrix(np.eye(4)))
        >>> turned.inverse().apply(np.array([1.0, 3.0, 0.0])).round(3)
        array([1., 0., 0.])
        >>> path = vapor.Poses.stack([turned, vapor.Poses.identity()])  # a batch; `for pose in path:` goes over it
        >>> len(path)
        2
    """

    rotation: Float64[np.ndarray, "*batch 3 3"]
    translation: Float64[np.ndarray, "*batch 3"]

    # --- factories ---------------------------------------------------------------------------------

    @staticmethod
    def identity(*batch: int) -> Poses:
        """Identity poses of the given batch shape."""
        return Poses(np.broadcast_to(np.eye(3), (*batch, 3, 3)).copy(), np.zeros((*batch, 3)))

    @staticmethod
    def from_matrix(matrix: ArrayLike) -> Poses:
        """Poses from homogeneous matrices (*batch, 4, 4), an array or lists.

        Rotations that were rounded, as in a text file, become the nearest ones.

        Raises:
            VaporTrackError: another shape, a value that is not finite, a last row other than 0 0 0 1, or no rotation:
                off from an orthonormal matrix by more than 1 %, or a mirroring.
        """
        matrix = _numbers("matrix", matrix, (4, 4))
        rotation = matrix[..., :3, :3].copy()
        last_row = np.abs(matrix[..., 3, :] - [0.0, 0.0, 0.0, 1.0]).max(axis=-1)
        _require("matrix", np.asarray(last_row <= _ROUNDING), matrix, "0 0 0 1 as the last row")
        off = np.abs(rotation @ np.swapaxes(rotation, -1, -2) - np.eye(3)).max(axis=(-2, -1))
        is_rotation = (off <= _NO_ROTATION) & (np.linalg.det(rotation) > 0.0)
        _require("matrix", np.asarray(is_rotation), matrix, "a rotation")
        return Poses(nearest_rotation(rotation) if (off > _ROUNDING).any() else rotation, matrix[..., :3, 3].copy())

    @staticmethod
    def from_rotation(translation: ArrayLike, rotation: Rotation) -> Poses:
        """Poses from translations (*batch, 3) and as many of SciPy's rotations.

        Raises:
            VaporTrackError: another shape, or a value that is not finite.
        """
        matrix, translation = np.asarray(rotation.as_matrix(), np.float64), _numbers("translation", translation, (3,))
        _require_shape("translation", translation, (3,), matrix.shape[:-2])
        return Poses(matrix, translation.copy())

    @staticmethod
    def from_quat_xyzw(translation: ArrayLike, quat_xyzw: ArrayLike) -> Poses:
        """Poses from translations (*batch, 3) and quaternions (*batch, 4) in x, y, z, w order, arrays or lists.

        Quaternions are normalised.

        Raises:
            VaporTrackError: other shapes, a value that is not finite, or a quaternion without length.
        """
        quat_xyzw, translation = (
            _numbers("quaternion xyzw", quat_xyzw, (4,)),
            _numbers("translation", translation, (3,)),
        )
        _require_shape("translation", translation, (3,), quat_xyzw.shape[:-1])
        norm = np.linalg.norm(quat_xyzw, axis=-1)
        _require("quaternion xyzw", np.asarray(norm >= _NO_LENGTH), quat_xyzw, "a unit quaternion")
        return Poses(rotation_from_quat_xyzw(quat_xyzw / norm[..., None]), translation.copy())

    @staticmethod
    def exp(tangent: ArrayLike) -> Poses:
        """Exponential map of tangent vectors (v, ω), (*batch, 6), an array or lists.

        Raises:
            VaporTrackError: another shape.
        """
        tangent = np.asarray(tangent, np.float64)
        _require_shape("tangent", tangent, (6,))
        flat, batch = tangent.reshape(-1, 6), tangent.shape[:-1]
        rotation, translation = so3.exp(flat)
        return Poses(rotation.reshape(*batch, 3, 3), translation.reshape(*batch, 3))

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

    def __iter__(self) -> Iterator[Poses]:
        return (self[i] for i in range(len(self)))

    def __getitem__(self, index: int | np.integer | slice | list[int] | np.ndarray) -> Poses:
        return Poses(self.rotation[index], self.translation[index])

    def as_matrix(self) -> Float64[np.ndarray, "*batch 4 4"]:
        """Homogeneous matrices."""
        matrix = np.zeros((*self.batch_shape, 4, 4))
        matrix[..., :3, :3] = self.rotation
        matrix[..., :3, 3] = self.translation
        matrix[..., 3, 3] = 1.0
        return matrix

    def as_rotation(self) -> Rotation:
        """SciPy's rotations, of the same batch shape."""
        return Rotation.from_matrix(self.rotation)

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

    def apply(self, points: ArrayLike) -> Float64[np.ndarray, "..."]:
        """Map points (..., 3) in frame b to frame a; the batch broadcasts against the leading axes."""
        return (self.rotation @ np.asarray(points, np.float64)[..., None])[..., 0] + self.translation

    def log(self) -> Float64[np.ndarray, "*batch 6"]:
        """Tangent vectors (v, ω), with |ω| ≤ π; the inverse of `exp`."""
        tangent = so3.log(self.rotation.reshape(-1, 9), self.translation.reshape(-1, 3))
        return tangent.reshape(*self.batch_shape, 6)

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


def require_one_pose(name: str, pose: Poses) -> None:
    """Check a single pose, such as extrinsics.

    Raises:
        VaporTrackError: it is something else, a batch, or not finite.
    """
    if not isinstance(pose, Poses):
        raise VaporTrackError(
            f"{name} is of type {type(pose).__name__}, expected Poses, such as Poses.from_matrix(...)"
        )
    if pose.batch_shape != ():
        raise VaporTrackError(f"{name} has batch shape {pose.batch_shape}, expected (): one pose")
    if not pose.is_finite():
        raise VaporTrackError(f"{name} is not finite: {pose.as_matrix()[:3].tolist()}")


def _numbers(name: str, values: ArrayLike, shape: tuple[int, ...]) -> np.ndarray:
    """Finite numbers whose last axes have a shape."""
    try:
        array = np.asarray(values, np.float64)
    except (TypeError, ValueError) as error:
        raise VaporTrackError(f"{name} is {quoted(values)}, expected numbers of one shape") from error
    _require_shape(name, array, shape)
    finite = np.isfinite(array).all(axis=tuple(range(-len(shape), 0)))
    _require(name, np.asarray(finite), array, "finite numbers", fault="not finite: ")
    return array


def _require_shape(name: str, array: np.ndarray, shape: tuple[int, ...], batch: tuple[int, ...] | None = None) -> None:
    """Raise where an array has another shape, or one of another batch."""
    split = array.ndim - len(shape)
    if array.shape[max(split, 0) :] != shape or (batch is not None and array.shape[:split] != batch):
        of_batch = "*batch" if batch is None else ", ".join(map(str, batch))
        expected = ", ".join(filter(None, [of_batch, *map(str, shape)]))
        comma = "" if ", " in expected else ","
        raise VaporTrackError(f"{name} has shape {array.shape}, expected ({expected}{comma})")


def _require(name: str, good: np.ndarray, values: np.ndarray, expected: str, fault: str = "") -> None:
    """Raise where a pose of the batch is not good, and name the first one."""
    if not good.all():
        at = tuple(np.argwhere(~good)[0].tolist())
        where = f"{name} {', '.join(map(str, at))}" if at else name
        raise VaporTrackError(f"{where} is {fault}{quoted(values[at].tolist())}, expected {expected}")
