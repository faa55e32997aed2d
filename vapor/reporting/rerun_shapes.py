"""Cameras, ellipsoids and images in the form in which Rerun shows them."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float32, Float64, UInt8

from filtering.se3 import Poses
from sequences.frame import Camera

_IMAGE_SIDE = 480  # pixels
_JPEG_QUALITY = 75


def thinned(poses: Poses, count: int) -> Poses:
    """At most `count` of the poses (n,), evenly spaced in their order."""
    return poses[np.linspace(0, len(poses) - 1, min(count, len(poses))).round().astype(np.int64)]


def frusta(poses: Poses, size_m: float) -> Float32[np.ndarray, "n 10 3"]:
    """Cameras (n,) as one line each, which goes along every edge of the pyramid from the centre to the image."""
    x, y = 0.5 * size_m, 0.375 * size_m
    corners = np.array([[-x, -y, size_m], [x, -y, size_m], [x, y, size_m], [-x, y, size_m]])
    line = np.concatenate([corners, np.zeros((1, 3))])[[1, 0, 3, 4, 0, 3, 2, 4, 1, 2]]
    points = line @ np.swapaxes(poses.rotation, 1, 2) + poses.translation[:, None]
    return points.astype(np.float32)


def steps(points: Float64[np.ndarray, "n 3"], limit_m: float = np.inf) -> Float32[np.ndarray, "n 2 3"]:
    """From each point of a path to the next, the first one by itself, like those that are further from the last."""
    begins = np.concatenate([points[:1], points[:-1]])
    jumps = np.linalg.norm(points - begins, axis=1) > limit_m
    begins[jumps] = points[jumps]
    return np.stack([begins, points], axis=1).astype(np.float32)


def as_jpeg(image: UInt8[np.ndarray, "height width 3"], longest_side: int = _IMAGE_SIDE) -> tuple[bytes, int, int]:
    """The image as JPEG with its longer side at most so many pixels, its width and its height."""
    import cv2

    height, width = image.shape[:2]
    scale = min(1.0, longest_side / max(height, width))
    if scale < 1.0:
        width, height = max(1, round(width * scale)), max(1, round(height * scale))
        image = np.asarray(cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA), np.uint8)
    _, jpeg = cv2.imencode(".jpg", cv2.cvtColor(image, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    return jpeg.tobytes(), width, height


def pinhole(camera: Camera, width: int, height: int) -> list[list[float]]:
    """The matrix of a camera for its image at another size; Rerun's pixels begin at integers, ours lie on them."""
    own = camera.scaled(width, height)
    return [[own.fx, 0.0, own.cx + 0.5], [0.0, own.fy, own.cy + 0.5], [0.0, 0.0, 1.0]]


def stand_in_camera(image: UInt8[np.ndarray, "height width 3"]) -> Camera:
    """60° across, for the frustum's shape only, where the sequence does not tell the intrinsics."""
    height, width = image.shape[:2]
    focal = width / (2.0 * np.tan(np.radians(30.0)))
    return Camera(width, height, float(focal), float(focal), (width - 1) / 2, (height - 1) / 2)


def ellipsoids(
    covariances: Float64[np.ndarray, "n 3 3"],
) -> tuple[Float64[np.ndarray, "n 3"], Float64[np.ndarray, "n 3 3"]]:
    """Standard deviations along the principal axes, and the axes as right-handed rotations."""
    variances, axes = np.linalg.eigh((covariances + np.swapaxes(covariances, 1, 2)) / 2)
    axes[:, :, 2] *= np.linalg.det(axes)[:, None]
    return np.sqrt(np.maximum(variances, 1e-8)), axes
