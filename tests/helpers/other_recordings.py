"""Copies of a recording as another recorder might have written it."""

import struct
from collections.abc import Callable, Collection
from pathlib import Path

import numpy as np

from filtering.se3 import Poses
from tests.helpers.sequence_files import rewrite

Form = Callable[[Path, Path], Path]


def close(a: Poses | None, b: Poses, tolerance: float = 1e-6) -> bool:
    return a is not None and bool(np.abs(a.as_matrix() - b.as_matrix()).max() < tolerance)


MS = 1_000_000


def relogged(walk: Path, target: Path, late_ns: Callable[[str, int], int]) -> Path:
    """A copy in which messages were logged late, by what a function of topic and stamp says."""
    return rewrite(walk, target, log_time=lambda topic, time_ns: time_ns + late_ns(topic, time_ns))


def stamped(walk: Path, target: Path, topics: Collection[str], stamp: Callable[[int], int]) -> Path:
    """A copy in which some topics have other stamps, logged when they were."""

    def change(topic: str, time_ns: int, data: bytes) -> bytes:
        if topic not in topics:
            return data
        return data[:4] + struct.pack("<II", *divmod(stamp(time_ns), 1_000_000_000)) + data[12:]

    return rewrite(walk, target, data=change)
