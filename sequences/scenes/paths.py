"""How bodies move: a person on the stairs or in the corridor, a cart in the hall, a person about a table."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from filtering.se3 import Poses
from sequences.scenes import ceiling, corridor, staircase, tables

STEP_S = 0.02  # spacing of the poses


def walk_stairs(duration_s: float, *, rng: np.random.Generator) -> Poses:
    """A person going up and down the stairwell: world_from_base every 20 ms, x forward, z up, at eye height.

    Starts anywhere, either way; pauses, looks about, now and then turns round; sways and bobs with every step.
    """
    line, length = _stair_line()
    steps = int(np.ceil(duration_s / STEP_S)) + 1
    place = np.empty(steps)
    walking = np.empty(steps)
    s, way, speed, pause = rng.uniform(0, length), rng.choice([-1.0, 1.0]), 0.0, 0.0
    pace = rng.uniform(0.55, 0.75)
    chance = rng.random((steps, 2))
    ways = np.empty(steps)
    for i in range(steps):
        if (way > 0 and s > length - 0.25) or (way < 0 and s < 0.25) or (pause <= 0 and chance[i, 0] < STEP_S / 45):
            way, pause = -way, 0.8
        elif pause <= 0 and chance[i, 1] < STEP_S / 20:
            pause = 0.6 + 2.0 * chance[i, 0]
        pause -= STEP_S
        speed += ((0.0 if pause > 0 else way * pace) - speed) * STEP_S / 0.3
        s = float(np.clip(s + speed * STEP_S, 0, length))
        place[i], walking[i], ways[i] = s, abs(speed), way

    def at(distance: np.ndarray) -> np.ndarray:
        sample = np.clip(distance, 0, length)
        return np.stack([np.interp(sample, line[:, 3], line[:, axis]) for axis in range(3)], axis=-1)

    here = at(place)
    tangent = at(place + 0.1) - at(place - 0.1)
    side = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1) / (np.linalg.norm(tangent[:, :2], axis=1)[:, None] + 1e-9)
    ahead = at(place + 0.45 * ways) - at(place - 0.2 * ways)
    heading = _eased_angle(np.arctan2(ahead[:, 1], ahead[:, 0]), time_s=0.35, max_rate=2.4)
    phase = np.pi * np.cumsum(walking) * STEP_S / 0.33 + rng.uniform(0, 2 * np.pi)  # π a step
    stride = np.clip(walking / 0.5, 0, 1)
    glance = (
        wander(steps, 1.6, rng) * 0.22
        + _eased(np.clip(np.abs(wander(steps, 2.5, rng)) - 1.2, 0, 1), 0.3) * rng.choice([-1, 1]) * 0.9
    )
    yaw = heading + glance + 0.02 * stride * np.sin(phase + 0.5)
    pitch = 0.06 * wander(steps, 2.0, rng) + 0.012 * stride * np.sin(2 * phase + 1.0)
    climb = ahead[:, 2] / (np.linalg.norm(ahead, axis=1) + 1e-9)
    pitch += _eased(np.where(climb < 0, -0.45, -0.1) * climb, 0.4)  # people watch the steps, above all going down
    roll = 0.012 * wander(steps, 1.0, rng) + 0.018 * stride * np.sin(phase)
    here[:, :2] += side * (0.07 * np.clip(wander(steps, 4.0, rng), -2, 2) + 0.022 * stride * np.sin(phase))[:, None]
    here[:, 2] += 1.5 + 0.02 * stride * np.cos(2 * phase) + 0.02 * wander(steps, 5.0, rng)
    return Poses(rotations(yaw, pitch, roll), here)


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
        rate += (float(np.clip(1.2 * to_goal, -0.75, 0.75)) - rate) * STEP_S / 0.4
        speed += (pace[i] * (1 - 0.55 * min(1.0, abs(rate) / 0.75)) - speed) * STEP_S / 0.5
        heading += rate * STEP_S
        position = position + speed * STEP_S * np.array([np.cos(heading), np.sin(heading)])
        position = np.clip(position, 0.5 * low, high + 0.5 * low)
        xy[i], yaw[i] = position, heading
    tilt = 0.006 * np.stack([wander(steps, 0.6, rng), wander(steps, 0.6, rng)])
    height = 0.002 * wander(steps, 0.4, rng)
    return Poses(rotations(yaw, tilt[0], tilt[1]), np.column_stack([xy, height]))


def circle_table(duration_s: float, *, rng: np.random.Generator) -> Poses:
    """A person walking round the table with eyes on it: world_from_base every 20 ms, x forward, z up, at eye height.

    Starts anywhere, either way round; comes nearer and goes further off, now and then turns round.
    """
    steps = int(np.ceil(duration_s / STEP_S)) + 1
    turns = rng.random(steps) < STEP_S / 30
    way = rng.choice([-1.0, 1.0]) * np.where(np.cumsum(turns) % 2, -1.0, 1.0)
    rate = _eased(way * (0.3 + 0.06 * wander(steps, 4.0, rng)), 0.4)
    angle = rng.uniform(-np.pi, np.pi) + np.cumsum(rate) * STEP_S
    distance = 1.9 + 0.4 * np.tanh(0.8 * wander(steps, 6.0, rng))
    position = np.stack([distance * np.cos(angle), distance * np.sin(angle), 1.5 + 0.08 * wander(steps, 5.0, rng)], 1)
    down = np.arctan2(position[:, 2] - tables.TABLE_HEIGHT, distance) - np.radians(12)
    yaw = angle + np.pi + 0.12 * wander(steps, 2.0, rng)
    roll = 0.02 * wander(steps, 1.0, rng)
    return Poses(rotations(yaw, down + 0.05 * wander(steps, 2.0, rng), roll), position)


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
        x = float(np.clip(x + speed * STEP_S, low - 0.3, high + 0.3))
        place[i], walking[i], headings[i] = x, abs(speed), heading
    phase = np.pi * np.cumsum(walking) * STEP_S / 0.65 + rng.uniform(0, 2 * np.pi)  # π a step
    stride = np.clip(walking / 0.9, 0, 1)
    aside = np.clip(np.abs(wander(steps, 2.5, rng)) - 1.0, 0, 1) * np.sign(wander(steps, 8.0, rng))
    yaw = _eased(headings, 0.45) + 0.15 * wander(steps, 1.6, rng) + 0.9 * _eased(aside, 0.3)
    yaw += 0.02 * stride * np.sin(phase + 0.5)
    pitch = -0.1 + 0.05 * wander(steps, 2.0, rng) + 0.01 * stride * np.sin(2 * phase + 1.0)
    roll = 0.012 * wander(steps, 1.0, rng) + 0.015 * stride * np.sin(phase)
    across = 0.45 * np.tanh(0.8 * wander(steps, 6.0, rng)) + 0.022 * stride * np.sin(phase)
    up = 1.5 + 0.02 * stride * np.cos(2 * phase) + 0.03 * wander(steps, 5.0, rng)
    position = np.column_stack([place, corridor.WIDTH / 2 + across, level * corridor.FLOOR_HEIGHT + up])
    return Poses(rotations(yaw, pitch, roll), position)


def _stair_line() -> tuple[Float64[np.ndarray, "n 4"], float]:
    """Where a person's feet go, from the entrance to the top: x, y, z and the distance walked; and its length."""
    low_y, high_y = staircase.WIDTH / 2, staircase.ACROSS - staircase.WIDTH / 2
    radius, middle = (high_y - low_y) / 2, staircase.ACROSS / 2
    near, far = staircase.LANDING, staircase.LANDING + staircase.FLIGHT
    turn = np.linspace(-np.pi / 2, np.pi / 2, 25)
    points = [(0.75, middle - 0.4, 0.0)]
    for level in range(staircase.NUM_FLOORS - 1):
        z = level * staircase.FLOOR_HEIGHT
        points += [(near, low_y, z), (far, low_y, z + staircase.HALF)]
        points += [(far + 0.06 + radius * np.cos(a), middle + radius * np.sin(a), z + staircase.HALF) for a in turn]
        points += [(far, high_y, z + staircase.HALF), (near, high_y, z + staircase.FLOOR_HEIGHT)]
        if level < staircase.NUM_FLOORS - 2:
            points += [
                (near - 0.1 - radius * np.cos(a), middle - radius * np.sin(a), z + staircase.FLOOR_HEIGHT) for a in turn
            ]
    points.append((0.75, middle + 0.4, (staircase.NUM_FLOORS - 1) * staircase.FLOOR_HEIGHT))
    rough = np.array(points)
    walked = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(rough, axis=0), axis=1))])
    fine = np.arange(0, walked[-1], 0.02)
    line = np.stack(
        [gaussian_filter1d(np.interp(fine, walked, rough[:, a]), 8, mode="nearest") for a in range(3)], axis=1
    )
    distance = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    return np.column_stack([line, distance]), float(distance[-1])


def wander(steps: int, time_s: float, rng: np.random.Generator) -> Float64[np.ndarray, " n"]:
    """Smooth noise of unit deviation that changes over `time_s`."""
    sigma = time_s / STEP_S / 2
    pad = int(4 * sigma)
    noise = gaussian_filter1d(rng.standard_normal(steps + 2 * pad), sigma)[pad : pad + steps]
    return noise * np.sqrt(2 * np.sqrt(np.pi) * sigma)


def _eased(value: np.ndarray, time_s: float) -> np.ndarray:
    return gaussian_filter1d(value, time_s / STEP_S)


def _eased_angle(target: np.ndarray, *, time_s: float, max_rate: float) -> np.ndarray:
    """An angle that follows a target with a lag and a greatest rate, radians per second."""
    angle, rate = np.empty(len(target)), 0.0
    current = float(target[0])
    for i, goal in enumerate(target):
        error = (goal - current + np.pi) % (2 * np.pi) - np.pi
        rate += (float(np.clip(error / time_s, -max_rate, max_rate)) - rate) * STEP_S / 0.12
        current += rate * STEP_S
        angle[i] = current
    return angle


def rotations(yaw: np.ndarray, pitch: np.ndarray, roll: np.ndarray) -> Float64[np.ndarray, "n 3 3"]:
    """Body axes from angles, in radians: about z, then y, then x."""
    return Rotation.from_euler("ZYX", np.stack([yaw, pitch, roll], axis=1)).as_matrix()
