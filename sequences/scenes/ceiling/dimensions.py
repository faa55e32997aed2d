"""Sizes of the hall, and what is where in it: metres, x along it, y across, z up, the floor at z = 0."""

from __future__ import annotations

LENGTH, BREADTH, HEIGHT = 15.0, 10.8, 3.6  # metres, x, y, z
PANEL = 0.6
CELL = (5, 6)  # panels after which lamps and loudspeakers repeat, in x and in y
LAMP_AT = (1, 2)  # panel of a cell under which its lamp begins
SPEAKER_AT = (4, 3)
OUTLET_AT = (19, 14)  # panels of the hall that unique things take
HOLE_AT = (16, 3)
STAIN_AT = ((5, 14), (6, 14), (5, 15))
PROJECTOR_AT = (5.1, 3.3)  # metres
SIGN_AT = (13.2, 5.1)
