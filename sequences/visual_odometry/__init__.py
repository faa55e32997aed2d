"""Odometry from images alone: monocular, by tracked features."""
