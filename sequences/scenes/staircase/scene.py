"""A stairwell of six floors, four of which look the same."""

from __future__ import annotations

import numpy as np

from sequences.rendering.mesh import Placement
from sequences.scenes.mounting import HELMET
from sequences.scenes.scene import Scene
from sequences.scenes.staircase import flights, landings, unique
from sequences.scenes.staircase.dimensions import FLOOR_HEIGHT, NUM_FLOORS, POSTER_FLOOR
from sequences.scenes.staircase.walk import walk_stairs


def placements() -> list[Placement]:
    """Everything that stands in the stairwell: x along the flights, y across, z up, the entrance floor at z = 0."""
    floors = np.array([[0.0, 0.0, level * FLOOR_HEIGHT] for level in range(NUM_FLOORS)])
    top = floors[-1:]
    return [
        Placement(flights.flights(), floors[:-1], lit_at=2),
        Placement(landings.landing(), floors[1:-1], lit_at=1),
        Placement(landings.landing(), top),
        Placement(landings.landing(door=False), floors[:1]),
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
