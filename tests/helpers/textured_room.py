"""A corner of a room, two walls with random patterns, as a pinhole camera sees it."""

from __future__ import annotations

import cv2
import numpy as np

from filtering.se3 import Poses
from sequences.frame import Camera

CAMERA = Camera(240, 180, 200.0, 200.0, 119.5, 89.5)
_PER_M = 100.0  # pixels of a pattern


def pattern(rng: np.random.Generator, width_m: float, height_m: float) -> np.ndarray:
    size = round(height_m * _PER_M), round(width_m * _PER_M)
    total = np.zeros(size)
    for scale in (4, 8, 16, 40):
        noise = rng.standard_normal((size[0] // scale + 2, size[1] // scale + 2))
        total += cv2.resize(noise, size[::-1], interpolation=cv2.INTER_CUBIC)
    return np.clip(128 + 40 * total, 0, 255).astype(np.uint8)


class Room:
    """Two walls, 4 m ahead (z) and 2 m to the right (x); x right, y down."""

    def __init__(self, seed: int = 0) -> None:
        rng = np.random.default_rng(seed)
        # Corner, direction along the width, direction along the height, size.
        self._walls = [
            (np.array([-4.0, -1.5, 4.0]), np.array([1.0, 0, 0]), np.array([0, 1.0, 0]), pattern(rng, 6.0, 3.0)),
            (np.array([2.0, -1.5, 0.0]), np.array([0, 0, 1.0]), np.array([0, 1.0, 0]), pattern(rng, 4.0, 3.0)),
        ]

    def view(self, world_from_camera: Poses, camera: Camera = CAMERA) -> np.ndarray:
        k = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1.0]])
        rotation, centre = world_from_camera.rotation.T, world_from_camera.translation
        image = np.zeros((camera.height, camera.width), np.uint8)
        for corner, along, down, texture in self._walls:
            columns = [rotation @ along / _PER_M, rotation @ down / _PER_M, rotation @ (corner - centre)]
            homography = k @ np.stack(columns, axis=1)
            height, width = texture.shape
            behind = np.array([[0, 0, 1], [width, 0, 1], [0, height, 1], [width, height, 1.0]]) @ homography[2] < 0.05
            if behind.all():
                continue
            size = camera.width, camera.height
            rows, columns_of = np.mgrid[: camera.height, : camera.width]
            pixels = np.stack([columns_of, rows, np.ones_like(rows)], axis=-1) @ np.linalg.inv(homography).T
            depth = 1.0 / np.where(np.abs(pixels[..., 2]) < 1e-12, 1e-12, pixels[..., 2])
            u, v = pixels[..., 0] * depth, pixels[..., 1] * depth
            inside = (depth > 0) & (u >= 0) & (u < width - 1) & (v >= 0) & (v < height - 1)
            seen = cv2.warpPerspective(texture, homography, size, flags=cv2.INTER_LINEAR)
            image[inside] = seen[inside]
        return np.repeat(image[:, :, None], 3, axis=2)


def walk(count: int, seed: int = 1, *, moves: bool = True) -> Poses:
    """Poses along a winding way through the room, world_from_camera, (count,)."""
    rng = np.random.default_rng(seed)
    at = np.linspace(0.0, 1.0, count)
    phase = rng.uniform(0, 2 * np.pi, 3)
    x = -1.0 + 1.2 * np.sin(2 * np.pi * at + phase[0]) if moves else np.zeros(count)
    y = 0.2 * np.sin(5 * at + phase[1]) if moves else np.zeros(count)
    z = 0.6 * np.sin(4 * at + phase[2]) if moves else np.zeros(count)
    yaw = 0.25 + 0.35 * np.sin(3 * np.pi * at + phase[0])
    tangent = np.stack([0 * at, 0 * at, 0 * at, 0.05 * np.sin(9 * at), yaw, 0.05 * np.cos(7 * at)], axis=1)
    return Poses(Poses.exp(tangent).rotation, np.stack([x, y, z], axis=1))
