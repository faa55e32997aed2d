"""Odometry against true poses: which way its axes point, its clock, and how wrong it is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import accumulate
from typing import Any

import numpy as np
from jaxtyping import Float64

from filtering.motion import Odometry
from filtering.se3 import Poses
from sequences.errors import SequenceError
from sequences.frame import Trajectory
from sequences.odometry_fit.fit import fit_odometry
from sequences.odometry_fit.pieces import OdometrySegment
from sequences.odometry_fit.result import OdometryFit
from sequences.trajectories.time_offset import find_time_offset
from vapor.inspection.axes import Axes, compare_axes
from vapor.training_data.ground import odometry_segments
from vapor.training_data.training_set import TrainingSet

_USUAL_OFFSET_S = 1.0  # at most, within one recording


@dataclass(frozen=True)
class OdometryCheck:
    """What true poses say of odometry.

    Attributes:
        increments: Images to which odometry leads from the one before, where both have true poses.
        axes: Which way its axes point; None where it moves too little to say.
        late_ms: By recording: how much later odometry's stamps are than those of the true poses, of the same moment.
        unknown_late: By recording: why that cannot be said.
        fit: How wrong it is, with its axes turned as they should be and in the unit of the true poses; None where that
            cannot be said.
        no_fit: Why not.
    """

    increments: int
    axes: Axes | None
    late_ms: dict[str, float]
    unknown_late: dict[str, str]
    fit: OdometryFit | None
    no_fit: str

    @property
    def typical_late_ms(self) -> float | None:
        """Median over recordings."""
        return float(np.median(list(self.late_ms.values()))) if self.late_ms else None

    def as_json(self) -> dict[str, Any]:
        """Figures for the report."""
        axes = self.axes
        return {
            "increments": self.increments,
            "axes": None
            if axes is None
            else {
                "correlation": axes.correlation,
                "correlation_turned": axes.correlation_turned,
                "turned": axes.turned.tolist(),
                "swapped": axes.swapped,
                "off_deg": float(np.degrees(axes.off_rad)),
                "tilted": axes.tilted,
                "mirrored": axes.mirrored,
                "length_ratio": axes.length_ratio,
            },
            "late_ms": dict(self.late_ms),
            "unknown_late": dict(self.unknown_late),
            "fit": None if self.fit is None else asdict(self.fit),
            "no_fit": self.no_fit,
        }


def check_odometry(images: TrainingSet) -> OdometryCheck | None:
    """Compare odometry with the true poses of the same images; None without any odometry between them."""
    segments = odometry_segments(images)
    if not segments:
        return None
    axes = compare_axes([_track(segment) for segment in segments])
    if axes is not None and axes.unit is not None:
        segments = [_scaled(segment, 1 / axes.length_ratio) for segment in segments]
    if axes is not None and axes.swapped:
        segments = [_turned(segment, axes.turned) for segment in segments]
    fit, no_fit = None, ""
    try:
        fit = fit_odometry(segments)
    except SequenceError as error:
        no_fit = str(error)
    late_ms: dict[str, float] = {}
    unknown: dict[str, str] = {}
    for number in sorted({segment.recording for segment in segments}):
        own = [_track(segment) for segment in segments if segment.recording == number]
        odometry, truth = max(own, key=lambda tracks: len(tracks[0]))
        name = images.names[number]
        try:
            late_ms[name] = 1e3 * _late_s(odometry, truth)
        except SequenceError as error:
            unknown[name] = str(error).removesuffix("; give --time-offset-s a number")
    increments = sum(len(segment.odometry) for segment in segments)
    return OdometryCheck(increments, axes, late_ms, unknown, fit, no_fit)


def _late_s(odometry: Trajectory, truth: Trajectory) -> float:
    """How much later odometry is; where a motion that repeats itself allows for several, the one below a second."""
    try:
        return find_time_offset(odometry, truth)
    except SequenceError:
        return find_time_offset(odometry, truth, within_s=_USUAL_OFFSET_S)


def _track(segment: OdometrySegment) -> tuple[Trajectory, Trajectory]:
    """Odometry from its first image on, and the true poses, at the same times."""
    poses = chained([step.previous_from_current for step in segment.odometry])
    seconds = np.concatenate([[0.0], np.cumsum([step.duration_s for step in segment.odometry])])
    times_ns = np.round(seconds * 1e9).astype(np.int64)
    kept = np.flatnonzero(np.diff(times_ns, prepend=-1) > 0)
    return Trajectory(times_ns[kept], poses[kept]), Trajectory(times_ns[kept], segment.truth[kept])


def chained(steps: Sequence[Poses]) -> Poses:
    """Where n motions lead, one after the other, from the identity on, (n + 1,)."""
    return Poses.stack(list(accumulate(steps, Poses.__matmul__, initial=Poses.identity())))


def _scaled(segment: OdometrySegment, factor: float) -> OdometrySegment:
    """The same with odometry in another unit."""
    each = np.diag([factor] * 3 + [1.0] * 3)
    steps = [
        Odometry(
            Poses(step.previous_from_current.rotation, factor * step.previous_from_current.translation),
            each @ step.covariance @ each,
            step.duration_s,
        )
        for step in segment.odometry
    ]
    return OdometrySegment(steps, segment.truth, segment.recording)


def _turned(segment: OdometrySegment, turn: Float64[np.ndarray, "3 3"]) -> OdometrySegment:
    """The same with the axes of odometry turned."""
    about = Poses(turn, np.zeros(3))
    carry = about.adjoint()
    steps = [
        Odometry(
            about @ step.previous_from_current @ about.inverse(), carry @ step.covariance @ carry.T, step.duration_s
        )
        for step in segment.odometry
    ]
    return OdometrySegment(steps, segment.truth, segment.recording)
