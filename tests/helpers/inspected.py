"""Recordings to inspect, as simple or as bad as a test wants them."""

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

from filtering.se3 import Poses
from sequences.frame import Camera
from sequences.writer import SequenceWriter
from vapor.inspection.inspect import Inspection

SECOND = 10**9
BEGIN_NS = 1_700_000_000 * SECOND
CAMERA = Camera(64, 48, 50.0, 50.0, 31.5, 23.5)
LEVEL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])  # a camera that looks along the world's x
SCENERY = np.random.default_rng(0).integers(0, 256, (CAMERA.height, CAMERA.width, 3), np.uint8)


def scenery(index: int) -> np.ndarray:
    """Sharp, and another one each time."""
    return np.roll(SCENERY, index, axis=1)


def detailed(index: int) -> np.ndarray:
    """Likewise, in the size at which blur is measured, with coarse and fine detail."""
    coarse = cv2.resize(SCENERY, (320, 240), interpolation=cv2.INTER_CUBIC)
    return np.roll(coarse // 2 + np.tile(SCENERY, (5, 5, 1)) // 2, index, axis=1)


SKY = np.zeros((180, 360), np.float32)
for _size in (6, 15, 45, 180):
    _noise = np.random.default_rng(_size).uniform(0.0, 255.0 / 4, (_size, 2 * _size)).astype(np.float32)
    SKY += cv2.resize(_noise, (360, 180), interpolation=cv2.INTER_CUBIC)


def panorama(pose: Poses) -> np.ndarray:
    """The view of distant scenery: brightness by direction, coarse and fine."""
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width]
    rays = np.stack([(u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy, np.ones(u.shape)], -1) @ pose.rotation.T
    around = 180 + np.degrees(np.arctan2(rays[..., 1], rays[..., 0]))
    down = 90 - np.degrees(np.arctan2(rays[..., 2], np.hypot(rays[..., 0], rays[..., 1])))
    seen = cv2.remap(SKY, around.astype(np.float32), down.astype(np.float32), cv2.INTER_LINEAR, None, cv2.BORDER_WRAP)
    return np.repeat(np.asarray(seen).clip(0, 255).astype(np.uint8)[..., None], 3, axis=-1)


def write(
    path: Path,
    poses: Poses | None,
    *,
    count: int = 0,
    image: Callable[[int], np.ndarray] = scenery,
    times_s: np.ndarray | None = None,
    odometry: bool = True,
) -> Path:
    """A recording with exact odometry, ten images a second."""
    number = count if poses is None else len(poses)
    times_s = 0.1 * np.arange(number) if times_s is None else times_s
    with SequenceWriter(path, camera=CAMERA, base_from_camera=Poses.identity(), metadata={}) as writer:
        for i, time_s in enumerate(times_s):
            time_ns = BEGIN_NS + round(time_s * SECOND)
            if poses is not None and odometry:
                writer.write_odometry(time_ns, poses[0].inverse() @ poses[i], 1e-4 * np.eye(6))
            writer.write_image(time_ns, image(i))
            if poses is not None:
                writer.write_true_pose(time_ns, poses[i])
    return path


def walked(count: int = 120, *, at: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Poses:
    turn = np.linspace(0.0, 4.0 * np.pi, count)
    about_z = Poses.exp(np.column_stack([np.zeros((count, 5)), turn + np.pi / 2])).rotation
    return Poses(about_z @ LEVEL, np.column_stack([2 * np.cos(turn), 2 * np.sin(turn), 0 * turn]) + np.array(at))


def only(inspection: Inspection, *said: str) -> str:
    """The one sentence of a verdict with all these words."""
    (sentence,) = [each for each in inspection.verdict.points if all(words in each for words in said)]
    return sentence
