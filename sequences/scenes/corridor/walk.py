"""A person who walks up and down the corridor of one floor."""

from __future__ import annotations

import numpy as np

from filtering.se3 import Poses
from sequences.paths.motion import STEP_S, eased, rotations, wander
from sequences.scenes.corridor import dimensions as corridor


def walk_corridor(duration_s: float, *, rng: np.random.Generator) -> Poses:
    """A person walking up and down the corridor of one floor: world_from_base every 20 ms, x forward, z up.

    Starts anywhere on either floor, either way; turns round at the ends and now and then elsewhere, seldom pauses,
    glances to the sides, sways and bobs with every step.
    """
    steps = int(np.ceil(duration_s / STEP_S)) + 1
    low, high = 1.3, corridor.LENGTH - 1.3
    level, x, way = rng.integers(corridor.NUM_FLOORS), rng.uniform(low, high), rng.choice([-1.0, 1.0])
    heading, speed, pause, pace = 0.0 if way > 0 else np.pi, 0.0, 0.0, rng.uniform(1.1, 1.3)
    chance = rng.random((steps, 3))
    place, walking, headings = np.empty(steps), np.empty(steps), np.empty(steps)
    for i in range(steps):
        at_end = (way > 0 and x > high - 0.3) or (way < 0 and x < low + 0.3)
        if at_end or (pause <= 0 and chance[i, 0] < STEP_S / 120):
            way, pause = -way, 0.9
            heading += np.pi if chance[i, 2] < 0.5 else -np.pi
        elif pause <= 0 and chance[i, 1] < STEP_S / 60:
            pause = 0.6 + 1.5 * chance[i, 2]
        pause -= STEP_S
        speed += ((0.0 if pause > 0 else way * pace) - speed) * STEP_S / 0.3
        x = min(max(x + speed * STEP_S, low - 0.3), high + 0.3)
        place[i], walking[i], headings[i] = x, abs(speed), heading
    phase = np.pi * np.cumsum(walking) * STEP_S / 0.65 + rng.uniform(0, 2 * np.pi)  # π a step
    stride = np.clip(walking / 0.9, 0, 1)
    aside = np.clip(np.abs(wander(steps, 2.5, rng)) - 1.0, 0, 1) * np.sign(wander(steps, 8.0, rng))
    yaw = eased(headings, 0.45) + 0.15 * wander(steps, 1.6, rng) + 0.9 * eased(aside, 0.3)
    yaw += 0.02 * stride * np.sin(phase + 0.5)
    pitch = -0.1 + 0.05 * wander(steps, 2.0, rng) + 0.01 * stride * np.sin(2 * phase + 1.0)
    roll = 0.012 * wander(steps, 1.0, rng) + 0.015 * stride * np.sin(phase)
    across = 0.45 * np.tanh(0.8 * wander(steps, 6.0, rng)) + 0.022 * stride * np.sin(phase)
    up = 1.5 + 0.02 * stride * np.cos(2 * phase) + 0.03 * wander(steps, 5.0, rng)
    position = np.column_stack([place, corridor.WIDTH / 2 + across, level * corridor.FLOOR_HEIGHT + up])
    return Poses(rotations(yaw, pitch, roll), position)
