"""Passes of the camera through a scene: which images are consecutive, and the odometry between them."""

from __future__ import annotations

import numpy as np
from jaxtyping import Int64

from sequences.odometry_fit.pieces import OdometrySegment
from vapor.training_data.training_set import TrainingSet

RUN_IMAGES = 10
_BREAK_S, _BREAK_STEPS = 1.0, 3.0


def pass_numbers(images: TrainingSet) -> Int64[np.ndarray, " n"]:
    """The number of the pass that each image is from, increasing.

    A new one begins with every sequence, and after a gap of more than a second and three times what is usual.
    """
    steps_s = np.diff(images.times_ns, prepend=images.times_ns[:1]) * 1e-9
    begins = np.diff(images.sequence, prepend=images.sequence[:1] - 1) != 0
    for number in np.unique(images.sequence):
        own = (images.sequence == number) & ~begins
        usual = float(np.median(steps_s[own])) if own.any() else 0.0
        begins |= own & ((steps_s > max(_BREAK_S, _BREAK_STEPS * usual)) | (steps_s < 0.0))
    return np.cumsum(begins) - 1


def some_runs(count: int, limit: int) -> Int64[np.ndarray, " k"]:
    """Indices of at most `limit` of `count` images, in runs of ten evenly spaced ones.

    Consecutive images show how long errors last, and images from all over the scene how large they are.
    """
    if count <= limit:
        return np.arange(count)
    runs = max(1, limit // RUN_IMAGES)
    starts = np.linspace(0, count - min(RUN_IMAGES, limit), runs).round().astype(np.int64)
    return np.unique(starts[:, None] + np.arange(min(RUN_IMAGES, limit)))


def odometry_segments(images: TrainingSet) -> list[OdometrySegment]:
    """Consecutive images with odometry from each to the next, and their true poses."""
    segments: list[OdometrySegment] = []
    begins = [i for i, step in enumerate(images.odometry) if step is None]
    for begin, end in zip(begins, [*begins[1:], len(images)][: len(begins)], strict=True):
        steps = [step for step in images.odometry[begin + 1 : end] if step is not None]
        if steps:
            truth = images.poses[np.arange(begin, end)]
            segments.append(OdometrySegment(steps, truth, int(images.sequence[begin])))
    return segments
