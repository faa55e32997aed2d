"""A stairwell of six floors, four of which look the same."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64
from scipy.ndimage import gaussian_filter1d

from filtering.se3 import Poses
from sequences.paths import STEP_S, eased, eased_angle, rotations, wander
from sequences.rendering.mesh import Placement
from sequences.scenes.scene import HELMET, Scene
from sequences.scenes.staircase import flights, unique
from sequences.scenes.staircase.dimensions import (
    ACROSS,
    FLIGHT,
    FLOOR_HEIGHT,
    HALF,
    LANDING,
    NUM_FLOORS,
    POSTER_FLOOR,
    WIDTH,
)


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
        s = min(max(s + speed * STEP_S, 0.0), length)
        place[i], walking[i], ways[i] = s, abs(speed), way

    def at(distance: np.ndarray) -> np.ndarray:
        sample = np.clip(distance, 0, length)
        return np.stack([np.interp(sample, line[:, 3], line[:, axis]) for axis in range(3)], axis=-1)

    here = at(place)
    tangent = at(place + 0.1) - at(place - 0.1)
    side = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1) / (np.linalg.norm(tangent[:, :2], axis=1)[:, None] + 1e-9)
    ahead = at(place + 0.45 * ways) - at(place - 0.2 * ways)
    heading = eased_angle(np.arctan2(ahead[:, 1], ahead[:, 0]), time_s=0.35, max_rate=2.4)
    phase = np.pi * np.cumsum(walking) * STEP_S / 0.33 + rng.uniform(0, 2 * np.pi)  # π a step
    stride = np.clip(walking / 0.5, 0, 1)
    glance = (
        wander(steps, 1.6, rng) * 0.22
        + eased(np.clip(np.abs(wander(steps, 2.5, rng)) - 1.2, 0, 1), 0.3) * rng.choice([-1, 1]) * 0.9
    )
    yaw = heading + glance + 0.02 * stride * np.sin(phase + 0.5)
    pitch = 0.06 * wander(steps, 2.0, rng) + 0.012 * stride * np.sin(2 * phase + 1.0)
    climb = ahead[:, 2] / (np.linalg.norm(ahead, axis=1) + 1e-9)
    pitch += eased(np.where(climb < 0, -0.45, -0.1) * climb, 0.4)  # people watch the steps, above all going down
    roll = 0.012 * wander(steps, 1.0, rng) + 0.018 * stride * np.sin(phase)
    here[:, :2] += side * (0.07 * np.clip(wander(steps, 4.0, rng), -2, 2) + 0.022 * stride * np.sin(phase))[:, None]
    here[:, 2] += 1.5 + 0.02 * stride * np.cos(2 * phase) + 0.02 * wander(steps, 5.0, rng)
    return Poses(rotations(yaw, pitch, roll), here)


def _stair_line() -> tuple[Float64[np.ndarray, "n 4"], float]:
    """Where a person's feet go, from the entrance to the top: x, y, z and the distance walked; and its length."""
    low_y, high_y = WIDTH / 2, ACROSS - WIDTH / 2
    radius, middle = (high_y - low_y) / 2, ACROSS / 2
    near, far = LANDING, LANDING + FLIGHT
    turn = np.linspace(-np.pi / 2, np.pi / 2, 25)
    points = [(0.75, middle - 0.4, 0.0)]
    for level in range(NUM_FLOORS - 1):
        z = level * FLOOR_HEIGHT
        points += [(near, low_y, z), (far, low_y, z + HALF)]
        points += [(far + 0.06 + radius * np.cos(a), middle + radius * np.sin(a), z + HALF) for a in turn]
        points += [(far, high_y, z + HALF), (near, high_y, z + FLOOR_HEIGHT)]
        if level < NUM_FLOORS - 2:
            points += [(near - 0.1 - radius * np.cos(a), middle - radius * np.sin(a), z + FLOOR_HEIGHT) for a in turn]
    points.append((0.75, middle + 0.4, (NUM_FLOORS - 1) * FLOOR_HEIGHT))
    rough = np.array(points)
    walked = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(rough, axis=0), axis=1))])
    fine = np.arange(0, walked[-1], 0.02)
    line = np.stack(
        [gaussian_filter1d(np.interp(fine, walked, rough[:, a]), 8, mode="nearest") for a in range(3)], axis=1
    )
    distance = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    return np.column_stack([line, distance]), float(distance[-1])


def placements() -> list[Placement]:
    """Everything that stands in the stairwell: x along the flights, y across, z up, the entrance floor at z = 0."""
    floors = np.array([[0.0, 0.0, level * FLOOR_HEIGHT] for level in range(NUM_FLOORS)])
    top = floors[-1:]
    return [
        Placement(flights.flights(), floors[:-1], lit_at=2),
        Placement(flights.landing(), floors[1:-1], lit_at=1),
        Placement(flights.landing(), top),
        Placement(flights.landing(door=False), floors[:1]),
        Placement(unique.entrance(), floors[:1]),
        Placement(unique.cellar(), floors[:1]),
        Placement(unique.poster(), floors[POSTER_FLOOR : POSTER_FLOOR + 1]),
        Placement(unique.top(), top),
        Placement(unique.roof_walls(), top),
        Placement(flights.undersides(), floors[:-1], lit_at=2),
    ]


SCENE = Scene(
    name="staircase",
    seed_numbers=(0,),
    placements=lambda split, seed: placements(),
    path=lambda duration_s, split, seed, rng: walk_stairs(duration_s, rng=rng),
    field_of_view_deg=77.0,
    base_from_camera=HELMET,
    has_cues=True,
)
