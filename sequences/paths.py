"""Walking paths: stamps and poses of their images, halts, and the choice of one by the things in view."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float64, Int64
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


Cues = Literal["early", "any", "none"]
"""How many unique things of a scene a path passes: see `choose_path`."""

Look = Callable[[Poses, int, bool], Bool[np.ndarray, " n"]]
"""Whether each of the first so many images of a path shows something unique; closely, however small."""

_PATHS_TRIED = 100  # one in three will do at 300 images; where none can, as in a very tall image, any must do
_LOOKED_AT = 300  # images
_DETOUR = 4  # a path without anything unique is a segment of one this many times as long


def choose_path(
    cues: Cues, num_images: int, *, poses_per_image: int, draw: Callable[[int], Poses], look: Look
) -> Poses | None:
    """A path of the body that passes as much as asked for.

    Args:
        cues: "early": where there are 100 images or more, something unique shows in their first half, but seldom, so
            that a filter can know where it is; where 100 random paths are not like that, the last of them. "any": the
            first random path. "none": one that never shows anything unique, however small.
        num_images: On the path.
        poses_per_image: Poses of the body from one image to the next.
        draw: A random path for so many images.
        look: The things in view on it.

    Returns:
        Poses of the body, as `draw` gives them; None if 100 random paths had nothing of the kind, with "none" only.
    """
    if cues == "none":
        return _uneventful(num_images, poses_per_image, draw, look)
    base = draw(num_images)
    for _ in range(_PATHS_TRIED - 1):
        if cues == "any" or resolvable(look(base, min(num_images, _LOOKED_AT), False)):
            break
        base = draw(num_images)
    return base


def resolvable(seen: Bool[np.ndarray, " n"]) -> bool:
    """Something unique shows for half a second in the first half, but seldom overall; short paths all pass."""
    return len(seen) < 100 or bool(seen[: len(seen) // 2].sum() >= 5 and seen.mean() < 0.25)


def _uneventful(num_images: int, poses_per_image: int, draw: Callable[[int], Poses], look: Look) -> Poses | None:
    """The first uneventful segment of random paths that are four times as long.

    One such path in twelve through the hall has a segment of 300 images; of paths just that long, one in 350 is one.
    """
    surplus = (_DETOUR - 1) * num_images
    for _ in range(_PATHS_TRIED):
        base = draw(num_images + surplus)
        seen_before = np.concatenate([[0], np.cumsum(look(base, num_images + surplus, True))])
        starts = np.flatnonzero(seen_before[num_images:] == seen_before[:-num_images])
        if len(starts):
            first = poses_per_image * int(starts[0])
            return base[first : first + len(base) - poses_per_image * surplus]
    return None
