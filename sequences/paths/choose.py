"""Which of many random paths a sequence takes, by what is unique on its way."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np
from jaxtyping import Bool

from filtering.se3 import Poses

Cues = Literal["early", "any", "none"]
"""How much of what is unique in a scene a path passes: see `choose_path`."""

Look = Callable[[Poses, int, bool], Bool[np.ndarray, " n"]]
"""Whether each of the first so many images of a path shows something unique; closely, however small."""

_PATHS_TRIED = 100  # one in three will do at 300 images; where none can, as in a very tall image, any must do
_LOOKED_AT = 300  # images
_DETOUR = 4  # a path without anything unique is a segment of one this many times as long


def choose_path(
    cues: Cues, num_images: int, *, poses_per_image: int, draw: Callable[[int], Poses], look: Look
) -> Poses | None:
    """A path of the body that passes as much as asked for.

    Args:
        cues: "early": where there are 100 images or more, something unique shows in their first half, but seldom, so
            that a filter can know where it is; where 100 random paths are not like that, the last of them. "any": the
            first random path. "none": one that never shows anything unique, however small.
        num_images: On the path.
        poses_per_image: Poses of the body from one image to the next.
        draw: A random path for so many images.
        look: What is seen on it.

    Returns:
        Poses of the body, as `draw` gives them; None if 100 random paths had nothing of the kind, with "none" only.
    """
    if cues == "none":
        return _uneventful(num_images, poses_per_image, draw, look)
    base = draw(num_images)
    for _ in range(_PATHS_TRIED - 1):
        if cues == "any" or resolvable(look(base, min(num_images, _LOOKED_AT), False)):
            break
        base = draw(num_images)
    return base


def resolvable(seen: Bool[np.ndarray, " n"]) -> bool:
    """Something unique shows for half a second in the first half, but seldom overall; short paths all pass."""
    return len(seen) < 100 or bool(seen[: len(seen) // 2].sum() >= 5 and seen.mean() < 0.25)


def _uneventful(num_images: int, poses_per_image: int, draw: Callable[[int], Poses], look: Look) -> Poses | None:
    """The first uneventful segment of random paths that are four times as long.

    One such path in twelve through the hall has a segment of 300 images; of paths just that long, one in 350 is one.
    """
    surplus = (_DETOUR - 1) * num_images
    for _ in range(_PATHS_TRIED):
        base = draw(num_images + surplus)
        seen_before = np.concatenate([[0], np.cumsum(look(base, num_images + surplus, True))])
        starts = np.flatnonzero(seen_before[num_images:] == seen_before[:-num_images])
        if len(starts):
            first = poses_per_image * int(starts[0])
            return base[first : first + len(base) - poses_per_image * surplus]
    return None
