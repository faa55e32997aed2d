"""What the motion of people and carts is made of: smooth noise, angles that follow a target, turns of a body."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

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
