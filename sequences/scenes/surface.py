"""Painted and lit surfaces: a scene ready to be looked at."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float32, Int32

from sequences.scenes.light import Sampling, bake_light
from sequences.scenes.mesh import Geometry, Placement, assemble
from sequences.scenes.texture import Canvas
from sequences.scenes.tracer import Tracer


@dataclass(frozen=True)
class Scene:
    """A scene whose light is computed: any ray's colour is one look-up.

    Attributes:
        geometry: The parallelograms, which of them are cues, and the chart each one wears.
        tracer: The same, ready for rays.
        normals: Unit normal of each parallelogram.
        start, rows, columns: First texel and size of the chart that each parallelogram wears.
        gloss: Share of the Fresnel reflection that each parallelogram mirrors.
        radiance: All texels of all charts, linear.
    """

    geometry: Geometry
    tracer: Tracer
    normals: Float32[np.ndarray, "n 3"]
    start: Int32[np.ndarray, " n"]
    rows: Int32[np.ndarray, " n"]
    columns: Int32[np.ndarray, " n"]
    gloss: Float32[np.ndarray, " n"]
    radiance: Float32[np.ndarray, "texels 3"]


def build_scene(placements: Sequence[Placement], *, seed: int, sampling: Sampling | None = None) -> Scene:
    """Paint every chart, light it, and keep the product.

    Args:
        placements: What stands in the scene.
        seed: Of stains, grain and light samples.
        sampling: How closely light is looked at; None for as usual.
    """
    geometry = assemble(placements)
    tracer = Tracer(geometry)
    rng = np.random.default_rng(seed)
    painted = [_paint(geometry, chart, rng) for chart in range(len(geometry.materials))]
    mean = np.stack([texels.reshape(-1, 3).mean(axis=0) for texels in painted]).astype(np.float64)
    emission = np.array([material.emission for material in geometry.materials])
    reflectance = np.where(emission[:, None] > 0, 0.0, mean)
    light = bake_light(geometry, tracer, reflectance, mean * emission[:, None], rng=rng, sampling=sampling)
    for chart, texels in enumerate(painted):
        if emission[chart] > 0:
            texels *= np.float32(emission[chart] * geometry.materials[chart].glare)
        else:
            texels *= _enlarge(light.of_chart(chart), texels.shape[0], texels.shape[1])
    size = np.array([texels.shape[:2] for texels in painted], np.int32)
    start = np.concatenate([[0], np.cumsum(size.prod(axis=1))])[:-1].astype(np.int32)
    gloss = np.array([material.gloss for material in geometry.materials], np.float32)
    return Scene(
        geometry=geometry,
        tracer=tracer,
        normals=geometry.normals().astype(np.float32),
        start=start[geometry.chart],
        rows=size[geometry.chart, 0],
        columns=size[geometry.chart, 1],
        gloss=gloss[geometry.chart],
        radiance=np.concatenate([texels.reshape(-1, 3) for texels in painted]),
    )


def _paint(geometry: Geometry, chart: int, rng: np.random.Generator) -> np.ndarray:
    material = geometry.materials[chart]
    quad = geometry.chart_quad[chart]
    width, height = (float(np.linalg.norm(edge[quad])) for edge in (geometry.edge_u, geometry.edge_v))
    columns, rows = (max(1, round(size / material.texel_m)) for size in (width, height))
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
