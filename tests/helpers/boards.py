"""Images of textured boards in space, along known poses: for odometry from images."""

from dataclasses import dataclass, field
from functools import cache

import cv2
import numpy as np

from filtering.se3 import Poses
from sequences.frame import Camera

CAMERA = Camera(320, 240, 260.0, 260.0, 159.5, 119.5)
_PER_M = 150.0  # pixels of a texture


@dataclass(frozen=True)
class Board:
    """A textured rectangle that stands across the z axis: its corner (x, y), depth, and size in metres."""

    corner: tuple[float, float]
    depth_m: float
    size: tuple[float, float]
    seed: int = 0

    def texture(self) -> np.ndarray:
        """Random smooth grey values, coarse and fine."""
        rng = np.random.default_rng(self.seed)
        height, width = (round(_PER_M * side) for side in self.size[::-1])
        coarse = cv2.GaussianBlur(rng.normal(0, 1, (height, width)), (0, 0), 6.0)
        fine = cv2.GaussianBlur(rng.normal(0, 1, (height, width)), (0, 0), 2.0)
        both = coarse / coarse.std() + fine / fine.std()
        return np.clip(128 + 35 * both, 0, 255).astype(np.uint8)


@dataclass
class Room:
    """Boards, seen by a camera whose images are noisy."""

    boards: tuple[Board, ...] = (
        Board((-9.0, -6.0), 4.0, (18.0, 12.0), 1),
        Board((-3.0, -1.2), 2.5, (1.6, 2.2), 2),
        Board((0.4, -0.8), 2.0, (1.0, 1.4), 3),
        Board((2.6, -1.5), 3.0, (1.5, 2.5), 4),
    )
    noise: float = 2.0
    textures: list[np.ndarray] = field(init=False)

    def __post_init__(self) -> None:
        self.textures = [board.texture() for board in self.boards]

    def seen_from(self, pose: Poses, rng: np.random.Generator, moved: tuple[float, ...] = ()) -> np.ndarray:
        """The image (h, w, 3) from a pose, world_from_camera; each board moved to the right by so many metres."""
        image = np.full((CAMERA.height, CAMERA.width), 90, np.uint8)
        camera = np.array([[CAMERA.fx, 0, CAMERA.cx], [0, CAMERA.fy, CAMERA.cy], [0, 0, 1.0]])
        inverse = pose.inverse()
        for number, (board, texture) in enumerate(zip(self.boards, self.textures, strict=True)):
            shift = moved[number] if number < len(moved) else 0.0
            origin = np.array([board.corner[0] + shift, board.corner[1], board.depth_m])
            rotation = inverse.rotation
            plane = np.column_stack([rotation[:, 0] / _PER_M, rotation[:, 1] / _PER_M, inverse.apply(origin)])
            size = (CAMERA.width, CAMERA.height)
            covers = cv2.warpPerspective(np.full_like(texture, 255), camera @ plane, size, flags=cv2.INTER_LINEAR)
            drawn = cv2.warpPerspective(texture, camera @ plane, size, flags=cv2.INTER_LINEAR)
            image = np.where(covers > 127, drawn, image)
        noisy = image + self.noise * rng.standard_normal(image.shape)
        return np.repeat(np.clip(noisy, 0, 255).astype(np.uint8)[:, :, None], 3, axis=2)


STEP_NS = 33_333_333
ROOM = Room()


def poses_of(tangents):
    """Poses (n + 1,) along motions (n, 6), from the identity."""
    poses = [Poses.identity()]
    for tangent in tangents:
        poses.append(poses[-1] @ Poses.exp(np.asarray(tangent, np.float64)))
    return Poses.stack(poses)


@cache
def walk(kind, count=90):
    """A camera's true poses along a way of its own, thirty images a second."""
    t = np.arange(count) / 30.0
    sway, still = 0.02 * np.sin(2.0 * t), np.zeros_like(t)
    return poses_of(
        np.column_stack(
            {
                "sideways": [np.full_like(t, 0.015), 0.1 * sway, 0.1 * sway, 0.2 * sway, 0.3 * sway, still],
                "turning": [still, still, still, 0.3 * sway, 0.8 * sway, still],
                "standing": [still] * 6,
            }[kind]
        )
    )


def images_of(poses, *, room=ROOM, seed=0, moved=lambda _: ()):
    rng = np.random.default_rng(seed)
    return [room.seen_from(poses[i], rng, moved(i)) for i in range(len(poses))]
