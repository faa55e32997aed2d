"""Sizes of the corridor, and what is where in it: metres, x along it, y across, z up, the lower floor at z = 0."""

from __future__ import annotations

DISTINCT = 1.0
"""How much the colour of the walls changes along the corridor, and how dirty they are; 0 leaves boards and ends."""
LENGTH, WIDTH, HEIGHT = 75.0, 2.4, 2.6  # metres, x, y, z
NUM_FLOORS, FLOOR_HEIGHT = 2, 3.2
BAY, LAMP_SPACING = 3.0, 5.0  # from frame to frame, from lamp to lamp
REPEAT = 15.0  # after which bays and lamps are placed alike again
NUM_BAYS, NUM_LAMPS = round(LENGTH / BAY), round(LENGTH / LAMP_SPACING)
DOOR_WIDTH, DOOR_HEIGHT = 0.9, 2.05
DOORS_AT = (0.45, 1.65)  # from the frame, in the wall at low y and in that at high y
FRAME_DEPTH, FRAME_WIDTH = 0.06, 0.2
DOOR_STAINS = ((1.0, 1.0, 1.0), (0.28, 0.45, 0.75), (1.5, 1.7, 2.6), (0.65, 0.22, 0.25), (0.35, 0.75, 0.55))
MURAL = 2.4  # metres wide
BOARDS = (  # bay, whether in the wall at high y, colour
    (3, False, (0.45, 0.06, 0.05)),
    (6, True, (0.06, 0.16, 0.42)),
    (9, False, (0.62, 0.45, 0.05)),
    (11, True, (0.07, 0.30, 0.12)),
    (14, False, (0.32, 0.10, 0.36)),
    (17, True, (0.55, 0.23, 0.05)),
    (20, False, (0.05, 0.32, 0.36)),
    (22, True, (0.30, 0.30, 0.30)),
)
