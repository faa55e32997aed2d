"""Walks and matches as the mapping has them, without images."""

from typing import Any

import numpy as np

from filtering.se3 import Poses
from sequences.mapping.colmap import Match, Reconstructed
from sequences.mapping.walks import Picture, Walk

STEP_NS = 250_000_000


def straight(count: int) -> Poses:
    """A walk of 0.25 m an image along x, in a gentle curve."""
    at = 0.25 * np.arange(count)
    return Poses(np.tile(np.eye(3), (count, 1, 1)), np.stack([at, 0.02 * at**2, 0 * at], axis=1))


def walk_of(
    name: str, count: int, *, motion: Any = "nothing", recorded: Poses | None = None, has_stamps: bool = True
) -> Walk:
    """A walk of four images a second; recorded are true poses or those by odometry."""
    pictures = [
        Picture(
            f"{name}/{number}.jpg",
            number * STEP_NS,
            number,
            (320, 240),
            None,
            1.0,
            recorded[number] if recorded is not None and motion == "poses" else None,
            recorded[number] if recorded is not None and motion == "odometry" else Poses.identity(),
            0,
        )
        for number in range(count)
    ]
    return Walk(name, tuple(pictures), has_stamps, 0, (count - 1) * STEP_NS, motion)


def placed_at(walk: Walk, poses: Poses, unit_m: float = 1.0) -> dict[str, Poses]:
    """The poses of its images in a model of such a unit."""
    positions = poses.translation / unit_m
    return {p.name: Poses(poses.rotation[i], positions[i]) for i, p in enumerate(walk.pictures)}


def match(first: int, second: int, *, shift: float = 0.1, turned: bool = False) -> Match:
    return Match(first, second, 50, shift, turned)


def unplaced(*matches: Match, features: int = 500, images: int = 20) -> Reconstructed:
    return Reconstructed(None, [], np.full(images, features), matches)
