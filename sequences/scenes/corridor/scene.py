"""Two floors alike, each a long corridor that repeats itself: a frame and two doors every 3 m, a lamp every 5 m.

What repeats does so after 15 m, the colours of the doors with it. Where along the corridor one is shows in the colour
of the walls, which changes slowly, in dirt and in notice boards, all the same on both floors. One end has a window, the
other a door. Which floor it is shows at the ends alone, on painted walls.
"""

from __future__ import annotations

import numpy as np

from sequences.rendering.mesh import Placement
from sequences.scenes.corridor import bays, ends
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
)
from sequences.scenes.corridor.walk import walk_corridor
from sequences.scenes.mounting import HELMET
from sequences.scenes.scene import Scene


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
    placed += [Placement(bays.frame(), along([LENGTH - BAY])), Placement(ends.window_end(), floors)]
    placed.append(Placement(ends.door_end(), floors))
    for level in range(NUM_FLOORS):
        placed.append(Placement(ends.murals(level), floors[level : level + 1]))
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
