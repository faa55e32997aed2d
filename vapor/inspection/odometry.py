"""Odometry against true poses: axes, unit, clock, and errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import accumulate
from typing import Any

import numpy as np
from jaxtyping import Float64

from filtering.motion import Odometry
from filtering.se3 import Poses
from filtering.so3 import nearest_rotation, rotvec_from_rotation
from sequences.errors import SequenceError
from sequences.frame import Trajectory
from sequences.odometry_fit.fit import fit_odometry
from sequences.odometry_fit.pieces import OdometrySegment
from sequences.odometry_fit.result import OdometryFit
from sequences.trajectories.time_offset import find_time_offset
from vapor.training_data.ground import odometry_segments
from vapor.training_data.training_set import TrainingSet

_WINDOW_S = 1.0  # over which motions are compared: noise of single images counts little
LEAST_WINDOWS = 20
"""Number of these from which on motions are compared."""
_AGREES = 0.7  # correlation of motions
_MIRRORED_BETTER = 0.1  # correlation
_UNITS = {"millimetres": 1000.0, "centimetres": 100.0, "inches": 39.37, "feet": 3.281}
_SAME_UNIT, _UNIT_WITHIN = 2.5, 0.25  # of the ratio of lengths, and of its logarithm
_TURNED_RAD = float(np.deg2rad(10.0))
_USUAL_OFFSET_S = 1.0  # at most, within one recording


@dataclass(frozen=True)
class Axes:
    """Directions of odometry's axes against true poses.

    Correlations are of the motions over a second, translation and rotation, 1 where they are the same but for scale: as
    they are, with the rotation `turn` (3, 3) of the camera on its base that makes them most alike, and with the best
    mirroring. The length ratio is odometry's length per metre of the true poses; 1 where these have little in common.
    """

    correlation: float
    turn: Float64[np.ndarray, "3 3"]
    correlation_turned: float
    correlation_mirrored: float
    length_ratio: float

    @property
    def rotvec(self) -> Float64[np.ndarray, "3"]:
        """`turn` as a rotation vector, radians."""
        return rotvec_from_rotation(self.turn)

    @property
    def unit(self) -> str | None:
        """The likely unit of the longer of the two; None where both may be in metres."""
        ratio = max(self.length_ratio, 1 / self.length_ratio)
        if ratio < _SAME_UNIT:
            return None
        near = min(_UNITS, key=lambda name: abs(np.log(ratio / _UNITS[name])))
        return near if abs(np.log(ratio / _UNITS[near])) < _UNIT_WITHIN else "another unit"

    @property
    def is_mirrored(self) -> bool:
        """Whether one of the two is left-handed: a mirroring explains the motions better than any turn."""
        return self.correlation_mirrored >= max(_AGREES, self.correlation_turned + _MIRRORED_BETTER)

    @property
    def is_turned(self) -> bool:
        """Whether a turn of 10° and more explains the motions clearly better than none."""
        is_better = 1.0 - self.correlation_turned < 0.8 * (1.0 - self.correlation)
        is_far = float(np.linalg.norm(self.rotvec)) > _TURNED_RAD
        return not self.is_mirrored and self.correlation_turned >= _AGREES and is_better and is_far

    @property
    def is_unlike(self) -> bool:
        """Whether neither a turn nor a mirroring makes the motions alike."""
        return not self.is_mirrored and self.correlation_turned < _AGREES

    @property
    def turn_in_words(self) -> str:
        """The angle and axis of `turn`."""
        angle = np.linalg.norm(self.rotvec)
        right, down, ahead = self.rotvec / angle
        return f"turned by {np.degrees(angle):.0f}° about ({right:.1f}, {down:.1f}, {ahead:.1f}) (right, down, ahead)"


def compare_axes(tracks: Sequence[tuple[Trajectory, Trajectory]]) -> Axes | None:
    """Compare motions over a second of odometry and true poses, given at the same times for each segment.

    Translations and rotations count in units of their own size. None where the camera moves too little.
    """
    pairs = [_motions(*track) for track in tracks]
    odometry, truth = (np.concatenate([pair[i] for pair in pairs]) for i in range(2))
    if len(odometry) < LEAST_WINDOWS:
        return None
    products = []
    for part in (slice(0, 3), slice(3, 6)):
        size = float(np.linalg.norm(odometry[:, part]) * np.linalg.norm(truth[:, part]))
        products.append(truth[:, part].T @ odometry[:, part] / size if size > 1e-9 else np.zeros((3, 3)))
    moved, turned = products
    count = sum(bool(product.any()) for product in products)
    if count == 0:
        return None
    turn = nearest_rotation(moved + turned)
    mirrored = nearest_rotation(turned - moved)  # seen in a mirror, rotations go the other way
    lengths = [float(np.linalg.norm(each[:, :3], axis=1).sum()) for each in (odometry, truth)]
    is_alike = float(np.linalg.svd(moved, compute_uv=False).sum()) >= _AGREES  # else it is noise that is compared
    return Axes(
        float(np.trace(moved + turned)) / count,
        turn,
        float(np.sum(turn * (moved + turned))) / count,
        float(np.sum(mirrored * (turned - moved))) / count,
        lengths[0] / lengths[1] if is_alike and min(lengths) > 0 else 1.0,
    )


def _motions(odometry: Trajectory, truth: Trajectory) -> tuple[np.ndarray, np.ndarray]:
    begins, at_ns = [0], odometry.times_ns
    while (after := int(np.searchsorted(at_ns, at_ns[begins[-1]] + round(_WINDOW_S * 1e9)))) < len(at_ns):
        begins.append(after)
    at = np.array(begins)
    moved = [(track.poses[at[:-1]].inverse() @ track.poses[at[1:]]).log() for track in (odometry, truth)]
    return moved[0], moved[1]


@dataclass(frozen=True)
class OdometryCheck:
    """Odometry against true poses, of a number of increments.

    The delays of odometry's stamps, or the reasons why they are unknown, are by recording. The fit is of the errors,
    after axes and unit were corrected; None where they are unknown, for the reason `no_fit`.
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
        axes = None
        if self.axes is not None:
            found = {name: getattr(self.axes, name) for name in ("is_mirrored", "is_turned", "is_unlike")}
            axes = {**asdict(self.axes), **found, "turn": self.axes.turn.tolist()}
        return {**asdict(self), "axes": axes}


def check_odometry(images: TrainingSet) -> OdometryCheck | None:
    """Compare odometry with the true poses of the same images; None without any odometry between them."""
    segments = odometry_segments(images)
    if not segments:
        return None
    axes = compare_axes([_track(segment) for segment in segments])
    if axes is not None and (axes.unit is not None or axes.is_turned):
        factor, turn = 1 / axes.length_ratio if axes.unit else 1.0, axes.turn if axes.is_turned else np.eye(3)
        segments = [_carried(segment, factor, turn) for segment in segments]
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
            try:
                late_s = find_time_offset(odometry, truth)
            except SequenceError:  # a motion that repeats itself allows for several
                late_s = find_time_offset(odometry, truth, within_s=_USUAL_OFFSET_S)
            late_ms[name] = 1e3 * late_s
        except SequenceError as error:
            unknown[name] = str(error).removesuffix("; give --time-offset-s a number")
    increments = sum(len(segment.odometry) for segment in segments)
    return OdometryCheck(increments, axes, late_ms, unknown, fit, no_fit)


def _track(segment: OdometrySegment) -> tuple[Trajectory, Trajectory]:
    """Odometry from its first image on, and the true poses, at the same times."""
    poses = chained([step.previous_from_current for step in segment.odometry])
    seconds = np.concatenate([[0.0], np.cumsum([step.duration_s for step in segment.odometry])])
    times_ns = np.round(seconds * 1e9).astype(np.int64)
    kept = np.flatnonzero(np.diff(times_ns, prepend=-1) > 0)
    return Trajectory(times_ns[kept], poses[kept]), Trajectory(times_ns[kept], segment.truth[kept])


def chained(steps: Sequence[Poses]) -> Poses:
    """Poses (n + 1,) along n motions, from the identity on."""
    return Poses.stack(list(accumulate(steps, Poses.__matmul__, initial=Poses.identity())))


def _carried(segment: OdometrySegment, factor: float, turn: Float64[np.ndarray, "3 3"]) -> OdometrySegment:
    """The same with odometry in another unit, and its axes turned."""
    about = Poses(turn, np.zeros(3))
    carry = about.adjoint() @ np.diag([factor] * 3 + [1.0] * 3)
    steps = []
    for step in segment.odometry:
        moved = step.previous_from_current
        moved = about @ Poses(moved.rotation, factor * moved.translation) @ about.inverse()
        steps.append(Odometry(moved, carry @ step.covariance @ carry.T, step.duration_s))
    return OdometrySegment(steps, segment.truth, segment.recording)
