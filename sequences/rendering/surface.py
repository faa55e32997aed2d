"""A scene ready to be looked at: every surface painted, and lit."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np
from jaxtyping import Float32, Int32

from sequences.rendering.light import Sampling, bake_light
from sequences.rendering.mesh import Geometry, Placement, Tracer, assemble
from sequences.rendering.texture import Canvas


@dataclass(frozen=True)
class LitScene:
    """A scene in which any ray's colour is one look-up.

    Attributes:
        geometry: The parallelograms, which of them are cues, and the chart each one wears.
        tracer: The same, ready for rays.
        normals: Unit normal of each parallelogram.
        start, rows, columns: First texel and size of the chart that each parallelogram wears.
        gloss: Fraction of the Fresnel reflection that each parallelogram mirrors.
        light: Paints and lights the scene when it is first called, and gives `radiance`.
    """

    geometry: Geometry
    tracer: Tracer
    normals: Float32[np.ndarray, "n 3"]
    start: Int32[np.ndarray, " n"]
    rows: Int32[np.ndarray, " n"]
    columns: Int32[np.ndarray, " n"]
    gloss: Float32[np.ndarray, " n"]
    light: Callable[[], Float32[np.ndarray, "texels 3"]]

    @property
    def radiance(self) -> Float32[np.ndarray, "texels 3"]:
        """All texels of all charts, linear; where only geometry is asked for they are never computed."""
        return self.light()


def build_scene(placements: Sequence[Placement], *, seed: int, sampling: Sampling | None = None) -> LitScene:
    """A scene whose charts are painted and lit when its colours are first asked for.

    Args:
        placements: What stands in the scene.
        seed: Of stains, grain and light samples.
        sampling: How closely light is looked at; None for as usual.
    """
    geometry = assemble(placements)
    tracer = Tracer(geometry)
    size = chart_sizes(geometry)
    start = np.concatenate([[0], np.cumsum(size.prod(axis=1))])[:-1].astype(np.int32)
    gloss = np.array([material.gloss for material in geometry.materials], np.float32)
    return LitScene(
        geometry=geometry,
        tracer=tracer,
        normals=geometry.normals().astype(np.float32),
        start=start[geometry.chart],
        rows=size[geometry.chart, 0],
        columns=size[geometry.chart, 1],
        gloss=gloss[geometry.chart],
        light=cache(lambda: _lit(geometry, tracer, seed, sampling)),
    )


def _lit(geometry: Geometry, tracer: Tracer, seed: int, sampling: Sampling | None) -> np.ndarray:
    """All texels: every chart painted, times the light that falls on it or that it gives off."""
    rng = np.random.default_rng(seed)
    size = chart_sizes(geometry)
    painted = [_paint(geometry, chart, size[chart], rng) for chart in range(len(geometry.materials))]
    mean = np.stack([texels.reshape(-1, 3).mean(axis=0) for texels in painted]).astype(np.float64)
    emission = np.array([material.emission for material in geometry.materials])
    reflectance = np.where(emission[:, None] > 0, 0.0, mean)
    light = bake_light(geometry, tracer, reflectance, mean * emission[:, None], rng=rng, sampling=sampling)
    for chart, texels in enumerate(painted):
        if emission[chart] > 0:
            texels *= np.float32(emission[chart] * geometry.materials[chart].glare)
        else:
            texels *= _enlarge(light.of_chart(chart), texels.shape[0], texels.shape[1])
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
