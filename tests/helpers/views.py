"""Views of cameras in a rendered scene, and of a pattern with and without lens distortion."""

from copy import copy

import cv2
import numpy as np
from jaxtyping import Float32, Int64

from filtering.se3 import Poses
from sequences.frame import Camera
from sequences.images.undistortion import Lens
from sequences.rendering.mesh import Tracer
from sequences.rendering.render import LitScene, pixel_rays, render


def shifted(pose: Poses, x: float, y: float, z: float) -> Poses:
    return Poses(pose.rotation, pose.translation + np.array([x, y, z]))


def picture(scene: LitScene, camera: Camera, pose: Poses) -> np.ndarray:
    return render(scene, camera, Poses.stack([pose] * 4), rng=np.random.default_rng(0))


def matt(scene: LitScene) -> LitScene:
    """The scene without its glossy reflections, which scatter at random."""
    found = copy(scene)
    found.gloss = np.zeros_like(scene.gloss)
    return found


def fraction_that_differs(first: np.ndarray, second: np.ndarray) -> float:
    return float((np.abs(first - second).max(axis=2) > 0.1 * (0.05 + first.mean(axis=2))).mean())


def require_free(scene: LitScene | Tracer, eyes: np.ndarray) -> np.ndarray:
    """A camera at these places passes through no wall and comes within 10 cm of none; the distances that it sees."""
    tracer = scene if isinstance(scene, Tracer) else scene.tracer
    assert not tracer.blocked(eyes[:-1], np.diff(eyes, axis=0)).any()
    origin, ray = from_all(eyes[::10])
    assert not tracer.blocked(origin, 0.1 * ray).any()
    quad, _, _, far = tracer.first_hit(origin, ray)
    assert (quad >= 0).all()
    return far


def from_all(places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rays of length 1 from each place in 40 directions: origins and directions."""
    around = np.random.default_rng(0).standard_normal((40, 3))
    around /= np.linalg.norm(around, axis=1, keepdims=True)
    return np.repeat(places, 40, axis=0), np.tile(around, (len(places), 1))


def depth_and_quads(
    scene: LitScene, camera: Camera, world_from_camera: Poses
) -> tuple[Float32[np.ndarray, "height width"], Int64[np.ndarray, "height width"]]:
    """Depth along the optical axis in metres (inf: nothing) and the parallelogram seen (−1: none), for one pose."""
    ray = pixel_rays(camera).reshape(-1, 3) @ world_from_camera.rotation.T.astype(np.float32)
    origin = np.broadcast_to(world_from_camera.translation.astype(np.float32), ray.shape)
    quad, _, _, depth = scene.tracer.first_hit(origin, ray)
    shape = (camera.height, camera.width)
    return np.where(quad < 0, np.float32(np.inf), depth).reshape(shape), quad.reshape(shape)


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
