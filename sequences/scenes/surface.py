"""Painted and lit surfaces: a scene ready to be looked at."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float32, Int64

from sequences.scenes.light import bake_light
from sequences.scenes.mesh import Geometry, Placement, assemble
from sequences.scenes.texture import Canvas
from sequences.scenes.tracer import Tracer


@dataclass(frozen=True)
class Scene:
    """A scene whose light is computed: any ray's colour is one look-up.

    Attributes:
        geometry: The parallelograms, which of them are cues, and the chart each one wears.
        tracer: The same, ready for rays.
        start, rows, columns: First texel and size of each chart.
        gloss: Share of the Fresnel reflection that each chart mirrors.
        radiance: All texels of all charts, linear.
    """

    geometry: Geometry
    tracer: Tracer
    start: Int64[np.ndarray, " m"]
    rows: Int64[np.ndarray, " m"]
    columns: Int64[np.ndarray, " m"]
    gloss: Float32[np.ndarray, " m"]
    radiance: Float32[np.ndarray, "texels 3"]


def build_scene(placements: Sequence[Placement], *, seed: int) -> Scene:
    """Paint every chart, light it, and keep the product.

    Args:
        placements: What stands in the scene.
        seed: Of stains, grain and light samples.
    """
    geometry = assemble(placements)
    tracer = Tracer(geometry)
    rng = np.random.default_rng(seed)
    painted = [_paint(geometry, chart, rng) for chart in range(len(geometry.materials))]
    mean = np.stack([texels.reshape(-1, 3).mean(axis=0) for texels in painted]).astype(np.float64)
    emission = np.array([material.emission for material in geometry.materials])
    reflectance = np.where(emission[:, None] > 0, 0.0, mean)
    light = bake_light(geometry, tracer, reflectance, mean * emission[:, None], rng=rng)
    for chart, texels in enumerate(painted):
        if emission[chart] > 0:
            texels *= np.float32(emission[chart] * geometry.materials[chart].glare)
        else:
            texels *= _enlarge(light.of_chart(chart), texels.shape[0], texels.shape[1])
    rows, columns = (np.array([texels.shape[axis] for texels in painted]) for axis in (0, 1))
    start = np.concatenate([[0], np.cumsum(rows * columns)])[:-1]
    gloss = np.array([material.gloss for material in geometry.materials], np.float32)
    radiance = np.concatenate([texels.reshape(-1, 3) for texels in painted])
    return Scene(geometry, tracer, start, rows, columns, gloss, radiance)


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
    """Bilinear interpolation of a small grid of light to the texels, after a slight blur against sampling noise."""
    if min(grid.shape[:2]) > 1:
        grid = cv2.GaussianBlur(grid, (3, 3), 0.7, borderType=cv2.BORDER_REFLECT_101)
    return cv2.resize(grid, (columns, rows), interpolation=cv2.INTER_LINEAR)
