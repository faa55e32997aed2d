"""Coloured dots in space, drawn as a format's documents say that its cameras see, to check what a reader makes of it.

`drawn` knows a pose only by the words of a format ("the axes are x right, y up, z backward"), and `misses` only what
was read, by OpenCV's projection. So a dot is where it is expected only if axes, direction and intrinsics were all
understood.
"""

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

from filtering.se3 import Poses
from sequences.frame import Frame

WIDTH, HEIGHT = 160, 120
FX, FY, CX, CY = 110.0, 104.0, 83.0, 57.0
COLOURS = np.array([[255, 0, 0], [0, 255, 0], [0, 0, 255], [255, 255, 0], [255, 0, 255], [0, 255, 255]], np.uint8)
DOTS = np.array(
    [[0.7, 4.1, 0.3], [-0.6, 4.6, 0.7], [0.1, 5.9, -0.5], [-0.7, 5.2, -0.6], [0.5, 6.6, 0.9], [0.9, 5.4, -0.3]]
)
"""In a world where the cameras of `looking` stand near zero and look along y."""

Pixels = Callable[[np.ndarray], np.ndarray]


def looking(index: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """What a camera's right, down and ahead are in the world, and where it is: never aligned with anything."""
    ahead = np.array([0.07 - 0.05 * index, 1.0, 0.04 * index - 0.06])
    ahead /= np.linalg.norm(ahead)
    right = np.cross(ahead, [0.12, 0.1, 1.0])
    right /= np.linalg.norm(right)
    return right, np.cross(ahead, right), ahead, np.array([0.1 * index - 0.2, 0.15 * index, 0.1 - 0.03 * index])


def opengl(index: int) -> np.ndarray:
    """Camera-to-world by its words in OpenGL: x right, y up, z backward; (4, 4)."""
    right, down, ahead, centre = looking(index)
    return np.block([[np.column_stack([right, -down, -ahead]), centre[:, None]], [np.zeros((1, 3)), np.ones((1, 1))]])


def opencv(index: int) -> np.ndarray:
    """Camera-to-world by its words in OpenCV: x right, y down, z forward; (4, 4)."""
    right, down, ahead, centre = looking(index)
    return np.block([[np.column_stack([right, down, ahead]), centre[:, None]], [np.zeros((1, 3)), np.ones((1, 1))]])


def opengl_pixels(camera_points: np.ndarray) -> np.ndarray:
    """OpenGL's projection, into pixels whose rows count downwards."""
    x, y, depth = camera_points[:, 0], camera_points[:, 1], -camera_points[:, 2]
    return np.column_stack([CX + FX * x / depth, CY - FY * y / depth])


def opencv_pixels(camera_points: np.ndarray) -> np.ndarray:
    """The pinhole projection."""
    x, y, depth = camera_points.T
    return np.column_stack([CX + FX * x / depth, CY + FY * y / depth])


def drawn(camera_to_world: np.ndarray, pixels: Pixels, *, half: float = 0.0) -> np.ndarray:
    """The dots as a camera sees them, BGR; `half` is where the first pixel's centre lies."""
    image = np.full((HEIGHT, WIDTH, 3), 90, np.uint8)
    points = (DOTS - camera_to_world[:3, 3]) @ camera_to_world[:3, :3]
    for point, pixel, colour in zip(points, pixels(points) - half, COLOURS, strict=True):
        assert point is not None
        assert 8 < pixel[0] < WIDTH - 8
        assert 8 < pixel[1] < HEIGHT - 8
        centre = np.rint(pixel * 16).astype(int).tolist()
        cv2.circle(image, centre, 5 * 16, colour[::-1].tolist(), -1, cv2.LINE_AA, shift=4)
    return image


def write(file: Path, image: np.ndarray) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    options = [cv2.IMWRITE_JPEG_QUALITY, 98] if file.suffix == ".jpg" else []
    assert cv2.imwrite(str(file), image, options)


def misses(frame: Frame, *, dots: np.ndarray = DOTS) -> np.ndarray:
    """How many pixels each dot of a frame is from where its pose and camera put it."""
    assert frame.world_from_camera is not None
    assert frame.camera is not None
    points = frame.world_from_camera.inverse().apply(dots)
    if (points[:, 2] <= 0).any():
        return np.full(len(dots), np.inf)  # behind the camera
    camera = frame.camera
    assert frame.image.shape == (camera.height, camera.width, 3)
    expected = np.column_stack(
        [camera.cx + camera.fx * points[:, 0] / points[:, 2], camera.cy + camera.fy * points[:, 1] / points[:, 2]]
    )
    found = []
    for colour in COLOURS:
        rows, columns = np.nonzero(np.abs(frame.image.astype(int) - colour).max(axis=2) < 100)
        assert len(rows) > 20, f"no dot of colour {colour}"
        found.append([columns.mean(), rows.mean()])
    return np.linalg.norm(np.array(found) - expected, axis=1)


def true_pose(index: int) -> Poses:
    return Poses.from_matrix(opencv(index))
