"""Light, computed once for a scene: soft shadows from lamps and windows, and two bounces."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Float64
from scipy.ndimage import distance_transform_edt

from sequences.rendering.mesh import Geometry, Tracer

_MOST_POINTS = 45  # along a side of a large surface


@dataclass(frozen=True)
class Sampling:
    """Density of light samples: spacing of the points, and rays from each to every lamp and all around.

    Lamps beyond `reach_m` do not count.
    """

    grid_m: float = 0.11
    shadow_rays: int = 24
    bounce_rays: int = 96
    reach_m: float = 9.0


USUAL = Sampling()


def bake_light(
    geometry: Geometry,
    tracer: Tracer,
    reflectance: Float64[np.ndarray, "m 3"],
    emitted: Float64[np.ndarray, "m 3"],
    *,
    rng: np.random.Generator,
    sampling: Sampling = USUAL,
) -> list[Float32[np.ndarray, "rows columns 3"]]:
    """Irradiance / π of every chart, on a grid of points: direct light with soft shadows, and two diffuse bounces.

    Args:
        geometry: The scene.
        tracer: The same scene, ready for rays.
        reflectance: Mean reflectance of each chart.
        emitted: Mean radiance given off by each chart, zero for most.
        rng: Source of the sample positions.
        sampling: Number of points and rays.
    """
    quads = geometry.chart_quad
    edge_u, edge_v = geometry.edge_u[quads], geometry.edge_v[quads]
    size_u, size_v = np.linalg.norm(edge_u, axis=1), np.linalg.norm(edge_v, axis=1)
    spacing = np.maximum(sampling.grid_m, np.sqrt(size_u * size_v) / _MOST_POINTS)
    columns = np.maximum(1, np.round(size_u / spacing)).astype(np.int64)
    rows = np.maximum(1, np.round(size_v / spacing)).astype(np.int64)
    start = np.cumsum(rows * columns) - rows * columns
    chart = np.repeat(np.arange(len(quads)), rows * columns)
    local = np.arange(len(chart)) - start[chart]
    s = (local % columns[chart] + 0.5) / columns[chart]
    t = (local // columns[chart] + 0.5) / rows[chart]
    normal = geometry.normals()[quads][chart]
    point = geometry.origin[quads][chart] + s[:, None] * edge_u[chart] + t[:, None] * edge_v[chart] + 2e-3 * normal

    direct = _direct(geometry, tracer, emitted, point, normal, rng, sampling)
    hit, s, t, is_open = _bounces(geometry, tracer, point, normal, rng, sampling.bounce_rays)
    column = np.clip((s * columns[hit]).astype(np.int64), 0, columns[hit] - 1)
    row = np.clip((t * rows[hit]).astype(np.int64), 0, rows[hit] - 1)
    index = start[hit] + row * columns[hit] + column
    direct[~is_open] = 0
    light = direct
    for _ in range(2):
        sent = light * reflectance[chart]
        light = direct + np.where(hit[..., None] >= 0, sent[index], 0.0).mean(axis=1)
    grids = np.split(light.astype(np.float32), start[1:])
    opened = np.split(is_open, start[1:])
    return [
        _filled(grid.reshape(height, width, 3), known.reshape(height, width))
        for grid, known, height, width in zip(grids, opened, rows, columns, strict=True)
    ]


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


def _bounces(
    geometry: Geometry, tracer: Tracer, point: np.ndarray, normal: np.ndarray, rng: np.random.Generator, num_rays: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Chart (−1: none) and place on it, (n, k) each, at the end of cosine-distributed rays; which points are outside.

    Points inside other bodies see the back of surfaces.
    """
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
    is_facing = np.einsum("nd,nd->n", geometry.normals()[quad], ray) < 0
    chart = np.where((quad >= 0) & is_facing, geometry.chart[quad], -1)
    behind = ((quad >= 0) & ~is_facing).reshape(len(point), num_rays)
    shape = behind.shape
    return chart.reshape(shape), s.reshape(shape), t.reshape(shape), behind.mean(axis=1) < 0.3


def _filled(grid: np.ndarray, is_open: np.ndarray) -> np.ndarray:
    """Points inside other bodies have the light of the nearest point outside: no darkness bleeds out."""
    if is_open.all() or not is_open.any():
        return grid
    nearest = np.asarray(distance_transform_edt(~is_open, return_distances=False, return_indices=True))
    return grid[nearest[0], nearest[1]]
