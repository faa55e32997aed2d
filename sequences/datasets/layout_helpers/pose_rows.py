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
    """The pose in a row of text: its rotation and translation as they stand, whichever way they map points.

    Args:
        fields: The row.
        columns: Names of its columns, with tx, ty, tz, qw, qx, qy and qz among them.
        where: Begins the message of an error.

    Returns:
        One pose; the reason for which its image is left out where it is not finite, as of a frame that was not tracked.

    Raises:
        SequenceError: another number of columns, no number where one belongs, or no unit quaternion.
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
    """The pose of a 4 x 4 camera-to-world matrix, its rotation made exact; its axes as they stand.

    Args:
        matrix: Rows of numbers.
        where: Begins the message of an error.

    Returns:
        One pose; the reason for which its image is left out where it is not finite.

    Raises:
        SequenceError: no 4 x 4 numbers, or not those of a rotation and a translation.
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
    """The pose of a camera whose axes are OpenGL's (y up, z backward), with OpenCV's (y down, z forward).

    Args:
        pose: One pose; the reason for which there is none is given back.
    """
    if isinstance(pose, str):
        return pose
    return Poses(pose.rotation * np.array([1.0, -1.0, -1.0]), pose.translation)


def stack_poses(poses: Sequence[Poses]) -> Poses:
    """A batch (n,) of n single poses, n ≥ 0."""
    return Poses.stack(poses) if poses else Poses.identity(0)
