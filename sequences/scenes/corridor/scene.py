"""Two floors alike, each a long corridor that repeats itself: a frame and two doors every 3 m, a lamp every 5 m.

What repeats does so after 15 m, the colours of the doors with it. Where along the corridor one is shows in the colour
of the walls, which changes slowly, in dirt and in notice boards, all the same on both floors. One end has a window, the
other a door. Which floor it is shows at the ends alone, on painted walls.
"""

from __future__ import annotations

import numpy as np

from filtering.se3 import Poses
from sequences.paths import STEP_S, eased, rotations, wander
from sequences.rendering.mesh import Placement
from sequences.scenes.corridor import bays
from sequences.scenes.corridor.dimensions import (
    BAY,
    BOARDS,
    DOOR_STAINS,
    FLOOR_HEIGHT,
    LAMP_SPACING,
    LENGTH,
    NUM_BAYS,
    NUM_FLOORS,
    NUM_LAMPS,
    REPEAT,
    WIDTH,
)
from sequences.scenes.scene import HELMET, Scene


def walk_corridor(duration_s: float, *, rng: np.random.Generator) -> Poses:
    """A person walking up and down the corridor of one floor: world_from_base every 20 ms, x forward, z up.

    Starts anywhere on either floor, either way; turns round at the ends and now and then elsewhere, seldom pauses,
    glances to the sides, sways and bobs with every step.
    """
    steps = int(np.ceil(duration_s / STEP_S)) + 1
    low, high = 1.3, LENGTH - 1.3
    level, x, way = rng.integers(NUM_FLOORS), rng.uniform(low, high), rng.choice([-1.0, 1.0])
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
    position = np.column_stack([place, WIDTH / 2 + across, level * FLOOR_HEIGHT + up])
    return Poses(rotations(yaw, pitch, roll), position)


def placements() -> list[Placement]:
    """Everything on both floors: x along the corridor, y across, z up, the lower floor at z = 0."""
    floors = np.array([[0.0, 0.0, level * FLOOR_HEIGHT] for level in range(NUM_FLOORS)])

    def along(places: list[float]) -> np.ndarray:
        return (np.array([[place, 0.0, 0.0] for place in places]) + floors[:, None]).reshape(-1, 3)

    lamps = [k * LAMP_SPACING for k in range(NUM_LAMPS)]
    placed = [Placement(bays.shell(), along(lamps), lit_at=NUM_LAMPS // 2)]
    placed += [Placement(bays.walls(bay), floors) for bay in range(NUM_BAYS)]
    phases = round(REPEAT / BAY)
    for phase in range(phases):  # bays that lie alike beneath the lamps
        alike = [bay for bay in range(1, NUM_BAYS - 1) if bay % phases == phase]
        placed.append(
            Placement(bays.bay(DOOR_STAINS[phase]), along([bay * BAY for bay in alike]), lit_at=len(alike) // 2)
        )
    placed += [Placement(bays.board(*board), floors) for board in BOARDS]
    placed += [Placement(bays.frame(), along([LENGTH - BAY])), Placement(bays.window_end(), floors)]
    placed.append(Placement(bays.door_end(), floors))
    for level in range(NUM_FLOORS):
        placed.append(Placement(bays.murals(level), floors[level : level + 1]))
    return placed


SCENE = Scene(
    name="corridor",
    seed_numbers=(4,),
    placements=lambda split, seed: placements(),
    path=lambda duration_s, split, seed, rng: walk_corridor(duration_s, rng=rng),
    field_of_view_deg=70.0,
    base_from_camera=HELMET,
    has_cues=True,
    floor_height_m=FLOOR_HEIGHT,
)
