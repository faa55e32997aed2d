"""Inertial measurement units: their samples, gravity and turns by them, as part of the frames of a sequence."""
