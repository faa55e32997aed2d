"""Rides in lifts, by a barometer: motion that wheels and images of the cabin do not show.

Pressure tells heights to some decimetres over seconds, but drifts by metres in hours, and a door that opens changes it
by as much as a metre. So only rides count: a change by a storey, steadily, within some time.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64, Int64

from filtering.errors import counted
from filtering.motion import Odometry
from filtering.se3 import Poses
from sequences.inertial.rows import TimedRows

_SEA_LEVEL_PA, _SCALE_M, _POWER = 101_325.0, 44_330.0, 0.1903  # of the standard atmosphere
_PASCALS, _HECTOPASCALS = (3e4, 1.2e5), (300.0, 1200.0)
_STEP_NS, _SMOOTH_STEPS = 100_000_000, 11  # heights are averaged over a second
_GAP_NS = 2 * 10**9  # without pressure, across which no ride goes on
_LEAST_M_PER_S, _PAUSE_STEPS = 0.2, 10  # of a lift that moves; and for so long it may seem to pause
_LEAST_M, _LEAST_S = 1.8, 2.0  # of a ride: a storey, and longer than a door takes to open
_STD_M, _RELATIVE = 0.3, 0.05  # standard deviation of a ride's height: of the air, and of its temperature
_STILL_M_PER_S = 0.1  # odometry below this does not show the motion
_MOMENT_S = 0.3  # over which it is judged
_CATCH_UP_S = 1.0  # in which the height comes that a ride had before it was one
_LITTLE = 1e-4  # variance of what is left of it, m²: that comes at once
_FEWEST = 10
_MOST_RIDES = 100  # that are remembered
_CLOCK_SET_NS = 10 * 10**9  # further back no motion is a late one


@dataclass(frozen=True)
class Ride:
    """A ride in a lift, or another steady change of height: from one time to another, and its heights between.

    Attributes:
        times_ns: Stamps, integer nanoseconds, (n,).
        heights_m: Above the first, metres, (n,).
    """

    times_ns: Int64[np.ndarray, " n"]
    heights_m: Float64[np.ndarray, " n"]

    @property
    def variance_per_s(self) -> float:
        """Variance of its height that comes in a second, m²/s."""
        seconds = float(self.times_ns[-1] - self.times_ns[0]) * 1e-9
        return (_STD_M**2 + (_RELATIVE * float(self.heights_m[-1])) ** 2) / seconds

    def risen(self, begin_ns: int, end_ns: int) -> tuple[float, float]:
        """How far it went between two times, metres, and the variance of that."""
        begin_ns, end_ns = max(begin_ns, int(self.times_ns[0])), min(end_ns, int(self.times_ns[-1]))
        if begin_ns >= end_ns:
            return 0.0, 0.0
        risen = np.diff(np.interp([begin_ns, end_ns], self.times_ns, self.heights_m))[0]
        return float(risen), self.variance_per_s * (end_ns - begin_ns) * 1e-9


def height_of(pressure_pa: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, " n"]:
    """Heights in the standard atmosphere, metres."""
    return _SCALE_M * (1.0 - (pressure_pa / _SEA_LEVEL_PA) ** _POWER)


def rides_in(
    times_ns: Int64[np.ndarray, " n"],
    heights_m: Float64[np.ndarray, " n"],
    *,
    goes_on: bool = False,
    known_ns: int | None = None,
) -> list[Ride]:
    """The rides that heights show: changes by 1.8 m and more, within which it moves at 0.2 m/s and more.

    Args:
        times_ns: Stamps, increasing.
        heights_m: By pressure.
        goes_on: Whether later heights will come: those of the last half second are then not known yet.
        known_ns: A time within a ride that was one before: it stays one, even where it goes back.
    """
    rides: list[Ride] = []
    cuts = np.flatnonzero(np.diff(times_ns) > _GAP_NS) + 1
    parts = list(zip(np.split(times_ns, cuts), np.split(heights_m, cuts), strict=True))
    for own_ns, own_m in parts:
        grid_ns = np.arange(own_ns[0], own_ns[-1] + 1, _STEP_NS, dtype=np.int64)
        if len(grid_ns) < 2 * _SMOOTH_STEPS:
            continue
        # The mean of each step first, so that the rate of the samples does not matter.
        step = np.minimum((own_ns - own_ns[0]) // _STEP_NS, len(grid_ns) - 1)
        count = np.bincount(step, minlength=len(grid_ns))
        mean_m = np.bincount(step, own_m, minlength=len(grid_ns)) / np.maximum(count, 1)
        filled = np.flatnonzero(count)
        even_m = np.interp(np.arange(len(grid_ns)), filled, mean_m[filled])
        padded = np.pad(even_m, _SMOOTH_STEPS // 2, mode="edge")
        smooth_m = np.convolve(padded, np.full(_SMOOTH_STEPS, 1.0 / _SMOOTH_STEPS), mode="valid")
        if goes_on and own_ns is parts[-1][0]:
            smooth_m = smooth_m[: -(_SMOOTH_STEPS // 2)]
        rate = np.gradient(smooth_m, _STEP_NS * 1e-9)
        moving = np.flatnonzero(np.abs(rate) > _LEAST_M_PER_S)
        for group in np.split(moving, np.flatnonzero(np.diff(moving) > _PAUSE_STEPS) + 1):
            if len(group) == 0:
                continue
            # What is averaged over a second begins half a second too early, and ends as much too late.
            own = slice(int(group[0]), int(group[-1]) + 1)
            change_m = float(smooth_m[own][-1] - smooth_m[own][0])
            is_ride = abs(change_m) >= _LEAST_M and len(group) * _STEP_NS * 1e-9 >= _LEAST_S
            was_ride = known_ns is not None and grid_ns[own][0] <= known_ns <= grid_ns[own][-1]
            if len(group) > 1 and (is_ride or was_ride):
                rides.append(Ride(grid_ns[own], smooth_m[own] - smooth_m[own][0]))
    return rides


class Barometer:
    """Pressures in, rides out, for whole recordings and for streams alike.

    Args:
        name: Of the topic.

    Attributes:
        num_used: Number of messages that could be used.
    """

    def __init__(self, name: str) -> None:
        self.name, self.num_used = name, 0
        self._said: dict[str, None] = {}
        self.begin_anew()

    def begin_anew(self) -> None:
        """Forget the pressures: their clock was set."""
        self._pressure = TimedRows(1)
        self._known_ns: int | None = None
        self._looked_ns: int | None = None

    @property
    def last_ns(self) -> int | None:
        """Stamp of the latest pressure; None before any."""
        return self._pressure.last_ns

    def take(self, time_ns: int, pressure: float) -> None:
        """Take a pressure of a stamp; one that is no pressure, or not later than those before, is left out."""
        self.num_used += np.isfinite(pressure) and pressure > 0.0 and self._pressure.append(time_ns, [pressure])

    def forget_before(self, time_ns: int) -> None:
        """Drop what only earlier rides need."""
        self._pressure.forget_before(time_ns)

    def rides(self, *, goes_on: bool = False) -> list[Ride]:
        """The rides so far, but for those that were forgotten; for `goes_on` see `rides_in`."""
        last_ns = self._pressure.last_ns
        if last_ns is None or len(self._pressure) < _FEWEST:
            return []
        pressure, usual = self._pressure.rows[:, 0], float(np.median(self._pressure.rows))
        if _HECTOPASCALS[0] < usual < _HECTOPASCALS[1]:
            self._said[f"{self.name}: a pressure of {usual:.0f} is taken for one in hPa, and converted to Pa"] = None
            pressure = pressure * 100.0
        elif not _PASCALS[0] < usual < _PASCALS[1]:
            about = f"{self.name}: the pressure is {usual:.4g} Pa (median), expected about 101325: it is not used"
            self._said[about] = None
            return []
        rides = rides_in(self._pressure.times_ns, height_of(pressure), goes_on=goes_on, known_ns=self._known_ns)
        self._known_ns = int(rides[-1].times_ns[-1]) if rides else None
        return rides

    def has_news(self) -> bool:
        """Whether pressures of a new tenth of a second came since the last call."""
        last_ns, looked_ns = self._pressure.last_ns, self._looked_ns
        if last_ns is None or (looked_ns is not None and last_ns - looked_ns < _STEP_NS):
            return False
        self._looked_ns = last_ns
        return True

    @property
    def notices(self) -> list[str]:
        """Sentences for users, by the messages so far."""
        return [*self._said]


class LiftRides:
    """Adds rides to the odometry of a camera that stands still by it.

    A ride that is known from its beginning adds to each motion what belongs to it. In a stream a ride is known once it
    went a storey; what it went before, while odometry stood still, then comes within some seconds.

    Attributes:
        rides: In order, as far as they are known.
        num_motions: Number of motions that were changed.
    """

    def __init__(self, rides: Sequence[Ride] = ()) -> None:
        self.num_motions = 0
        self.begin_anew()
        self.rides = list(rides)

    def begin_anew(self) -> None:
        """Forget the rides, and what was in motions: a clock was set."""
        self.rides: list[Ride] = []
        self._recent: deque[tuple[float, Float64[np.ndarray, "3"]]] = deque()  # seconds and translation of motions
        self._until_ns: int | None = None  # up to here rides are in the motions, or odometry moved
        self._seen_ns: int | None = None  # end of the latest motion
        self._owed = np.zeros(2)  # height and variance of rides before, which are not in a motion yet

    def extend(self, rides: Sequence[Ride]) -> None:
        """Take rides that are known now: a new one, or one that goes on."""
        for ride in rides:
            while self.rides and self.rides[-1].times_ns[-1] >= ride.times_ns[0]:
                self.rides.pop()
            self.rides.append(ride)
        del self.rides[:-_MOST_RIDES]

    def step(
        self, begin_ns: int, end_ns: int, odometry: Odometry | None, up: tuple[float, float, float] | None
    ) -> Odometry | None:
        """Odometry between two times with the height that rides add; motions that were part of one before stay.

        Args:
            begin_ns, end_ns: The times.
            odometry: Of the camera; None where it is unknown.
            up: About the axes of the camera; None where it is unknown.
        """
        if self._seen_ns is not None and self._seen_ns - end_ns > _CLOCK_SET_NS:
            self.begin_anew()
        if end_ns <= begin_ns or (self._seen_ns is not None and end_ns <= self._seen_ns):
            return odometry
        self._seen_ns = end_ns
        if odometry is None or up is None:
            self._until_ns = end_ns
            return odometry
        rises = np.zeros(2)
        if self._stands((end_ns - begin_ns) * 1e-9, odometry.previous_from_current.translation):
            since_ns = begin_ns if self._until_ns is None else self._until_ns
            for ride in self.rides:
                self._owed += ride.risen(since_ns, begin_ns)
                rises += ride.risen(max(since_ns, begin_ns), end_ns)
                if ride.times_ns[0] < end_ns:
                    since_ns = max(since_ns, min(end_ns, int(ride.times_ns[-1])))
            self._until_ns = since_ns
        else:
            self._until_ns = end_ns
        part = (end_ns - begin_ns) * 1e-9 / _CATCH_UP_S if self._owed[1] > _LITTLE else 1.0
        now = self._owed * min(part, 1.0)
        self._owed -= now
        risen_m, variance = rises + now
        if variance == 0.0:
            return odometry
        self.num_motions += 1
        along = np.append(np.asarray(up), np.zeros(3))
        return replace(
            odometry,
            previous_from_current=odometry.previous_from_current @ Poses.exp(risen_m * along),
            covariance=odometry.covariance + variance * np.outer(along, along),
        )

    def _stands(self, duration_s: float, moved_m: Float64[np.ndarray, "3"]) -> bool:
        """Whether odometry stands still over the last moments, however many motions these are: odometry trembles."""
        self._recent.append((duration_s, moved_m))
        lasted_s = sum(each for each, _ in self._recent)
        while len(self._recent) > 1 and lasted_s - self._recent[0][0] >= _MOMENT_S:
            lasted_s -= self._recent.popleft()[0]
        whole_m = np.sum([each for _, each in self._recent], axis=0)
        return bool(np.linalg.norm(whole_m) <= _STILL_M_PER_S * lasted_s)

    @property
    def notices(self) -> list[str]:
        """Sentences for users, by the motions so far."""
        if not self.num_motions:
            return []
        changes = ", ".join(f"{ride.heights_m[-1]:+.1f} m" for ride in self.rides[:10])
        return [
            f"the barometer shows {counted(len(self.rides), 'ride')} ({changes}), which odometry that stands still gets"
        ]
