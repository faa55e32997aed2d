"""Odometry that comes message by message, in a form that robots have it in -> the motion between any two times."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Literal

import numpy as np
from jaxtyping import Float64

from filtering.errors import VaporTrackError, quoted
from filtering.motion import Odometry, WhiteNoise, covariance_factor, require_odometry
from filtering.se3 import Poses, require_one_pose
from sequences.reading.counts import NOT_INCREASING
from sequences.trajectories.interpolation import MAX_ODOMETRY_GAP_S
from sequences.trajectories.pose_window import PoseWindow

Form = Literal["poses", "velocities", "increments"]
OVERLAPPING = "an increment overlaps the one before"
_FOLLOWS, _FOLLOWS_NS = 0.1, 1_000_000  # of an increment's duration, or so long: it begins where the last one ended


class OdometryStream:
    """The latest odometry of a base, and how the camera on it moved; a `KnownMotion`.

    Messages that cannot be used are left out and counted. Poses may come out of order; velocities and increments, which
    build on those before, may not.

    Attributes:
        skipped: How many messages were left out, by reason.
    """

    def __init__(self, base_from_camera: Poses, motion_noise: WhiteNoise) -> None:
        """Set up a stream without messages; `motion_noise` is that of odometry without a covariance.

        Raises:
            VaporTrackError: the extrinsics are not one finite pose.
        """
        require_one_pose("base_from_camera", base_from_camera)
        self._base_from_camera, self._motion_noise = base_from_camera, motion_noise
        self.skipped = Counter[str]()
        self._form: Form | None = None
        self._window = PoseWindow(MAX_ODOMETRY_GAP_S)
        self._last = Poses.identity()  # of velocities and increments, whose sum is a pose
        self._unknown: list[tuple[int, int]] = []  # times between which there is neither
        self._turns: list[tuple[int, int]] = []  # likewise, of increments of which the rotation alone is known

    def add_pose(
        self, time_ns: int, odom_from_base: Poses, twist_covariance: Float64[np.ndarray, "6 6"] | None = None
    ) -> None:
        """Take a pose of the base, and the covariance of its velocity on the way there.

        Raises:
            VaporTrackError: it is not one finite pose, as `covariance_factor`, or odometry came in another form.
        """
        self._require_form("poses")
        require_one_pose("odometry", odom_from_base)
        self._append("poses", time_ns, odom_from_base, twist_covariance)

    def add_velocity(
        self, time_ns: int, velocity: Float64[np.ndarray, " 6"], covariance: Float64[np.ndarray, "6 6"] | None = None
    ) -> None:
        """Take the base's velocity (v, ω) along and about its axes since the message before, and its covariance.

        After a gap of more than 0.5 s the motion since is unknown.

        Raises:
            VaporTrackError: it is not six finite numbers, as `covariance_factor`, or odometry came in another form.
        """
        self._require_form("velocities")
        velocity = np.asarray(velocity, np.float64)
        if velocity.shape != (6,) or not np.isfinite(velocity).all():
            raise VaporTrackError(f"velocity is {quoted(velocity.tolist())}, expected six finite numbers")
        before_ns = self.end_ns
        seconds = 0.0 if before_ns is None else (time_ns - before_ns) * 1e-9
        is_gap = seconds > MAX_ODOMETRY_GAP_S
        moved = Poses.exp(0.0 * velocity if is_gap else seconds * velocity)
        if self._append("velocities", time_ns, self._last @ moved, covariance) and is_gap and before_ns is not None:
            self._unknown.append((before_ns, time_ns))

    def add_increment(self, time_ns: int, odometry: Odometry) -> None:
        """Take a motion of the base that ended at a time; where it does not begin where the last one ended, the motion
        between is unknown.

        Raises:
            VaporTrackError: as `require_odometry`, or odometry came in another form.
        """
        self._require_form("increments")
        require_odometry(odometry)
        duration_ns, before_ns = round(odometry.duration_s * 1e9), self.end_ns
        begin_ns, near_ns = time_ns - duration_ns, max(_FOLLOWS * duration_ns, _FOLLOWS_NS)
        if before_ns is not None and before_ns - begin_ns > near_ns:
            self.skipped[OVERLAPPING] += 1
            return
        if before_ns is None or begin_ns - before_ns > near_ns:
            self._append("increments", begin_ns, self._last, None)
            if before_ns is not None:
                self._unknown.append((before_ns, begin_ns))
            before_ns = begin_ns
        seconds = max((time_ns - before_ns) * 1e-9, 1e-9)
        moved = self._last @ odometry.previous_from_current
        if self._append("increments", time_ns, moved, odometry.spread_noise / seconds**2) and not (
            odometry.knows_translation
        ):
            self._turns.append((before_ns, time_ns))

    def _append(self, form: Form, time_ns: int, pose: Poses, covariance: Float64[np.ndarray, "6 6"] | None) -> bool:
        """Take a pose of a form; False where it is left out."""
        if covariance is not None:
            covariance = np.asarray(covariance, np.float64)
            covariance_factor(covariance)
        if self._form is None:
            self._form = form
            if form != "poses":  # whose gaps are known
                self._window = PoseWindow(np.inf)
        is_behind = form != "poses" and self.end_ns is not None and time_ns <= self.end_ns
        if is_behind or not self._window.append(time_ns, pose, covariance):
            self.skipped[NOT_INCREASING] += 1
            return False
        self._last = pose.orthonormal()
        return True

    def _require_form(self, form: Form) -> None:
        if self._form not in (None, form):
            raise VaporTrackError(f"odometry as {form} after {self._form}, expected one form")

    @property
    def end_ns(self) -> int | None:
        """Time of the latest odometry; None before any."""
        return self._window.end_ns

    def reaches(self, time_ns: int) -> bool:
        """Whether odometry has come as far as a time."""
        return self._window.reaches(time_ns)

    def covers(self, time_ns: int) -> bool:
        """See `KnownMotion.covers`."""
        return self._window.covers(time_ns) and not any(begin < time_ns < end for begin, end in self._unknown)

    def odometry_between(self, start_ns: int, end_ns: int) -> Odometry | None:
        """See `KnownMotion.odometry_between`."""
        leads = self._window.leads(start_ns, end_ns) if self._form == "poses" else True
        if not leads or _overlap(self._unknown, start_ns, end_ns):
            return None
        moved = self._window.odometry_between(
            start_ns, end_ns, base_from_camera=self._base_from_camera, motion_noise=self._motion_noise
        )
        return moved.rotation_only if moved is not None and _overlap(self._turns, start_ns, end_ns) else moved

    def odom_from_base(self, time_ns: int) -> Poses | None:
        """Pose of the base, one pose; None where odometry does not cover the time."""
        return self._window.at(time_ns) if self.covers(time_ns) else None

    def forget_before(self, time_ns: int) -> None:
        """See `KnownMotion.forget_before`."""
        self._window.forget_before(time_ns)
        self._unknown, self._turns = ([e for e in each if e[1] > time_ns] for each in (self._unknown, self._turns))


def _overlap(spans: Sequence[tuple[int, int]], start_ns: int, end_ns: int) -> bool:
    return any(begin_ns < end_ns and start_ns < over_ns for begin_ns, over_ns in spans)
