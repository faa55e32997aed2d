"""What a camera of a rendered scene looks at, without its colour."""

import numpy as np
from jaxtyping import Float32, Int64

from filtering.se3 import Poses
from sequences.frame import Camera
from sequences.rendering.render import LitScene, pixel_rays


def depth_and_quads(
    scene: LitScene, camera: Camera, world_from_camera: Poses
) -> tuple[Float32[np.ndarray, "height width"], Int64[np.ndarray, "height width"]]:
    """Depth along the optical axis in metres (inf: nothing) and the parallelogram seen (−1: none), for one pose."""
    ray = pixel_rays(camera).reshape(-1, 3) @ world_from_camera.rotation.T.astype(np.float32)
    origin = np.broadcast_to(world_from_camera.translation.astype(np.float32), ray.shape)
    quad, _, _, depth = scene.tracer.first_hit(origin, ray)
    shape = (camera.height, camera.width)
    return np.where(quad < 0, np.float32(np.inf), depth).reshape(shape), quad.reshape(shape)
