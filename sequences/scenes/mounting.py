"""How a camera is mounted on the body that carries it."""

from __future__ import annotations

import numpy as np

from filtering.se3 import Poses


def mounted(at_m: tuple[float, float, float], toward: float, down: float) -> Poses:
    """base_from_camera of a camera at a point of the body that looks so many radians left of forward, and down."""
    cos, sin = np.cos(toward), np.sin(toward)
    forward = np.array([np.cos(down) * cos, np.cos(down) * sin, -np.sin(down)])
    right = np.array([sin, -cos, 0])
    return Poses(np.stack([right, np.cross(forward, right), forward], axis=1), np.array(at_m))


def mounted_upward(at_m: tuple[float, float, float]) -> Poses:
    """base_from_camera of a camera at a point of the body that looks straight up, with the image's top forward."""
    right, up = np.array([0, -1.0, 0]), np.array([0, 0, 1.0])
    return Poses(np.stack([right, np.cross(up, right), up], axis=1), np.array(at_m))


HELMET = mounted((0.06, 0.03, 0.05), 0.0, np.radians(10))
"""base_from_camera on a person's helmet, whose body's origin is at eye height: forward, and 10° down."""
