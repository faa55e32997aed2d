"""A cart that wanders about the hall."""

from __future__ import annotations

import numpy as np

from filtering.se3 import Poses
from sequences.paths.motion import STEP_S, rotations, wander
from sequences.scenes.ceiling import dimensions as ceiling


def roll_through_hall(duration_s: float, *, margin_m: float, rng: np.random.Generator) -> Poses:
    """A cart wandering about the hall: world_from_base every 20 ms, x forward, z up, on the floor.

    It heads for one random place after another, turning no tighter than a cart can.
    """
    steps = int(np.ceil(duration_s / STEP_S)) + 1
    low = np.full(2, margin_m)
    high = np.array([ceiling.LENGTH, ceiling.BREADTH]) - margin_m
    position, heading, rate, speed = rng.uniform(low, high), rng.uniform(-np.pi, np.pi), 0.0, 0.6
    goal = rng.uniform(low, high)
    xy, yaw = np.empty((steps, 2)), np.empty(steps)
    pace = 0.6 + 0.08 * wander(steps, 5.0, rng)
    for i in range(steps):
        if np.hypot(*(goal - position)) < 0.7:
            goal = rng.uniform(low, high)
        to_goal = np.arctan2(goal[1] - position[1], goal[0] - position[0]) - heading
        to_goal = (to_goal + np.pi) % (2 * np.pi) - np.pi
        rate += (min(max(1.2 * to_goal, -0.75), 0.75) - rate) * STEP_S / 0.4
        speed += (pace[i] * (1 - 0.55 * min(1.0, abs(rate) / 0.75)) - speed) * STEP_S / 0.5
        heading += rate * STEP_S
        position = position + speed * STEP_S * np.array([np.cos(heading), np.sin(heading)])
        position = np.minimum(np.maximum(position, 0.5 * low), high + 0.5 * low)  # in half the time of np.clip
        xy[i], yaw[i] = position, heading
    tilt = 0.006 * np.stack([wander(steps, 0.6, rng), wander(steps, 0.6, rng)])
    height = 0.002 * wander(steps, 0.4, rng)
    return Poses(rotations(yaw, tilt[0], tilt[1]), np.column_stack([xy, height]))
