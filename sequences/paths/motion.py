"""Motion of people and carts (smooth noise, angles that follow a target, stands), and the stamps along their paths."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from filtering.se3 import Poses

STEP_S = 0.02
"""Seconds from one pose of a path to the next."""


def wander(steps: int, time_s: float, rng: np.random.Generator) -> Float64[np.ndarray, " n"]:
    """Smooth noise of unit deviation that changes over `time_s`."""
    sigma = time_s / STEP_S / 2
    pad = int(4 * sigma)
    noise = gaussian_filter1d(rng.standard_normal(steps + 2 * pad), sigma)[pad : pad + steps]
    return noise * np.sqrt(2 * np.sqrt(np.pi) * sigma)


def eased(value: np.ndarray, time_s: float) -> np.ndarray:
    """Values every 20 ms, smoothed over a time."""
    return gaussian_filter1d(value, time_s / STEP_S)


def eased_angle(target: np.ndarray, *, time_s: float, max_rate: float) -> np.ndarray:
    """An angle that follows a target with a lag and a greatest rate, radians per second."""
    angle, rate = np.empty(len(target)), 0.0
    current = float(target[0])
    for i, goal in enumerate(target.tolist()):
        error = (goal - current + np.pi) % (2 * np.pi) - np.pi
        rate += (min(max(error / time_s, -max_rate), max_rate) - rate) * STEP_S / 0.12
        current += rate * STEP_S
        angle[i] = current
    return angle


def rotations(yaw: np.ndarray, pitch: np.ndarray, roll: np.ndarray) -> Float64[np.ndarray, "n 3 3"]:
    """Body axes from angles, in radians: about z, then y, then x."""
    return Rotation.from_euler("ZYX", np.stack([yaw, pitch, roll], axis=1)).as_matrix()


IMAGE_RATE_HZ = 10.0
"""Paths are chosen by what is seen at this rate, and made to last so long; that of all scenes but buildings."""
IMAGE_PERIOD_NS, ODOMETRY_PERIOD_NS = 100_000_000, 20_000_000
EPOCH_NS = 1_700_000_000_000_000_000  # the first odometry message
_LEAD_NS = 513_000_000  # the first image comes later, and between two odometry messages
TAIL_S = 0.5  # of odometry after the last image at 10 Hz
EXPOSURE_S = 0.014  # of an image, around its stamp


def image_stamps(count: int, rate_hz: float = IMAGE_RATE_HZ) -> Int64[np.ndarray, " n"]:
    """Stamps of so many images."""
    since_first = np.round(np.arange(count) * 1e9 / rate_hz).astype(np.int64)
    return EPOCH_NS + _LEAD_NS + since_first


def odometry_stamps(base: Poses) -> Int64[np.ndarray, " k"]:
    """Stamps of the odometry along a path."""
    return EPOCH_NS + round(STEP_S * 1e9) * np.arange(len(base), dtype=np.int64)


def poses_at(times_ns: np.ndarray, poses: Poses, query_ns: np.ndarray) -> Poses:
    """Poses at other times, along the geodesic between neighbours."""
    after = np.clip(np.searchsorted(times_ns, query_ns, side="right"), 1, len(times_ns) - 1)
    fraction = (query_ns - times_ns[after - 1]) / (times_ns[after] - times_ns[after - 1])
    return poses[after - 1].interpolate(poses[after], fraction)


_STOPPING_S = 0.4  # to come to rest, and to walk again


@dataclass(frozen=True)
class Stand:
    """The camera comes to rest and stands, perfectly still, on a path that is otherwise as it would be.

    Attributes:
        image: The first image at rest; the last 0.4 s before it are slower.
        duration_s: How long; rounded to whole images, at least one.
        walks_on: Whether the rest of the path follows; else the sequence ends.
    """

    image: int
    duration_s: float
    walks_on: bool = False


def halted(base: Poses, image_time_ns: int, duration_s: float, *, walks_on: bool) -> Poses:
    """The path of the body as it is walked with a stand: at rest from half an exposure before the image on."""
    times_ns = odometry_stamps(base)
    still_from = int(np.searchsorted(times_ns, image_time_ns - round(EXPOSURE_S * 0.5e9), side="right")) - 1
    steps, ramp_steps = math.ceil(duration_s / STEP_S) + 2, round(_STOPPING_S / STEP_S)
    ramp = (np.arange(ramp_steps) + 0.5) / ramp_steps  # fraction of the speed
    before = np.concatenate([np.ones(max(still_from - ramp_steps, 0)), ramp[::-1]])[-still_from:]
    after = np.concatenate([ramp, np.ones(len(base))])[: len(base) - 1 - still_from]
    if not walks_on:
        after = np.zeros(round(TAIL_S / STEP_S))
    step_ns = round(STEP_S * 1e9)
    walked_ns = step_ns * np.concatenate([[0.0], np.cumsum(np.concatenate([before, np.zeros(steps), after]))])
    return poses_at(times_ns, base, times_ns[0] + np.round(walked_ns).astype(np.int64))
