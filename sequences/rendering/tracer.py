"""Rays against parallelograms, with Embree."""

from __future__ import annotations

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from jaxtyping import Bool, Float, Float32, Int64

from sequences.rendering.mesh import Geometry


class Tracer:
    """A scene's triangles in Embree's acceleration structure."""

    def __init__(self, geometry: Geometry):
        self._scene = EmbreeScene()
        self._mesh = TriangleMesh(self._scene, geometry.triangles().astype(np.float32))

    def first_hit(
        self, origin: Float[np.ndarray, "n 3"], direction: Float[np.ndarray, "n 3"]
    ) -> tuple[
        Int64[np.ndarray, " n"], Float32[np.ndarray, " n"], Float32[np.ndarray, " n"], Float32[np.ndarray, " n"]
    ]:
        """The parallelogram that each ray meets first (−1: none), where on it (s, t in [0, 1]) and how far.

        The distance is in units of the direction's length.
        """
        hit = self._scene.run(
            np.ascontiguousarray(origin, np.float32), np.ascontiguousarray(direction, np.float32), output=1
        )
        triangle, u, v = hit["primID"].astype(np.int64), hit["u"], hit["v"]
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
            np.ascontiguousarray(origin, np.float32),
            np.ascontiguousarray(ray, np.float32),
            far,
            query="OCCLUDED",
        )
        return hit == 0
