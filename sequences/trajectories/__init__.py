"""Poses over time: as text, between their stamps, by two clocks, and the odometry between two of them."""
