"""Rides in lifts, by a barometer: motion that wheels and images of the cabin do not show.

Pressure tells heights to some decimetres over seconds, but drifts by metres in hours, and a door that opens changes it
by as much as a metre. So only rides count: a change by a storey, steadily, within some time.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float64, Int64

from filtering.motion import Odometry
from filtering.se3 import Poses
from sequences.options import SequenceOptions
from sequences.reading.timeline import Timeline
from sequences.recordings.bag import Bag
from sequences.recordings.source import choose

_SEA_LEVEL_PA, _SCALE_M, _POWER = 101_325.0, 44_330.0, 0.1903  # of the standard atmosphere
_PASCALS, _HECTOPASCALS = (3e4, 1.2e5), (300.0, 1200.0)
_STEP_NS, _SMOOTH_STEPS = 100_000_000, 11  # heights are averaged over a second
_GAP_NS = 2 * 10**9  # without pressure, across which no ride goes on
_LEAST_M_PER_S, _PAUSE_STEPS = 0.2, 10  # of a lift that moves; and for so long it may seem to pause
_LEAST_M, _LEAST_S = 1.8, 2.0  # of a ride: a storey, and longer than a door takes to open
_STD_M, _RELATIVE = 0.3, 0.05  # standard deviation of a ride's height: of the air, and of its temperature
_STILL_M_PER_S = 0.1  # odometry below this does not show the motion
_MOMENT_S = 0.3  # over which it is judged
_FEWEST = 10
_TYPE = "sensor_msgs/FluidPressure"


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


def height_of(pressure_pa: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, " n"]:
    """Heights in the standard atmosphere, metres."""
    return _SCALE_M * (1.0 - (pressure_pa / _SEA_LEVEL_PA) ** _POWER)


def rides_in(times_ns: Int64[np.ndarray, " n"], heights_m: Float64[np.ndarray, " n"]) -> list[Ride]:
    """The rides that heights show: changes by 1.8 m and more, within which it moves at 0.2 m/s and more.

    Args:
        times_ns: Stamps, increasing.
        heights_m: By pressure.
    """
    rides: list[Ride] = []
    cuts = np.flatnonzero(np.diff(times_ns) > _GAP_NS) + 1
    for own_ns, own_m in zip(np.split(times_ns, cuts), np.split(heights_m, cuts), strict=True):
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
        rate = np.gradient(smooth_m, _STEP_NS * 1e-9)
        moving = np.flatnonzero(np.abs(rate) > _LEAST_M_PER_S)
        for group in np.split(moving, np.flatnonzero(np.diff(moving) > _PAUSE_STEPS) + 1):
            if len(group) == 0:
                continue
            # What is averaged over a second begins half a second too early, and ends as much too late.
            own = slice(int(group[0]), int(group[-1]) + 1)
            change_m = float(smooth_m[own][-1] - smooth_m[own][0])
            if abs(change_m) >= _LEAST_M and len(group) * _STEP_NS * 1e-9 >= _LEAST_S:
                rides.append(Ride(grid_ns[own], smooth_m[own] - smooth_m[own][0]))
    return rides


class LiftRides:
    """Adds rides to the odometry of a camera that stands still by it.

    Attributes:
        rides: In order.
        num_motions: Number of motions that were changed.
    """

    def __init__(self, rides: list[Ride]) -> None:
        self.rides, self.num_motions = rides, 0
        self._recent: deque[tuple[float, Float64[np.ndarray, "3"]]] = deque()  # seconds and translation of motions

    def step(
        self, begin_ns: int, end_ns: int, odometry: Odometry | None, up: tuple[float, float, float] | None
    ) -> Odometry | None:
        """Odometry between two times with the height that a ride adds.

        Args:
            begin_ns, end_ns: The times.
            odometry: Of the camera; None where it is unknown.
            up: About the axes of the camera; None where it is unknown.
        """
        if odometry is None or up is None or end_ns <= begin_ns:
            return odometry
        if not self._stands((end_ns - begin_ns) * 1e-9, odometry.previous_from_current.translation):
            return odometry
        for ride in self.rides:
            first, last = max(begin_ns, int(ride.times_ns[0])), min(end_ns, int(ride.times_ns[-1]))
            if first < last:
                risen = np.diff(np.interp([first, last], ride.times_ns, ride.heights_m))[0]
                variance = ride.variance_per_s * (last - first) * 1e-9
                along = np.append(np.asarray(up), np.zeros(3))
                self.num_motions += 1
                return replace(
                    odometry,
                    previous_from_current=odometry.previous_from_current @ Poses.exp(risen * along),
                    covariance=odometry.covariance + variance * np.outer(along, along),
                )
        return odometry

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
        return [f"the barometer shows {len(self.rides)} rides ({changes}), which odometry that stands still gets"]


def read_rides(path: Path, options: SequenceOptions) -> tuple[list[Ride], list[str]]:
    """The rides by `sensor_msgs/FluidPressure` of a recording, and sentences for users; none without a barometer.

    Args:
        path: MCAP file, rosbag2 folder or ROS 1 bag.
        options: The topic; without a name the one with the most messages.

    Raises:
        SequenceError: the file is damaged, or the topic named is missing or of another type.
    """
    bag = Bag(path, stamps=options.stamps, tf_topic=options.tf_topic)
    known = [topic for topic in bag.topics.values() if topic.read_as == _TYPE and topic.num_messages]
    topic = max(known, key=lambda topic: topic.num_messages, default=None)
    if options.pressure_topic is not None:
        topic = choose(bag, "pressure", (_TYPE,), options.pressure_topic)
    if topic is None:
        return [], []
    times: list[int] = []
    values: list[float] = []
    for dated in Timeline(bag, {topic.name: None}).messages(topic.name):
        if dated.message is None or not dated.stamps_ns:
            continue
        time_ns, value = dated.stamps_ns[0][1], float(dated.message.fluid_pressure)
        if np.isfinite(value) and value > 0.0 and (not times or time_ns > times[-1]):
            times.append(time_ns)
            values.append(value)
    if len(values) < _FEWEST:
        return [], [f"{topic.name}: {len(values)} messages can be used, expected at least {_FEWEST}"]
    pressure, usual, notices = np.array(values), float(np.median(values)), []
    if _HECTOPASCALS[0] < usual < _HECTOPASCALS[1]:
        notices.append(f"{topic.name}: a pressure of {usual:.0f} is taken for one in hPa, and converted to Pa")
        pressure *= 100.0
    elif not _PASCALS[0] < usual < _PASCALS[1]:
        return [], [f"{topic.name}: the pressure is {usual:.4g} Pa (median), expected about 101325: it is not used"]
    return rides_in(np.array(times, np.int64), height_of(pressure)), notices
