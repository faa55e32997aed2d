"""Light, computed once for a scene: soft shadows from lamps and windows, and two bounces."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Float64, Int64
from scipy.ndimage import distance_transform_edt

from sequences.rendering.mesh import Geometry, Tracer

MAX_GRID = 45  # points along a side of a large surface


@dataclass(frozen=True)
class Sampling:
    """Density of light samples.

    Attributes:
        grid_m: Spacing of the points at which light is computed.
        shadow_rays: To each lamp or window, from each point.
        bounce_rays: From each point.
        reach_m: Farther lamps do not count.
    """

    grid_m: float = 0.11
    shadow_rays: int = 24
    bounce_rays: int = 96
    reach_m: float = 9.0


@dataclass(frozen=True)
class LightMap:
    """Irradiance / π of every chart, on a grid of (rows, columns) points a chart, flattened one after the other.

    Attributes:
        start: Index of each chart's first point.
        rows, columns: Size of each chart's grid.
        radiosity: Light per point that a white surface would send out.
    """

    start: Int64[np.ndarray, " m"]
    rows: Int64[np.ndarray, " m"]
    columns: Int64[np.ndarray, " m"]
    radiosity: Float32[np.ndarray, "p 3"]

    def of_chart(self, chart: int) -> Float32[np.ndarray, "rows columns 3"]:
        """The grid of one chart."""
        rows, columns = int(self.rows[chart]), int(self.columns[chart])
        start = int(self.start[chart])
        return self.radiosity[start : start + rows * columns].reshape(rows, columns, 3)


def bake_light(
    geometry: Geometry,
    tracer: Tracer,
    reflectance: Float64[np.ndarray, "m 3"],
    emitted: Float64[np.ndarray, "m 3"],
    *,
    rng: np.random.Generator,
    sampling: Sampling | None = None,
) -> LightMap:
    """Direct light from every emitting surface with soft shadows, and two diffuse bounces.

    Args:
        geometry: The scene.
        tracer: The same scene, ready for rays.
        reflectance: Mean reflectance of each chart.
        emitted: Mean radiance given off by each chart, zero for most.
        rng: Source of the sample positions.
        sampling: Number of points and rays; None for the defaults.
    """
    sampling = sampling or Sampling()
    quads = geometry.chart_quad
    edge_u, edge_v = geometry.edge_u[quads], geometry.edge_v[quads]
    size_u, size_v = np.linalg.norm(edge_u, axis=1), np.linalg.norm(edge_v, axis=1)
    spacing = np.maximum(sampling.grid_m, np.sqrt(size_u * size_v) / MAX_GRID)
    columns = np.maximum(1, np.round(size_u / spacing)).astype(np.int64)
    rows = np.maximum(1, np.round(size_v / spacing)).astype(np.int64)
    start = np.concatenate([[0], np.cumsum(rows * columns)])
    chart = np.repeat(np.arange(len(quads)), rows * columns)
    local = np.arange(start[-1]) - start[chart]
    s = (local % columns[chart] + 0.5) / columns[chart]
    t = (local // columns[chart] + 0.5) / rows[chart]
    normal = geometry.normals()[quads][chart]
    point = geometry.origin[quads][chart] + s[:, None] * edge_u[chart] + t[:, None] * edge_v[chart] + 2e-3 * normal

    direct = _direct(geometry, tracer, emitted, point, normal, rng, sampling)
    hit_chart, hit_index, valid = _bounce_targets(
        geometry, tracer, point, normal, start, rows, columns, rng, sampling.bounce_rays
    )
    direct[~valid] = 0
    light = direct
    for _ in range(2):
        sent = light * reflectance[chart]
        light = direct + np.where(hit_chart[..., None] >= 0, sent[np.maximum(hit_index, 0)], 0.0).mean(axis=1)
    radiosity = light.astype(np.float32)
    for index in np.unique(chart[~valid]):
        _fill(radiosity, valid, int(start[index]), int(rows[index]), int(columns[index]))
    return LightMap(start[:-1], rows, columns, radiosity)


def _direct(
    geometry: Geometry,
    tracer: Tracer,
    emitted: np.ndarray,
    point: np.ndarray,
    normal: np.ndarray,
    rng: np.random.Generator,
    sampling: Sampling,
) -> np.ndarray:
    light = np.zeros((len(point), 3))
    lamp_normals = geometry.normals()
    side = int(np.ceil(np.sqrt(sampling.shadow_rays)))
    for lamp in np.flatnonzero(emitted[geometry.chart].max(axis=1) > 0):
        origin, u, v = geometry.origin[lamp], geometry.edge_u[lamp], geometry.edge_v[lamp]
        to_lamp = origin + (u + v) / 2 - point
        corners = np.stack([origin, origin + u, origin + v, origin + u + v])
        reached = np.linalg.norm(to_lamp, axis=1) < sampling.reach_m
        reached &= (((point[:, None] - corners) @ lamp_normals[lamp]) > 1e-3).any(axis=1)
        reached &= (np.einsum("nkd,nd->nk", corners - point[:, None], normal) > 0).any(axis=1)
        who = np.flatnonzero(reached)
        if not len(who):
            continue
        cell = np.stack(np.meshgrid(np.arange(side), np.arange(side), indexing="ij"), axis=-1).reshape(-1, 2)
        st = (cell + rng.random((len(who), side * side, 2))) / side
        ray = origin + st[..., :1] * u + st[..., 1:] * v - point[who][:, None]
        distance_sq = np.sum(ray**2, axis=-1)
        cos_here = np.einsum("nkd,nd->nk", ray, normal[who])
        cos_there = -(ray @ lamp_normals[lamp])
        gain = np.clip(cos_here, 0, None) * np.clip(cos_there, 0, None) / np.maximum(distance_sq, 0.01) ** 2
        area = np.linalg.norm(np.cross(u, v))
        free = ~tracer.blocked(np.repeat(point[who], side * side, axis=0), (ray * 0.995).reshape(-1, 3))
        fraction = (gain * free.reshape(gain.shape)).mean(axis=1) * area / np.pi
        light[who] += fraction[:, None] * emitted[geometry.chart[lamp]]
    return light


def _bounce_targets(
    geometry: Geometry,
    tracer: Tracer,
    point: np.ndarray,
    normal: np.ndarray,
    start: np.ndarray,
    rows: np.ndarray,
    columns: np.ndarray,
    rng: np.random.Generator,
    num_rays: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Chart and light point (n, k) at the end of cosine-distributed rays; which points see open space."""
    k = np.arange(num_rays)
    u1 = (k + 0.5) / num_rays
    u2 = (k * 0.6180339887 + rng.random((len(point), 1))) % 1.0
    radius, angle = np.sqrt(u1)[None], 2 * np.pi * u2
    helper = np.where(np.abs(normal[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    across = np.cross(helper, normal)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    other = np.cross(normal, across)
    ray = (
        (radius * np.cos(angle))[..., None] * across[:, None]
        + (radius * np.sin(angle))[..., None] * other[:, None]
        + np.sqrt(1 - u1)[None, :, None] * normal[:, None]
    ).reshape(-1, 3)
    quad, s, t, _ = tracer.first_hit(np.repeat(point, num_rays, axis=0), ray)
    facing = np.einsum("nd,nd->n", geometry.normals()[quad], ray) < 0
    chart = np.where((quad >= 0) & facing, geometry.chart[quad], -1)
    safe = np.maximum(chart, 0)
    column = np.clip((s * columns[safe]).astype(np.int64), 0, columns[safe] - 1)
    row = np.clip((t * rows[safe]).astype(np.int64), 0, rows[safe] - 1)
    index = start[safe] + row * columns[safe] + column
    shape = (len(point), num_rays)
    behind = ((quad >= 0) & ~facing).reshape(shape)
    return chart.reshape(shape), index.reshape(shape), behind.mean(axis=1) < 0.3


def _fill(radiosity: np.ndarray, valid: np.ndarray, start: int, rows: int, columns: int) -> None:
    """Give points inside other bodies the light of the nearest point in the open: no darkness bleeds out."""
    grid = valid[start : start + rows * columns].reshape(rows, columns)
    if not grid.any():
        return
    nearest = np.asarray(distance_transform_edt(~grid, return_distances=False, return_indices=True))
    values = radiosity[start : start + rows * columns].reshape(rows, columns, 3)
    values[:] = values[nearest[0], nearest[1]]
