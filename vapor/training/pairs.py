"""Pairs of images near each other, whose relative poses are learned."""

from __future__ import annotations

import numpy as np
from jaxtyping import Int64


def paired(
    indices: Int64[np.ndarray, " b"], sequence: Int64[np.ndarray, " n"], gap: int, *, rng: np.random.Generator
) -> Int64[np.ndarray, " b"]:
    """The first half of a batch, then for each of it another image of its sequence, at most `gap` images away."""
    first = indices[: len(indices) // 2]
    there = first + rng.choice([-1, 1], len(first)) * rng.integers(1, gap, len(first), endpoint=True)
    outside = (there < 0) | (there >= len(sequence))
    outside |= sequence[np.clip(there, 0, len(sequence) - 1)] != sequence[first]
    there = np.where(outside, 2 * first - there, there)  # on the other side, where there is none on this
    missing = (
        (there < 0) | (there >= len(sequence)) | (sequence[np.clip(there, 0, len(sequence) - 1)] != sequence[first])
    )
    return np.concatenate([first, np.where(missing, first, there)])
