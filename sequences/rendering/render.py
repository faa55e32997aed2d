"""A lit scene, and a pinhole camera in it with motion blur and mirror reflections."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Int32, Int64

from filtering.se3 import Poses
from sequences.frame import Camera
from sequences.rendering.light import USUAL, Sampling, bake_light
from sequences.rendering.mesh import Geometry, Placement, Tracer, assemble
from sequences.rendering.texture import Canvas


class LitScene:
    """A scene in which any ray's colour is one look-up.

    Attributes:
        geometry: The parallelograms, which of them are cues, and the chart each one wears.
        tracer: The same, ready for rays.
        normals: Unit normal of each parallelogram.
        start, rows, columns: First texel and size of the chart that each parallelogram wears.
        gloss: Fraction of the Fresnel reflection that each parallelogram mirrors.
    """

    normals: Float32[np.ndarray, "n 3"]
    start: Int32[np.ndarray, " n"]
    rows: Int32[np.ndarray, " n"]
    columns: Int32[np.ndarray, " n"]
    gloss: Float32[np.ndarray, " n"]

    def __init__(self, placements: Sequence[Placement], *, seed: int, sampling: Sampling = USUAL) -> None:
        """Place the parts; the seed is of stains, grain and light samples."""
        self.geometry = geometry = assemble(placements)
        self.tracer = Tracer(geometry)
        self.normals = geometry.normals().astype(np.float32)
        self._seed, self._sampling, self._sizes = seed, sampling, chart_sizes(geometry)
        start = np.concatenate([[0], np.cumsum(self._sizes.prod(axis=1))])[:-1].astype(np.int32)
        self.start = start[geometry.chart]
        self.rows, self.columns = self._sizes[geometry.chart].T
        self.gloss = np.array([material.gloss for material in geometry.materials], np.float32)[geometry.chart]

    @cached_property
    def radiance(self) -> Float32[np.ndarray, "texels 3"]:
        """All texels: every chart painted, times the light that falls on it or that it gives off.

        They are computed when they are first asked for, which they are not where only geometry is.
        """
        geometry, rng = self.geometry, np.random.default_rng(self._seed)
        painted = [_paint(geometry, chart, size, rng) for chart, size in enumerate(self._sizes)]
        mean = np.stack([texels.reshape(-1, 3).mean(axis=0) for texels in painted]).astype(np.float64)
        emission = np.array([material.emission for material in geometry.materials])
        reflectance = np.where(emission[:, None] > 0, 0.0, mean)
        emitted = mean * emission[:, None]
        light = bake_light(geometry, self.tracer, reflectance, emitted, rng=rng, sampling=self._sampling)
        for material, texels, grid in zip(geometry.materials, painted, light, strict=True):
            if material.emission > 0:
                texels *= np.float32(material.emission * material.glare)
            else:
                texels *= _enlarge(grid, texels.shape[0], texels.shape[1])
        return np.concatenate([texels.reshape(-1, 3) for texels in painted])


def chart_sizes(geometry: Geometry) -> Int32[np.ndarray, "m 2"]:
    """Rows and columns of texels of every chart."""
    texel = np.array([material.texel_m for material in geometry.materials])[:, None]
    sides = [np.linalg.norm(edge[geometry.chart_quad], axis=1) for edge in (geometry.edge_v, geometry.edge_u)]
    return np.maximum(1, np.round(np.stack(sides, axis=1) / texel)).astype(np.int32)


def _paint(geometry: Geometry, chart: int, size: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    material = geometry.materials[chart]
    quad = geometry.chart_quad[chart]
    width, height = (float(np.linalg.norm(edge[quad])) for edge in (geometry.edge_u, geometry.edge_v))
    rows, columns = (int(side) for side in size)
    canvas = Canvas(
        x=((np.arange(columns, dtype=np.float32) + 0.5) * (width / columns)).astype(np.float32)[None],
        y=((np.arange(rows, dtype=np.float32) + 0.5) * (height / rows)).astype(np.float32)[:, None],
        width_m=width,
        height_m=height,
        origin=geometry.chart_point[chart],
        along_u=geometry.edge_u[quad] / width,
        along_v=geometry.edge_v[quad] / height,
        rng=rng,
    )
    return np.ascontiguousarray(np.clip(material.paint(canvas), 0.0, None), np.float32)


def _enlarge(grid: np.ndarray, rows: int, columns: int) -> np.ndarray:
    """Bilinear interpolation of a small grid of light to the texels, after a slight blur against sampling noise.

    The rim is extrapolated, so that light goes on evenly from one surface to the next.
    """
    for axis in (0, 1):
        if grid.shape[axis] > 1:
            first, second, third, last = (grid.take([i], axis) for i in (0, 1, -2, -1))
            before, after = (2 * rim - inner for rim, inner in ((first, second), (last, third)))
            grid = np.concatenate([np.maximum(before, 0.5 * first), grid, np.maximum(after, 0.5 * last)], axis=axis)
        else:
            grid = np.repeat(grid, 3, axis=axis)
    blurred = cv2.GaussianBlur(grid, (3, 3), 0.5, borderType=cv2.BORDER_REPLICATE)
    y = (np.arange(rows, dtype=np.float32) + 0.5) / rows * (grid.shape[0] - 2) + 0.5
    x = (np.arange(columns, dtype=np.float32) + 0.5) / columns * (grid.shape[1] - 2) + 0.5
    map_x, map_y = np.meshgrid(x.astype(np.float32), y.astype(np.float32))
    return cv2.remap(blurred, map_x, map_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


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
        scene: Painted and lit surfaces.
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
