"""Odometry against true poses: which way its axes point, its clock, and how wrong it is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import accumulate, permutations, product
from typing import Any

import numpy as np
from jaxtyping import Float64

from filtering.motion import Odometry
from filtering.se3 import Poses, nearest_rotation
from sequences.errors import SequenceError
from sequences.frame import Trajectory
from sequences.odometry_fit.fit import fit_odometry
from sequences.odometry_fit.pieces import OdometrySegment
from sequences.odometry_fit.result import OdometryFit
from sequences.trajectories.time_offset import find_time_offset
from vapor.training_data.passes import odometry_segments
from vapor.training_data.training_set import TrainingSet

_WINDOW_S = 1.0  # over which motions are compared: noise of single images counts little
_LEAST_WINDOWS = 20
_AGREES, _BETTER = 0.7, 0.2  # correlation of motions, and by how much another way must be better
_MIRRORED_BETTER = 0.1  # correlation
_UNITS = {"millimetres": 1000.0, "centimetres": 100.0, "inches": 39.37, "feet": 3.281}
_SAME_UNIT, _UNIT_WITHIN = 2.5, 0.25  # of the ratio of lengths, and of its logarithm
_TURNED_RAD = float(np.deg2rad(10.0))
_DIRECTIONS = (("right", "left"), ("down", "up"), ("forward", "back"))  # of a camera's axes: there and back


@dataclass(frozen=True)
class Axes:
    """Directions of odometry's axes against true poses.

    Correlations are of the motions, translation and rotation, 1 where they are the same but for scale: as they are,
    with the quarter turns `turned` (3, 3) of the camera on its base that make them most alike, with the best turn of
    all, by the angle `off_rad`, and with the best mirroring along an axis. The length ratio is odometry's length per
    metre of the true poses; 1 where these have little in common.
    """

    correlation: float
    turned: Float64[np.ndarray, "3 3"]
    correlation_turned: float
    off_rad: float
    correlation_best: float
    correlation_mirrored: float
    length_ratio: float

    @property
    def mirrored(self) -> bool:
        """Whether one of the two is left-handed: a mirroring explains the motions better than any turn."""
        turned = max(self.correlation, self.correlation_turned, self.correlation_best)
        return self.correlation_mirrored >= _AGREES and self.correlation_mirrored > turned + _MIRRORED_BETTER

    @property
    def unit(self) -> str | None:
        """The likely unit of the longer of the two; None where both may be in metres."""
        ratio = max(self.length_ratio, 1 / self.length_ratio)
        if ratio < _SAME_UNIT:
            return None
        near = min(_UNITS, key=lambda name: abs(np.log(ratio / _UNITS[name])))
        return near if abs(np.log(ratio / _UNITS[near])) < _UNIT_WITHIN else "another unit"

    @property
    def swapped(self) -> bool:
        """Whether quarter turns explain the motions much better than none."""
        better = self.correlation_turned > self.correlation + _BETTER
        return not self.mirrored and self.correlation_turned >= _AGREES and better

    @property
    def tilted(self) -> bool:
        """Whether another turn, of 10° and more, does."""
        better = 1.0 - self.correlation_best < 0.8 * (1.0 - self.correlation)
        if self.mirrored or self.swapped:
            return False
        return self.correlation_best >= _AGREES and better and self.off_rad > _TURNED_RAD

    @property
    def unlike(self) -> bool:
        """Whether neither a turn nor a mirroring makes the motions alike."""
        return not self.mirrored and max(self.correlation, self.correlation_turned, self.correlation_best) < _AGREES

    def in_words(self) -> str:
        """The swapped axes and their counterparts."""
        parts = []
        for axis in (2, 0, 1):
            seen = self.turned[:, axis]
            number = int(np.argmax(np.abs(seen)))
            if number != axis or seen[number] < 0:
                parts.append(
                    f"{_DIRECTIONS[axis][0]} looks like the true poses' {_DIRECTIONS[number][int(seen[number] < 0)]}"
                )
        return "odometry's " + ", its ".join(parts)


def compare_axes(tracks: Sequence[tuple[Trajectory, Trajectory]]) -> Axes | None:
    """Compare motions over a second of odometry and true poses, given at the same times for each segment.

    Translations and rotations count in units of their own size. None where the camera moves too little.
    """
    pairs = [_motions(*track) for track in tracks]
    odometry, truth = (np.concatenate([pair[i] for pair in pairs]) for i in range(2))
    if len(odometry) < _LEAST_WINDOWS:
        return None
    moved, turns, sizes = np.zeros((3, 3)), np.zeros((3, 3)), 0.0
    for products, part in ((moved, slice(0, 3)), (turns, slice(3, 6))):
        size = float(np.linalg.norm(odometry[:, part]) * np.linalg.norm(truth[:, part]))
        if size > 1e-9:
            products += truth[:, part].T @ odometry[:, part] / size
            sizes += 1.0
    if sizes == 0.0:
        return None

    def correlation(turn: np.ndarray) -> float:
        return float(np.sum(turn * (moved + np.linalg.det(turn) * turns))) / sizes  # mirrored turns go the other way

    quarters = [np.eye(3), *(turn for turn in _quarter_turns() if not np.allclose(turn, np.eye(3)))]
    turned = max(quarters, key=lambda turn: round(correlation(turn), 3))  # the first of equals
    best = nearest_rotation(moved + turns)
    _, off_rad = Poses(best, np.zeros(3)).distance(Poses.identity())
    mirrored = max(correlation(turn @ np.diag([1.0, -1.0, 1.0])) for turn in quarters)
    lengths = [float(np.linalg.norm(each[:, :3], axis=1).sum()) for each in (odometry, truth)]
    alike = float(np.linalg.svd(moved, compute_uv=False).sum()) >= _AGREES  # else it is noise that is compared
    ratio = lengths[0] / lengths[1] if alike and min(lengths) > 0 else 1.0
    return Axes(correlation(np.eye(3)), turned, correlation(turned), float(off_rad), correlation(best), mirrored, ratio)


def _motions(odometry: Trajectory, truth: Trajectory) -> tuple[np.ndarray, np.ndarray]:
    begins, at_ns = [0], odometry.times_ns
    while (after := int(np.searchsorted(at_ns, at_ns[begins[-1]] + round(_WINDOW_S * 1e9)))) < len(at_ns):
        begins.append(after)
    at = np.array(begins)
    moved = [(track.poses[at[:-1]].inverse() @ track.poses[at[1:]]).log() for track in (odometry, truth)]
    return moved[0], moved[1]


def _quarter_turns() -> list[Float64[np.ndarray, "3 3"]]:
    found = []
    for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
        turn = np.zeros((3, 3))
        turn[list(order), range(3)] = signs
        if np.linalg.det(turn) > 0:
            found.append(turn)
    return found


_USUAL_OFFSET_S = 1.0  # at most, within one recording


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
        axes = self.axes
        figures = None
        if axes is not None:
            names = ("correlation", "correlation_turned", "swapped", "tilted", "mirrored", "length_ratio")
            figures = {name: getattr(axes, name) for name in names}
            figures |= {"turned": axes.turned.tolist(), "off_deg": float(np.degrees(axes.off_rad))}
        return {
            "increments": self.increments,
            "axes": figures,
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
    if axes is not None and (axes.unit is not None or axes.swapped):
        factor, turn = 1 / axes.length_ratio if axes.unit else 1.0, axes.turned if axes.swapped else np.eye(3)
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
