"""Poses as rows of text, with whatever columns beside them, and as matrices; camera axes of others -> OpenCV's."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from filtering.errors import quoted
from filtering.se3 import Poses
from sequences.errors import SequenceError
from sequences.values import LARGEST, parse_numbers

NOT_FINITE = "true pose not finite"
_MAX_MATRIX_ERROR = 0.01  # of a rotation's elements
_MAX_LENGTH_ERROR = 0.01  # of a quaternion; beyond, these are other numbers


def read_pose_row(fields: Sequence[str], columns: str, where: str) -> Poses | str:
    """One pose from a row of text, whichever way it maps points, or the reason to leave its image out.

    `columns` names the columns, with tx, ty, tz, qw, qx, qy and qz among them. A pose that is not finite, as of a frame
    that was not tracked, gives a reason. Raises SequenceError for another number of columns, for text that is no number
    and for a quaternion that is not of unit length; `where` begins the message.
    """
    names = columns.split()
    if len(fields) != len(names):
        raise SequenceError(f"{where}: {len(fields)} columns, expected the {len(names)} of `{columns}`")
    wanted = [fields[names.index(name)] for name in ("tx", "ty", "tz", "qx", "qy", "qz", "qw")]
    row = np.array(parse_numbers(wanted, where, f"those of `{columns}`"))
    if not np.isfinite(row).all():
        return NOT_FINITE
    _require_in_range(row, where)
    length = float(np.linalg.norm(row[3:]))
    if abs(length - 1) > _MAX_LENGTH_ERROR:
        raise SequenceError(f"{where}: quaternion of length {length:g}, expected a unit quaternion in `{columns}`")
    return Poses.from_quat_xyzw(row[:3], row[3:])


def read_pose_matrix(matrix: object, where: str) -> Poses | str:
    """One pose from a 4 x 4 camera-to-world matrix, its rotation made exact, or the reason to leave its image out.

    A pose that is not finite gives a reason. Raises SequenceError for anything but a rotation and a translation.
    `where` begins the message.
    """
    try:
        values = np.array(matrix, np.float64)
    except (ValueError, TypeError, OverflowError):
        raise SequenceError(f"{where}: {quoted(matrix)}, expected a 4 x 4 matrix of numbers") from None
    if values.shape != (4, 4):
        raise SequenceError(f"{where}: shape {values.shape}, expected a 4 x 4 matrix")
    if not np.isfinite(values).all():
        return NOT_FINITE
    _require_in_range(values, where)
    u, _, vt = np.linalg.svd(values[:3, :3])
    if np.abs(u @ vt - values[:3, :3]).max() > _MAX_MATRIX_ERROR or np.linalg.det(u @ vt) < 0:
        raise SequenceError(f"{where}: the upper left 3 x 3 is no rotation, expected a camera-to-world matrix")
    if np.abs(values[3] - (0, 0, 0, 1)).max() > 1e-3:
        raise SequenceError(f"{where}: last row {values[3].tolist()}, expected 0 0 0 1 of a camera-to-world matrix")
    return Poses(u @ vt, values[:3, 3].copy())


def _require_in_range(values: np.ndarray, where: str) -> None:
    if np.abs(values).max() > LARGEST:
        raise SequenceError(
            f"{where}: pose has {quoted(float(np.abs(values).max()))}, expected numbers up to {LARGEST:g}"
        )


def from_opengl(pose: Poses | str) -> Poses | str:
    """A pose with OpenCV's axes (y down, z forward) from one with OpenGL's (y up, z backward); reasons stay."""
    if isinstance(pose, str):
        return pose
    return Poses(pose.rotation * np.array([1.0, -1.0, -1.0]), pose.translation)


def stack_poses(poses: Sequence[Poses]) -> Poses:
    """A batch (n,) of n single poses, n ≥ 0."""
    return Poses.stack(poses) if poses else Poses.identity(0)
