"""Poses as rows of text, with whatever columns beside them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from filtering.se3 import Poses
from sequences.errors import SequenceError

NOT_FINITE = "true pose not finite"  # why an image is left out, as of a frame that was not tracked
_MAX_LENGTH_ERROR = 0.01  # of a quaternion; beyond, these are other numbers


def read_pose_row(fields: Sequence[str], columns: str, where: str) -> Poses | None:
    """The pose in a row of text: its rotation and translation as they stand, whichever way they map points.

    Args:
        fields: The row.
        columns: Names of its columns, with tx, ty, tz, qw, qx, qy and qz among them.
        where: Begins the message of an error.

    Returns:
        One pose; None where it is not finite.

    Raises:
        SequenceError: another number of columns, no number where one belongs, or no unit quaternion.
    """
    names = columns.split()
    if len(fields) != len(names):
        raise SequenceError(f"{where}: {len(fields)} columns, expected the {len(names)} of `{columns}`")
    try:
        numbers = [float(fields[names.index(name)]) for name in ("tx", "ty", "tz", "qx", "qy", "qz", "qw")]
    except ValueError as error:
        raise SequenceError(f"{where}: {error}; expected numbers in `{columns}`") from error
    row = np.array(numbers)
    if not np.isfinite(row).all():
        return None
    length = float(np.linalg.norm(row[3:]))
    if abs(length - 1) > _MAX_LENGTH_ERROR:
        raise SequenceError(f"{where}: quaternion of length {length:g}, expected a unit quaternion in `{columns}`")
    return Poses.from_quat_xyzw(row[:3], row[3:])


def stack_poses(poses: Sequence[Poses]) -> Poses:
    """A batch (n,) of n single poses, n ≥ 0."""
    return Poses.stack(poses) if poses else Poses.identity(0)
