"""A synthetic scene: its parts, the path through it, the mount of the camera, and the odometry."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cache, lru_cache

import numpy as np

from filtering.se3 import Poses
from sequences.odometry import OdometryNoise
from sequences.rendering.light import USUAL, Sampling
from sequences.rendering.mesh import Placement
from sequences.rendering.render import LitScene

SPLITS = {"train": 1, "test": 2}
"""The number of each split, in seeds."""


@dataclass(frozen=True, eq=False)
class Scene:
    """A synthetic scene, and how sequences are recorded in it.

    Its parts depend on the split and seed of a walk where it `changes`. The path is poses of the body every 20 ms, by
    duration in seconds, split, seed and generator. The field of view is horizontal; rate and noise are defaults.

    Attributes:
        seed_numbers: Distinguish the random numbers of its walks from those of other scenes. Never changed: path,
            odometry and sensor noise of every seed follow from them.
        has_cues: Whether anything in it is unique, so that a camera can find its place.
        storey_height_m: From floor to floor along z where all floors look alike from end to end; None elsewhere.
        paint_seed: Of stains, grain and light samples.
    """

    name: str
    seed_numbers: tuple[int, ...]
    placements: Callable[[str, int], Sequence[Placement]]
    path: Callable[[float, str, int, np.random.Generator], Poses]
    field_of_view_deg: float
    base_from_camera: Poses
    has_cues: bool
    rate_hz: float = 10.0
    noise: OdometryNoise = field(default_factory=OdometryNoise)
    storey_height_m: float | None = None
    changes: bool = False
    paint_seed: int = 0
    sampling: Sampling = USUAL

    def build(self, split: str, seed: int) -> LitScene:
        """The scene on one walk, ready to be rendered; built once per process where it never changes."""
        return _on_one_walk(self, split, seed) if self.changes else _on_all_walks(self)


@cache
def _on_all_walks(scene: Scene) -> LitScene:
    return LitScene(scene.placements("test", 0), seed=scene.paint_seed, sampling=scene.sampling)


@lru_cache(maxsize=2)  # a large building takes some hundreds of megabytes
def _on_one_walk(scene: Scene, split: str, seed: int) -> LitScene:
    return LitScene(scene.placements(split, seed), seed=scene.paint_seed, sampling=scene.sampling)


def mounted(at_m: tuple[float, float, float], toward: float, down: float) -> Poses:
    """base_from_camera of a camera at a point of the body that looks so many radians left of forward, and down."""
    cos, sin = np.cos(toward), np.sin(toward)
    forward = np.array([np.cos(down) * cos, np.cos(down) * sin, -np.sin(down)])
    right = np.array([sin, -cos, 0])
    return Poses(np.stack([right, np.cross(forward, right), forward], axis=1), np.array(at_m))


def mounted_upward(at_m: tuple[float, float, float]) -> Poses:
    """base_from_camera of a camera at a point of the body that looks straight up, with the image's top forward."""
    right, up = np.array([0, -1.0, 0]), np.array([0, 0, 1.0])
    return Poses(np.stack([right, np.cross(up, right), up], axis=1), np.array(at_m))


HELMET = mounted((0.06, 0.03, 0.05), 0.0, np.radians(10))
"""base_from_camera on a person's helmet, whose body's origin is at eye height: forward, and 10° down."""
