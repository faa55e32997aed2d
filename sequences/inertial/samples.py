"""The samples of an inertial measurement unit, about the axes of the camera, message by message.

`sensor_msgs/Imu` by REP-145: specific force (up at rest) in m/s², turn rates in rad/s, and an orientation in a world
whose z is up; a covariance that begins with -1 says that there is none.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float64, Int64

from filtering.errors import counted
from filtering.so3 import rotation_from_quat_xyzw
from sequences.inertial.rows import TimedRows

STANDARD_GRAVITY = 9.80665
"""Metres per second squared."""
_OF_GRAVITY = (0.8, 1.2)  # median specific force in units of gravity
_LEAST_SATURATED, _SATURATED_G = 3, 1.5  # samples in a row at the same largest value, of so much
_UNIT = 0.05  # of a quaternion's length
_ORIENTATION_RAD = 0.02  # standard deviation of tilt where none is stated
_UNKNOWN_TILT = 0.1  # variance from which on an orientation is none, rad²
_AGREE_RAD = 0.35  # median angle between orientation and specific force
_FEWEST = 10
_JUDGED_NS, _JUDGE_AGAIN_NS = 10 * 10**9, 10**9  # samples of so long before count; and for so long a judgement holds


@dataclass(frozen=True)
class InertialSamples:
    """n samples about the axes of the camera, in increasing order of time.

    Attributes:
        times_ns: Stamps, integer nanoseconds, (n,).
        force: Specific force, m/s², (n, 3); NaN where it is unusable.
        turn_rate: rad/s, (n, 3); NaN where there is none.
        up: Up by the unit's own orientation, (n, 3); None where it has none.
        up_std_rad: Standard deviation of its tilt.
        usual_g: Usual length of the specific force, in units of gravity.
    """

    times_ns: Int64[np.ndarray, " n"]
    force: Float64[np.ndarray, "n 3"]
    turn_rate: Float64[np.ndarray, "n 3"]
    up: Float64[np.ndarray, "n 3"] | None = None
    up_std_rad: float = _ORIENTATION_RAD
    usual_g: float = 1.0


@dataclass(frozen=True)
class _Judgement:
    """What the numbers of a unit mean: see `_judged`."""

    force_unit: float  # m/s²; NaN where the force is of no use
    has_rates: bool
    has_orientation: bool
    up_std_rad: float
    usual_g: float
    notices: tuple[str, ...]


class InertialUnit:
    """Messages of a unit in, samples out, for whole recordings and for streams alike.

    What the numbers mean (g or m/s², an orientation or a driver that fills one in) is judged by all that have come
    together, and by those of ten seconds before; in a stream anew each second.

    Attributes:
        num_taken, num_left_out, num_saturated: Numbers of messages that can be used, and cannot, and of samples at the
            end of the sensor's range.
    """

    def __init__(self, name: str, camera_from_imu: Float64[np.ndarray, "3 3"]) -> None:
        """Before the first message of a topic; `camera_from_imu` is a rotation."""
        self.name, self._camera_from_imu = name, camera_from_imu
        self.num_taken = self.num_left_out = self.num_saturated = 0
        self.begin_anew()
        self._said: dict[str, None] = {}

    def begin_anew(self) -> None:
        """Forget the samples: their clock was set."""
        self._raw = TimedRows(14)  # force, turn rate, orientation, whether each is given, variance of tilt
        self._given_ns: int | None = None
        self._judgement: tuple[int, _Judgement] | None = None

    def take(self, time_ns: int | None, message: Any) -> None:
        """Take a message of a stamp; None for a stamp that is of no use, and for undecodable bytes."""
        numbers = None if message is None or time_ns is None else _numbers(message)
        if numbers is not None and time_ns is not None and self._raw.append(time_ns, numbers):
            self.num_taken += 1
        else:
            self.num_left_out += 1

    @property
    def last_ns(self) -> int | None:
        """Stamp of the latest message; None before any."""
        return self._raw.last_ns

    def samples(self) -> InertialSamples | None:
        """The samples since the last call; None where there are none, or too few to judge them."""
        times_ns, table = self._raw.times_ns, self._raw.rows
        first = 0 if self._given_ns is None else int(np.searchsorted(times_ns, self._given_ns, side="right"))
        if first == len(times_ns) or len(times_ns) < _FEWEST:
            return None
        last_ns = self._given_ns = int(times_ns[-1])
        if self._judgement is None or last_ns - self._judgement[0] > _JUDGE_AGAIN_NS:
            self._judgement = last_ns, _judged(self.name, table)
            self._said |= dict.fromkeys(self._judgement[1].notices)
        judgement = self._judgement[1]
        force = table[:, :3] * judgement.force_unit
        force[table[:, 10] == 0.0] = np.nan
        saturated = _saturated(force)
        force[saturated] = np.nan
        self.num_saturated += int(saturated[first:].sum())
        force, rate = force[first:], table[first:, 3:6].copy()
        rate[(table[first:, 11] == 0.0) | (not judgement.has_rates)] = np.nan
        up = _up_of(table[first:]) @ self._camera_from_imu.T if judgement.has_orientation else None
        self._raw.forget_before(last_ns - _JUDGED_NS)
        return InertialSamples(
            times_ns[first:],
            force @ self._camera_from_imu.T,
            rate @ self._camera_from_imu.T,
            up,
            judgement.up_std_rad,
            judgement.usual_g,
        )

    @property
    def notices(self) -> list[str]:
        """Sentences for users, by the messages so far."""
        notices = []
        if self.num_left_out:
            notices.append(
                f"unusable, or not later than those before: {counted(self.num_left_out, 'message')} of {self.name}"
            )
        notices += self._said
        if self.num_saturated:
            notices.append(f"{self.name}: {counted(self.num_saturated, 'sample')} saturated, and not used")
        return notices


def _numbers(message: Any) -> list[float] | None:
    """Force, turn rate, orientation and whether each is given, and the variance of tilt; None where not finite."""
    a, w, q = message.linear_acceleration, message.angular_velocity, message.orientation
    numbers = [float(each) for each in (a.x, a.y, a.z, w.x, w.y, w.z, q.x, q.y, q.z, q.w)]
    given = [
        float(each[0] != -1.0)
        for each in (
            message.linear_acceleration_covariance,
            message.angular_velocity_covariance,
            message.orientation_covariance,
        )
    ]
    tilt = float(message.orientation_covariance[0] + message.orientation_covariance[4]) / 2.0
    if not np.isfinite([*numbers[6:], tilt]).all():  # drivers without one fill in NaN
        numbers[6:], given[2], tilt = [0.0] * 4, 0.0, 0.0
    numbers = [*numbers, *given, tilt]
    return numbers if np.isfinite(numbers).all() else None


def _judged(name: str, table: Float64[np.ndarray, "n 14"]) -> _Judgement:
    """What numbers mean, by many of them.

    Args:
        name: Of the topic.
        table: Force, turn rate, orientation as x y z w, whether each of these is given, variance of tilt.
    """
    force, rate, notices = table[:, :3].copy(), table[table[:, 11] != 0.0, 3:6], list[str]()
    force[table[:, 10] == 0.0] = np.nan
    lengths = np.linalg.norm(force, axis=1)
    usual, unit = float(np.median(lengths[np.isfinite(lengths)])) if np.isfinite(lengths).any() else np.nan, 1.0
    if _OF_GRAVITY[0] < usual < _OF_GRAVITY[1]:
        notices.append(f"{name}: a specific force of {usual:.2f} is taken for one in g, and converted to m/s²")
        unit = STANDARD_GRAVITY
    elif np.isfinite(usual) and not _OF_GRAVITY[0] < usual / STANDARD_GRAVITY < _OF_GRAVITY[1]:
        notices.append(
            f"{name}: the specific force is {usual:.3g} m/s² (median), expected about {STANDARD_GRAVITY:.2f}: it is"
            " not used (a driver that takes gravity out, or another unit)"
        )
        unit = np.nan
    usual_g = usual * unit / STANDARD_GRAVITY
    has_rates = bool(np.any(rate))  # else a driver fills in zeros
    has_orientation, std_rad = _has_orientation(table)
    if has_orientation:
        cosine = np.vecdot(_up_of(table), force * unit) / np.maximum(lengths * unit, 1e-12)
        cosine = cosine[np.isfinite(cosine)]
        off_rad = float(np.arccos(np.clip(np.median(cosine), -1.0, 1.0))) if len(cosine) else 0.0
        if off_rad > _AGREE_RAD:
            notices.append(
                f"{name}: its orientation is off the specific force by {np.degrees(off_rad):.0f}° (median), and not"
                " used"
            )
            has_orientation = False
    return _Judgement(unit, has_rates, has_orientation, std_rad, usual_g if np.isfinite(usual_g) else 1.0, (*notices,))


def _has_orientation(table: Float64[np.ndarray, "n 14"]) -> tuple[bool, float]:
    """Whether a unit states its orientation, and the standard deviation of the tilt.

    Zeros, and the identity throughout, are none: drivers fill them in.
    """
    quat, given = table[:, 6:10], table[:, 12] == 1.0
    unit = np.abs(np.linalg.norm(quat, axis=1) - 1.0) < _UNIT
    filled_in = np.ptp(quat, axis=0).max() == 0.0 and abs(quat[0, 3]) == 1.0
    variance = float(np.median(table[:, 13]))
    is_one = bool((given & unit).all()) and not filled_in and variance <= _UNKNOWN_TILT
    return is_one, float(np.sqrt(variance)) if is_one and variance > 0.0 else _ORIENTATION_RAD


def _up_of(table: Float64[np.ndarray, "n 14"]) -> Float64[np.ndarray, "n 3"]:
    """Up about the unit's axes, by its orientation; NaN where that is none."""
    lengths = np.linalg.norm(table[:, 6:10], axis=1, keepdims=True)
    is_one = (table[:, 12] == 1.0) & (np.abs(lengths[:, 0] - 1.0) < _UNIT)
    up = np.full((len(table), 3), np.nan)
    up[is_one] = rotation_from_quat_xyzw(table[is_one, 6:10] / lengths[is_one])[:, 2, :]
    return up


def _saturated(force: Float64[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
    """Which samples are at the largest value of an axis, several in a row: the end of the sensor's range."""
    found = np.zeros(len(force), bool)
    for axis in np.abs(force).T:
        largest = np.nanmax(axis) if np.isfinite(axis).any() else 0.0
        if largest < _SATURATED_G * STANDARD_GRAVITY:
            continue
        at = axis >= largest * (1.0 - 1e-9)
        ends = np.flatnonzero(np.diff(np.concatenate([[0], at.astype(int), [0]])))
        for begin, end in zip(ends[::2], ends[1::2], strict=True):
            if end - begin >= _LEAST_SATURATED:
                found[begin:end] = True
    return found
