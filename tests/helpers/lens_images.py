"""A scene as cameras with and without distortion take it."""

import cv2
import numpy as np

from sequences.frame import Camera
from sequences.images.undistortion import Lens


def scene(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Colours (n, 3) of rays (x, y, 1): smooth waves, so that interpolation costs little."""
    return 128 + 80 * np.stack([np.sin(9 * x) * np.cos(7 * y), np.sin(6 * y + 1), np.cos(5 * x + 4 * y)], axis=-1)


def taken_by(camera: Camera | Lens) -> np.ndarray:
    """The scene as a camera takes it, traced pixel by pixel with OpenCV's inverse of the distortion."""
    lens = camera if isinstance(camera, Lens) else None
    c = lens.camera if lens else camera
    assert isinstance(c, Camera)
    column, row = np.meshgrid(np.arange(c.width, dtype=np.float64), np.arange(c.height, dtype=np.float64))
    rays = np.stack([(column - c.cx) / c.fx, (row - c.cy) / c.fy], axis=-1).reshape(-1, 1, 2)
    if lens:
        coefficients, matrix = np.array(lens.coefficients), np.eye(3)
        if lens.model == "equidistant":
            rays = cv2.fisheye.undistortPoints(rays, matrix, coefficients)
        else:
            criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-12)
            rays = cv2.undistortPoints(rays, matrix, coefficients, R=matrix, P=matrix, criteria=criteria)
    colours = scene(rays[:, 0, 0], rays[:, 0, 1])
    return np.clip(np.round(colours), 0, 255).astype(np.uint8).reshape(c.height, c.width, 3)
