"""Walks through the textured room, as a user records them: images alone, or with odometry."""

from pathlib import Path

import cv2
import numpy as np

from filtering.se3 import Poses
from sequences.frame import BASE_FROM_CAMERA
from sequences.writer import SequenceWriter
from tests.helpers import textured_room
from tests.helpers.textured_room import Room

CAMERA = textured_room.CAMERA.scaled(160, 120)  # small, for speed
BEGIN_NS, STEP_NS = 1_700_000_000_000_000_000, 250_000_000


def write_images(folder: Path, images: list[np.ndarray]) -> Path:
    """A folder of images whose names are time stamps, four a second."""
    folder.mkdir(parents=True)
    for number, image in enumerate(images):
        time_ns = BEGIN_NS + number * STEP_NS
        cv2.imwrite(str(folder / f"{time_ns // 10**9}.{time_ns % 10**9:09d}.png"), image)
    return folder


def write_recording(path: Path, poses: Poses, *, true_poses: bool = False) -> Path:
    """A recording of the room with intrinsics and odometry."""
    room, camera_from_base = Room(), BASE_FROM_CAMERA.inverse()
    base = poses @ camera_from_base
    with SequenceWriter(path, camera=CAMERA, base_from_camera=BASE_FROM_CAMERA) as writer:
        for number in range(len(poses)):
            time_ns = BEGIN_NS + number * STEP_NS
            odometry = base[0].inverse() @ base[number]
            writer.write_odometry(time_ns, odometry, np.zeros((6, 6)))
            writer.write_image(time_ns, room.view(poses[number], CAMERA))
            if true_poses:
                writer.write_true_pose(time_ns, poses[number])
    return path


def views(poses: Poses) -> list[np.ndarray]:
    room = Room()
    return [room.view(poses[number], CAMERA) for number in range(len(poses))]
