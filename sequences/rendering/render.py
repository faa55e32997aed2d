"""A pinhole camera in a lit scene, with motion blur: rays, look-ups and mirror reflections."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float32, Int64

from filtering.se3 import Poses
from sequences.frame import Camera
from sequences.rendering.surface import LitScene

# Where in the pixel the rays of successive sub-exposures pass: the R2 sequence (Roberts 2018), which fills the pixel
# evenly for any number of them.
_R2 = np.array([0.7548776662466927, 0.5698402909980532])
_ROUGHNESS = 0.03  # spread of mirror reflections, radians
_FAINT = 0.02  # reflections weaker than this are not followed
_MISS = np.array([0.5, 0.6, 0.7], np.float32)


def render(
    scene: LitScene, camera: Camera, world_from_camera: Poses, *, rng: np.random.Generator
) -> Float32[np.ndarray, "height width 3"]:
    """Linear radiance at the pixels, averaged over an exposure.

    Args:
        scene: What is seen.
        camera: Intrinsics.
        world_from_camera: Camera poses during the exposure, batch (k,); each gives one sample per pixel, at another
            place in the pixel, so that motion blur and antialiasing cost no more than either.
        rng: Scatter of the glossy reflections.
    """
    total = np.zeros((camera.height * camera.width, 3), np.float32)
    for index in range(len(world_from_camera)):
        offset = (0.5 + (index + 1) * _R2) % 1.0 - 0.5
        ray = pixel_rays(camera, (float(offset[0]), float(offset[1]))).reshape(-1, 3)
        direction = ray @ world_from_camera.rotation[index].T.astype(np.float32)
        origin = np.broadcast_to(world_from_camera.translation[index].astype(np.float32), direction.shape)
        total += _colour(scene, origin, direction, rng)
    return (total / np.float32(len(world_from_camera))).reshape(camera.height, camera.width, 3)


def pixel_rays(camera: Camera, offset: tuple[float, float] = (0.0, 0.0)) -> Float32[np.ndarray, "height width 3"]:
    """Viewing rays (x, y, 1) of all pixels in the camera frame, through their centres plus an offset in pixels."""
    x = (np.arange(camera.width) + offset[0] - camera.cx) / camera.fx
    y = (np.arange(camera.height) + offset[1] - camera.cy) / camera.fy
    ray = np.ones((camera.height, camera.width, 3), np.float32)
    ray[..., 0] = x
    ray[..., 1] = y[:, None]
    return ray


def sees_cue(
    scene: LitScene, camera: Camera, world_from_camera: Poses, *, min_fraction: float = 0.015
) -> Bool[np.ndarray, " n"]:
    """Whether something unique covers at least the given fraction of the image, for poses (n,)."""
    small = Camera(32, 24, camera.fx * 32 / camera.width, camera.fy * 24 / camera.height, 15.5, 11.5)
    ray = pixel_rays(small).reshape(-1, 3).astype(np.float64)
    direction = np.einsum("nij,rj->nri", world_from_camera.rotation, ray).reshape(-1, 3)
    quad, _, _, _ = scene.tracer.first_hit(np.repeat(world_from_camera.translation, len(ray), axis=0), direction)
    seen = scene.geometry.cue[quad] & (quad >= 0)
    return seen.reshape(len(world_from_camera), -1).mean(axis=1) >= min_fraction


def _colour(
    scene: LitScene, origin: Float32[np.ndarray, "n 3"], direction: Float32[np.ndarray, "n 3"], rng: np.random.Generator
) -> Float32[np.ndarray, "n 3"]:
    colour, quad, distance = _look_up(scene, origin, direction)
    shiny = np.flatnonzero(scene.gloss[quad] > 0)
    incoming = direction[shiny]
    incoming /= np.sqrt(np.einsum("nd,nd->n", incoming, incoming))[:, None]
    normal = scene.normals[quad[shiny]]
    cosine = -np.einsum("nd,nd->n", normal, incoming)
    # Schlick's approximation, without the few per cent that are mirrored head-on: they would cost most and show least.
    fresnel = scene.gloss[quad[shiny]] * (1 - np.clip(np.abs(cosine), 0, 1)) ** 5
    kept = np.flatnonzero(fresnel > _FAINT)
    shiny, incoming, normal, cosine, fresnel = (a[kept] for a in (shiny, incoming, normal, cosine, fresnel))
    if len(shiny):
        mirrored = incoming + 2 * cosine[:, None] * normal
        mirrored += np.float32(_ROUGHNESS) * rng.standard_normal(mirrored.shape, np.float32)
        start = origin[shiny] + distance[shiny, None] * direction[shiny] + np.float32(1e-3) * normal
        reflected, _, _ = _look_up(scene, start, mirrored)
        colour[shiny] += fresnel[:, None] * reflected
    return colour


def _look_up(
    scene: LitScene, origin: Float32[np.ndarray, "n 3"], direction: Float32[np.ndarray, "n 3"]
) -> tuple[Float32[np.ndarray, "n 3"], Int64[np.ndarray, " n"], Float32[np.ndarray, " n"]]:
    """Colour, parallelogram and distance of what each ray meets; rays that leave the scene see a dull sky."""
    quad, s, t, distance = scene.tracer.first_hit(origin, direction)
    columns = scene.columns[quad]
    texel = scene.start[quad] + (t * scene.rows[quad]).astype(np.int32) * columns
    texel += (s * columns).astype(np.int32)
    colour = scene.radiance.take(texel, axis=0, mode="clip")
    missed = quad < 0
    if missed.any():
        colour[missed] = _MISS
    return colour, quad, distance
