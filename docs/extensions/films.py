"""Films of a simulated phone, for a tutorial: someone goes round an office, looking across it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from filtering.se3 import Poses
from sequences.frame import BASE_FROM_CAMERA
from sequences.paths import poses_at
from sequences.synthesize import synthesize

SIZE, RATE_HZ = (256, 192), 4
_MIDDLE, _RADII, _EYES_M = (3.2, 4.0), (1.5, 0.8), 1.45  # of an office on the ground floor of building 6


def film(path: str, *, seed: int, seconds: float, begin: float, turns: float) -> Poses:
    """Write a video (`.mp4`) and return where the phone truly was at each of its images, world_from_camera (n,).

    Args:
        path: The file.
        seed: Of how the phone is swung; another one is another walk.
        seconds: Its length.
        begin: Where on the way round the office it begins, radians; 0 and π are its two ends, 3 m apart.
        turns: How often it goes round, negative for the other way.
    """
    width, height = SIZE
    frames = round(seconds * RATE_HZ)
    office = synthesize(
        "building-6", seed=0, num_frames=frames, split="train", width=width, height=height, rate_hz=RATE_HZ
    )
    first_ns, last_ns = office.image_times_ns[[0, -1]]
    part = np.clip((office.odometry_times_ns - first_ns) / (last_ns - first_ns), 0.0, 1.0)
    at = begin + 2.0 * np.pi * turns * part
    swing = np.sin(3.0 * at + seed)
    x, y = _MIDDLE[0] + _RADII[0] * np.cos(at), _MIDDLE[1] + _RADII[1] * np.sin(at) * (1.0 + 0.1 * swing)
    z = _EYES_M + 0.04 * np.sin(9.0 * at)
    heading, down, none = np.arctan2(_MIDDLE[1] - y, _MIDDLE[0] - x) + 0.45 * swing, 0.15 + 0.1 * swing, 0.0 * at
    turned = Poses.exp(np.stack([none] * 5 + [heading], axis=1)) @ Poses.exp(
        np.stack([none] * 4 + [down, none], axis=1)
    )
    phone = Poses(turned.rotation, np.stack([x, y, z], axis=1)) @ BASE_FROM_CAMERA
    office = replace(office, world_from_base=phone @ office.base_from_camera.inverse())
    writer = cv2.VideoWriter(str(Path(path)), cv2.VideoWriter.fourcc(*"mp4v"), RATE_HZ, SIZE)
    for image in office.images():
        writer.write(cv2.cvtColor(image, cv2.COLOR_RGB2BGR))
    writer.release()
    return poses_at(office.odometry_times_ns, office.world_from_base, office.image_times_ns) @ office.base_from_camera


def errors(found: Poses, true: Poses) -> tuple[float, float]:
    """Median error of poses in a frame of their own, after the rigid motion that fits best: metres and degrees."""
    a, b = found.translation - found.translation.mean(axis=0), true.translation - true.translation.mean(axis=0)
    u, _, vt = np.linalg.svd(b.T @ a)
    rotation = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt
    aligned = Poses(rotation @ found.rotation, a @ rotation.T + true.translation.mean(axis=0))
    metres, radians = aligned.distance(true)
    return float(np.median(metres)), float(np.degrees(np.median(radians)))
