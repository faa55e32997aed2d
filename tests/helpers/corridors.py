"""Walks through corridors and a stairwell, as training sets of which no image is looked at."""

from collections import Counter

import numpy as np

from filtering.se3 import Poses
from vapor.training_data.training_set import TrainingSet

STEP_M = 0.1


def corridor(start_m: float, end_m: float, *, y_m: float = 0.0, z_m: float = 0.0, ahead: bool = True) -> Poses:
    """Steps of ten centimetres along x, looking ahead or back."""
    count = round(abs(end_m - start_m) / STEP_M)
    x = start_m + np.sign(end_m - start_m) * STEP_M * np.arange(count)
    towards = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])  # x right, y down, z along the corridor
    if not ahead:
        towards = np.diag([-1.0, -1.0, 1.0]) @ towards
    return Poses(np.tile(towards, (count, 1, 1)), np.column_stack([x, np.full(count, y_m), np.full(count, z_m)]))


def recorded(*passes: Poses) -> TrainingSet:
    """Recordings walk0, walk1, ... of which no image is looked at."""
    count = sum(len(poses) for poses in passes)
    return TrainingSet(
        np.zeros((count, 1, 1, 3), np.uint8),
        np.arange(count),
        Poses.concatenate(list(passes)),
        np.repeat(np.arange(len(passes)), [len(poses) for poses in passes]),
        tuple(f"walk{i}" for i in range(len(passes))),
        (1, 1),
        100_000_000 * np.arange(count),
        (None,) * count,
        Counter(),
    )


def stairwell(top: tuple[int, ...] = (0, 1, 2, 3, 4), walks: int = 5) -> TrainingSet:
    """Walks over three floors three metres apart, each beside the others; only some of them go on to a fourth."""
    found = []
    for walk in range(walks):
        floors = 4 if walk in top else 3
        found.append(Poses.concatenate([corridor(0, 10, y_m=0.1 * walk, z_m=3.0 * floor) for floor in range(floors)]))
    return recorded(*found)
