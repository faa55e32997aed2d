"""A hall whose ceiling repeats itself: panels of 0.6 m, a lamp and a loudspeaker per 3 m × 3.6 m, few unique things."""

from __future__ import annotations

import numpy as np

from filtering.se3 import Poses
from sequences.paths import STEP_S, rotations, wander
from sequences.rendering.mesh import Placement
from sequences.scenes.ceiling import hall
from sequences.scenes.ceiling.dimensions import (
    BREADTH,
    CELL,
    HEIGHT,
    HOLE_AT,
    LAMP_AT,
    LENGTH,
    OUTLET_AT,
    PANEL,
    PROJECTOR_AT,
    SIGN_AT,
    SPEAKER_AT,
)
from sequences.scenes.ceiling.paint import SPEAKER, TILE
from sequences.scenes.scene import Scene, mounted_upward


def roll_through_hall(duration_s: float, *, margin_m: float, rng: np.random.Generator) -> Poses:
    """A cart wandering about the hall: world_from_base every 20 ms, x forward, z up, on the floor.

    It heads for one random place after another, turning no tighter than a cart can.
    """
    steps = int(np.ceil(duration_s / STEP_S)) + 1
    low = np.full(2, margin_m)
    high = np.array([LENGTH, BREADTH]) - margin_m
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


def placements() -> list[Placement]:
    """Everything in the hall: x along it, y across, z up, the floor at z = 0."""
    across, along = round(BREADTH / PANEL), round(LENGTH / PANEL)
    middle = (along // CELL[0] // 2) * (across // CELL[1]) + across // CELL[1] // 2
    placed = []
    for place in np.ndindex(CELL):
        cells = [(ix, iy) for ix in range(place[0], along, CELL[0]) for iy in range(place[1], across, CELL[1])]
        copies = [cell for cell in cells if cell not in (OUTLET_AT, HOLE_AT)]
        paint = SPEAKER if place == SPEAKER_AT else TILE
        placed.append(Placement(hall.panel(paint), _offsets(copies), lit_at=copies.index(cells[middle])))
        if place == LAMP_AT:
            placed.append(Placement(hall.lamp(), _offsets(cells), lit_at=middle))
    return [
        *placed,
        Placement(hall.hall(), np.zeros((1, 3))),
        Placement(hall.walls(), np.zeros((1, 3))),
        Placement(hall.outlet(), _offsets([OUTLET_AT])),
        Placement(hall.hole(), _offsets([HOLE_AT])),
        Placement(hall.stains(), np.zeros((1, 3))),
        Placement(hall.projector(), np.array([[*PROJECTOR_AT, HEIGHT]])),
        Placement(hall.exit_sign(), np.array([[*SIGN_AT, HEIGHT]])),
    ]


def _offsets(panels: list[tuple[int, int]]) -> np.ndarray:
    corner = np.array(panels, float) * PANEL
    return np.column_stack([corner, np.full(len(corner), HEIGHT)])


SCENE = Scene(
    name="ceiling",
    seed_numbers=(1,),
    placements=lambda split, seed: placements(),
    path=lambda duration_s, split, seed, rng: roll_through_hall(
        duration_s, margin_m=1.0 if split == "train" else 1.8, rng=rng
    ),
    field_of_view_deg=64.0,
    base_from_camera=mounted_upward((0.12, -0.04, 0.9)),
    has_cues=True,
)
