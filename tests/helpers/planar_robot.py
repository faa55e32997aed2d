"""Poses of a camera on a robot that drives over floors."""

import numpy as np

from filtering.se3 import Poses

LEVEL_CAMERA = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])  # base_from_camera: it looks ahead


def driven(count, *, rng, tilt_std=0.01, height=lambda xy: 0.0 * xy[:, 0], turns=np.pi, height_std=0.005, size_m=10.0):
    """world_from_camera of a robot here and there on a floor, batch (count,)."""
    xy = rng.uniform(0, size_m, (count, 2))
    tangent = np.zeros((count, 6))
    tangent[:, 5] = rng.uniform(-turns, turns, count)
    turned = Poses.exp(tangent)
    tangent[:, 3:] = [0, 0.1, 0] + tilt_std * rng.standard_normal((count, 3))
    mounted = turned @ Poses.exp(tangent) @ Poses(LEVEL_CAMERA, np.zeros(3))
    z = height(xy) + height_std * rng.standard_normal(count) + 1.2
    return Poses(mounted.rotation, np.column_stack([xy, z]))


def ramp(xy):
    """Flat, then up to a level 1 m above."""
    return np.clip(0.2 * (xy[:, 0] - 4.0), 0.0, 1.0)
