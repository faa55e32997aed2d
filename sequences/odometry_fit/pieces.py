"""Odometry beside true poses, and its errors in pieces short enough to be evaluated together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from filtering.motion import Odometry, require_odometry
from filtering.se3 import Poses
from sequences.errors import SequenceError


@dataclass(frozen=True)
class OdometrySegment:
    """Consecutive increments of odometry and the true poses that they lead from and to.

    Attributes:
        odometry: n increments of the camera.
        truth: world_from_camera, (n + 1,).
        recording: Number of the recording it is from: the scale error is one for all of it.
    """

    odometry: Sequence[Odometry]
    truth: Poses
    recording: int = 0


LEAST_INCREMENTS = 100
_PIECE = 300  # increments whose errors are evaluated together: the work grows with its cube
_CLIP = 5.0  # robust standard deviations
_SMOOTHED_S = 1.0


@dataclass
class Piece:
    """Errors (n, 6) of consecutive increments, with what may explain them.

    Attributes:
        errors: Tangent vectors, in the camera frame after each increment, (n, 6).
        dt: Seconds, (n,).
        moved: Metres at the true speed averaged over a second, (n,). The length of the increment itself is the longer
            the more it errs.
        motion: True velocities times dt, (n, 3).
        smoothed: The same, averaged over a second.
    """

    recording: int
    errors: np.ndarray
    dt: np.ndarray
    moved: np.ndarray
    motion: np.ndarray
    smoothed: np.ndarray

    def __post_init__(self) -> None:
        n, time = len(self.dt), np.cumsum(self.dt) - self.dt / 2
        self.apart = np.abs(time[:, None] - time)
        self.product = np.outer(self.dt, self.dt)
        self.jitter = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)


def cut_into_pieces(segments: Sequence[OdometrySegment], max_increments: int) -> tuple[list[Piece], int]:
    """Segments cut into pieces of at most 300 increments; and the number of increments given."""
    increments = 0
    for number, segment in enumerate(segments):
        if len(segment.truth) != len(segment.odometry) + 1:
            raise SequenceError(
                f"segment {number}: {len(segment.truth)} true poses of {len(segment.odometry)} increments, expected"
                " one more than increments"
            )
        increments += len(segment.odometry)
    if increments < LEAST_INCREMENTS:
        raise SequenceError(f"{increments} increments of odometry, expected at least {LEAST_INCREMENTS} to fit it")
    together = -(-increments // max_increments)
    pieces = []
    for segment in segments:
        merged, at = _merged(segment, together)
        if len(merged) < 3:
            continue
        real = segment.truth[at[:-1]].inverse() @ segment.truth[at[1:]]
        reported = Poses.stack([step.previous_from_current for step in merged])
        errors, motion = (real.inverse() @ reported).log(), real.log()[:, :3]
        dt = np.array([step.duration_s for step in merged])
        moved = _smoothed(np.linalg.norm(motion, axis=-1, keepdims=True), dt)[:, 0]
        smoothed = _smoothed(motion, dt)
        for part in np.array_split(np.arange(len(merged)), -(-len(merged) // _PIECE)):
            pieces.append(Piece(segment.recording, errors[part], dt[part], moved[part], motion[part], smoothed[part]))
    if sum(len(piece.dt) for piece in pieces) < LEAST_INCREMENTS / 2:
        raise SequenceError("too few increments of odometry that follow each other and take time to fit it")
    return pieces, increments


def _merged(segment: OdometrySegment, together: int) -> tuple[list[Odometry], np.ndarray]:
    """Increments put together by so many, and more where they take no time; and the true poses between them."""
    merged, at, count = [], [0], 0
    current: Odometry | None = None
    for i, step in enumerate(segment.odometry):
        require_odometry(step)
        current, count = (step if current is None else current.then(step)), count + 1
        if count >= together and current.duration_s > 0:
            merged.append(current)
            at.append(i + 1)
            current, count = None, 0
    return merged, np.array(at)


def _smoothed(motion: np.ndarray, dt: np.ndarray) -> np.ndarray:
    """Motions (n, k) with the velocity averaged over a second about each, one neighbour on either side at least."""
    half = max(1, round(_SMOOTHED_S / 2 / float(np.median(dt))))
    total = np.concatenate([np.zeros((1, motion.shape[1])), np.cumsum(motion, axis=0)])
    time = np.concatenate([[0.0], np.cumsum(dt)])
    index = np.arange(len(dt))
    first, last = np.maximum(index - half, 0), np.minimum(index + half + 1, len(dt))
    return (total[last] - total[first]) / (time[last] - time[first])[:, None] * dt[:, None]


def error_limits(rates: Sequence[np.ndarray]) -> np.ndarray:
    """Five robust standard deviations of each axis (6,) of errors (n, 6), or infinity where most have none."""
    typical = np.median(np.abs(np.concatenate(rates)), axis=0) / 0.6745
    return np.where(typical > 0, _CLIP * typical, np.inf)
