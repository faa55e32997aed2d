"""Geometry of the scenes: parallelograms, grouped into parts that are placed once or many times; rays against them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Float32, Float64, Int64

from sequences.rendering.texture import Material

Vector: TypeAlias = tuple[float | int, float | int, float | int] | np.ndarray
"""x, y, z in metres."""


@dataclass
class Part:
    """A group of parallelograms under construction, in the part's own frame (metres, z up).

    Wherever a part is placed, it looks exactly the same: all placements share one painted and lit surface. That is
    what makes two floors, or two ceiling panels, machine-made copies of each other.

    Attributes:
        cue: Whether this part distinguishes places.
    """

    cue: bool = False
    quads: list[tuple[np.ndarray, np.ndarray, np.ndarray, Material]] = field(default_factory=list)

    def quad(self, origin: Vector, edge_u: Vector, edge_v: Vector, material: Material) -> None:
        """Add the parallelogram origin + s·edge_u + t·edge_v, seen from the side of edge_u × edge_v."""
        self.quads.append((np.array(origin, float), np.array(edge_u, float), np.array(edge_v, float), material))

    def box(self, low: Vector, high: Vector, material: Material, faces: str = "xXyYzZ") -> None:
        """Add faces of an axis-parallel box, seen from outside; lower case names the low side of an axis."""
        (x0, y0, z0), (x1, y1, z1) = np.array(low, float), np.array(high, float)
        dx, dy, dz = x1 - x0, y1 - y0, z1 - z0
        sides = {
            "x": ((x0, y1, z0), (0, -dy, 0), (0, 0, dz)),
            "X": ((x1, y0, z0), (0, dy, 0), (0, 0, dz)),
            "y": ((x0, y0, z0), (dx, 0, 0), (0, 0, dz)),
            "Y": ((x1, y1, z0), (-dx, 0, 0), (0, 0, dz)),
            "z": ((x0, y1, z0), (dx, 0, 0), (0, -dy, 0)),
            "Z": ((x0, y0, z1), (dx, 0, 0), (0, dy, 0)),
        }
        for face in faces:
            origin, edge_u, edge_v = sides[face]
            self.quad(origin, edge_u, edge_v, material)

    def beam(self, start: Vector, end: Vector, radius: float, material: Material, sides: int = 6) -> None:
        """Add the sides of a prism around the line from start to end: a rail, a pipe, a bar."""
        begin, axis = np.array(start, float), np.subtract(end, start).astype(float)
        helper = np.array([0.0, 0.0, 1.0]) if abs(axis[2]) < 0.9 * np.linalg.norm(axis) else np.array([1.0, 0.0, 0.0])
        across = np.cross(helper, axis)
        across /= np.linalg.norm(across)
        up = np.cross(axis, across) / np.linalg.norm(axis)
        angle = np.arange(sides + 1) * 2 * np.pi / sides + np.pi / sides
        ring = begin + radius * (np.cos(angle)[:, None] * across + np.sin(angle)[:, None] * up)
        for corner, following in pairwise(ring):
            self.quad(corner, following - corner, axis, material)


@dataclass(frozen=True)
class Placement:
    """A part and where its k copies stand.

    Every copy is turned about z by its heading, radians, and then moved by its offset, metres. All wear the light of
    the copy with the index `lit_at`.
    """

    part: Part
    offsets: Float64[np.ndarray, "k 3"]
    headings: Float64[np.ndarray, " k"] | float = 0.0
    lit_at: int = 0


@dataclass(frozen=True)
class Geometry:
    """All parallelograms of a scene, metres, world frame, and the charts (painted, lit surfaces) that they wear.

    `cue` marks those of unique things. The light of a chart is computed at the parallelogram
    `chart_quad`, whose origin in the frame of the part is `chart_point`.
    """

    origin: Float64[np.ndarray, "n 3"]
    edge_u: Float64[np.ndarray, "n 3"]
    edge_v: Float64[np.ndarray, "n 3"]
    chart: Int64[np.ndarray, " n"]
    cue: Bool[np.ndarray, " n"]
    chart_quad: Int64[np.ndarray, " m"]
    chart_point: Float64[np.ndarray, "m 3"]
    materials: tuple[Material, ...]

    def triangles(self) -> Float64[np.ndarray, "n2 3 3"]:
        """Two triangles a parallelogram, (o, o+u, o+u+v) and (o, o+u+v, o+v), in the order of the parallelograms."""
        o, far = self.origin, self.origin + self.edge_u + self.edge_v
        first = np.stack([o, o + self.edge_u, far], axis=1)
        second = np.stack([o, far, o + self.edge_v], axis=1)
        return np.stack([first, second], axis=1).reshape(-1, 3, 3)

    def normals(self) -> Float64[np.ndarray, "n 3"]:
        """Unit normals, on the side from which each parallelogram is meant to be seen."""
        normal = np.cross(self.edge_u, self.edge_v)
        return normal / np.linalg.norm(normal, axis=1, keepdims=True)


def assemble(placements: Sequence[Placement]) -> Geometry:
    """Place every part at all its offsets and headings."""
    origin, edge_u, edge_v, chart, cue, chart_quad, chart_point, materials = [], [], [], [], [], [], [], []
    num_quads = 0
    for placement in placements:
        part = placement.part
        local = np.stack([quad[0] for quad in part.quads])
        us, vs = np.stack([quad[1] for quad in part.quads]), np.stack([quad[2] for quad in part.quads])
        headings = np.broadcast_to(placement.headings, len(placement.offsets))
        for offset, heading in zip(placement.offsets, headings, strict=True):
            cos, sin = np.cos(heading), np.sin(heading)
            turn = np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]])  # of row vectors
            origin.append(local @ turn + offset)
            edge_u.append(us @ turn)
            edge_v.append(vs @ turn)
            chart.append(len(materials) + np.arange(len(local)))
            cue.append(np.full(len(local), part.cue))
        chart_quad.append(num_quads + placement.lit_at * len(local) + np.arange(len(local)))
        chart_point.append(local)
        num_quads += len(placement.offsets) * len(local)
        materials.extend(quad[3] for quad in part.quads)
    return Geometry(
        origin=np.concatenate(origin),
        edge_u=np.concatenate(edge_u),
        edge_v=np.concatenate(edge_v),
        chart=np.concatenate(chart),
        cue=np.concatenate(cue),
        chart_quad=np.concatenate(chart_quad),
        chart_point=np.concatenate(chart_point),
        materials=tuple(materials),
    )


class Tracer:
    """A scene's triangles in Embree's acceleration structure."""

    def __init__(self, geometry: Geometry):
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene

        self._scene = EmbreeScene()
        self._mesh = TriangleMesh(self._scene, geometry.triangles().astype(np.float32))

    def first_hit(
        self, origin: Float[np.ndarray, "n 3"], direction: Float[np.ndarray, "n 3"]
    ) -> tuple[
        Int64[np.ndarray, " n"], Float32[np.ndarray, " n"], Float32[np.ndarray, " n"], Float32[np.ndarray, " n"]
    ]:
        """The parallelogram that each ray meets first (−1: none), where on it (s, t in [0, 1]; 0 for none) and how far.

        The distance is in units of the direction's length.
        """
        hit = self._scene.run(
            np.ascontiguousarray(origin, np.float32), np.ascontiguousarray(direction, np.float32), output=1
        )
        triangle = hit["primID"].astype(np.int64)
        u, v = (np.where(triangle >= 0, hit[name], np.float32(0.0)) for name in ("u", "v"))  # unset where none is met
        second = (triangle & 1).astype(np.float32)
        # first triangle: s = u + v, t = v; second: s = u, t = u + v (see Geometry.triangles)
        # and stays below 1, so that int(s · columns) is a column
        below_one = np.float32(1 - 1e-6)
        return (
            triangle >> 1,
            np.minimum(u + (1 - second) * v, below_one),
            np.minimum(v + second * u, below_one),
            hit["tfar"],
        )

    def blocked(self, origin: Float[np.ndarray, "n 3"], ray: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        """Whether anything lies between each origin and origin + ray."""
        far = np.ones(len(origin), np.float32)
        hit = self._scene.run(
            np.ascontiguousarray(origin, np.float32), np.ascontiguousarray(ray, np.float32), far, query="OCCLUDED"
        )
        return hit == 0
