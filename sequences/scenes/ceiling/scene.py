"""A hall whose ceiling repeats itself: panels of 0.6 m, a lamp and a loudspeaker per 3 m × 3.6 m, few unique things."""

from __future__ import annotations

import numpy as np

from sequences.rendering.mesh import Placement
from sequences.scenes.ceiling import cues, hall
from sequences.scenes.ceiling.cart import roll_through_hall
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
from sequences.scenes.mounting import mounted_upward
from sequences.scenes.scene import Scene


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
        Placement(cues.outlet(), _offsets([OUTLET_AT])),
        Placement(cues.hole(), _offsets([HOLE_AT])),
        Placement(cues.stains(), np.zeros((1, 3))),
        Placement(cues.projector(), np.array([[*PROJECTOR_AT, HEIGHT]])),
        Placement(cues.exit_sign(), np.array([[*SIGN_AT, HEIGHT]])),
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
