"""What is read of a small data set of known poses."""

from pathlib import Path

import numpy as np

from sequences.datasets.frames import posed_frames
from tests.helpers.data_sets import (
    same,
    true_pose,
)

THIRTIETH_NS = 1_000_000_000 / 30


def check(path: Path, indices: list[int], times_ns: list[float] | None = None) -> None:
    """What is seen in the frames, their poses and their stamps."""
    frames = list(posed_frames(path))
    assert [int(frame.image[0, 0, 0]) // 10 for frame in frames] == indices
    for index, frame in zip(indices, frames, strict=True):
        assert same(frame.world_from_camera, true_pose(index), 1e-6)
    if times_ns is not None:
        np.testing.assert_allclose([frame.time_ns for frame in frames], times_ns, atol=1)
