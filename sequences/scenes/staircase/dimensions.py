"""Sizes of the stairwell: metres, x along the flights, y across, z up, the entrance floor at z = 0.

Flight A climbs along +x at low y from a floor to the half landing, flight B back along −x at high y.
"""

from __future__ import annotations

NUM_FLOORS = 6
POSTER_FLOOR = 3
RISE, GOING, NUM_TREADS = 0.17, 0.28, 8  # metres; a flight has one riser more than treads
WIDTH = 1.2  # of a flight
WELL = 0.2  # gap between the flights
LANDING, HALF_LANDING = 1.6, 1.3  # depths
FLIGHT = NUM_TREADS * GOING  # metres along x
HALF = (NUM_TREADS + 1) * RISE  # height of a flight
FLOOR_HEIGHT = 2 * HALF
ACROSS = 2 * WIDTH + WELL  # the stairwell in y
FAR = LANDING + FLIGHT + HALF_LANDING  # the stairwell in x
SLAB = 0.18
TOP_HEIGHT = FLOOR_HEIGHT - SLAB  # from the top landing to the roof
SLOPE = RISE / GOING
INNER_A, INNER_B = WIDTH + 0.01, WIDTH + WELL - 0.01  # y of the balustrades
