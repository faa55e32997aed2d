"""Ground that training images show: the distance that is near, poses beyond it, and passes of the camera."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Bool, Float64, Int64
from scipy.spatial import KDTree

from filtering.errors import listed
from filtering.se3 import Poses
from sequences.odometry_fit.pieces import OdometrySegment
from vapor.checkpoints.scene_scale import typical_side_m
from vapor.training_data.training_set import TrainingSet

DIRECTION_RAD = float(np.deg2rad(45.0))
FARTHEST = 0.15
"""Greatest distance that counts as near, in typical sides of the scene."""
_CHORD = 2.0 * np.sin(DIRECTION_RAD / 2.0)
_NEAREST = 1 / 3  # least distance that counts as near, in greatest ones
_GIVEN = 2.0  # factor of the distance for data that are stated to be of the place
_USUAL = 4.0  # distance that counts as near, in lower quartiles of the distance to the nearest image of another pass
_LOOKED_AT = 8  # nearest images that are compared
_NAMED_RUNS = 3
_LEAST_UNSHOWN = 0.05  # least fraction of unshown images of a run for a notice
_VERIFIED = 0.9  # of these images, in which landmarks verify a place: from there on the ground is known all the same
RUN_IMAGES = 10
_BREAK_S, _BREAK_STEPS = 1.0, 3.0


def describe_unshown(poses: Poses, training: Poses, *, verified: Bool[np.ndarray, " n"] | None = None) -> str | None:
    """A notice on a run over ground that training images do not show; None where there is hardly any.

    Args:
        poses: Estimated, (n,).
        training: Of the training images, (m,).
        verified: In which images of the run landmarks verified a place, (n,); None without landmarks. Where they did
            in nearly all images over such ground, it is known well enough.
    """
    shown, near_m = shown_around(poses, training)
    if (fraction := float((~shown).mean())) < _LEAST_UNSHOWN:
        return None
    if verified is not None and float(verified[~shown].mean()) >= _VERIFIED:
        return None
    images = describe_runs(list(runs(~shown, np.zeros(len(shown), np.int64))), np.arange(len(shown)))
    return (
        f"{fraction:.0%} of the images were taken, by the smoothed trajectory, where no training image is within"
        f" {near_m:.2g} m and 45°: images {images}; expect larger errors there,"
        " and train with a recording of that ground"
    )


def shown_around(poses: Poses, training: Poses) -> tuple[Bool[np.ndarray, " n"], float]:
    """Whether training images (m,) show the surroundings of poses (n,), and the distance that is near, metres."""
    farthest_m = _GIVEN * FARTHEST * typical_side_m(training)
    distances_m = nearest_m(poses, training, farthest_m)
    near_m = near_m_of(distances_m, farthest_m)
    return distances_m <= near_m, near_m


def near_scale_m(poses: Poses) -> float:
    """Least distance that counts as near, metres, in the scene that poses (n,) outline."""
    return _NEAREST * FARTHEST * typical_side_m(poses)


def near_m_of(distances_m: Float64[np.ndarray, " n"], farthest_m: float) -> float:
    """Distance that counts as near, from the distances of the nearest images of other passes; at most `farthest_m`."""
    found = distances_m[distances_m <= farthest_m]
    usual = float(np.quantile(found, 0.25)) if len(found) else np.inf
    return float(np.clip(_USUAL * usual, _NEAREST * farthest_m, farthest_m))


def nearest_m(poses: Poses, others: Poses, scale_m: float) -> Float64[np.ndarray, " n"]:
    """Distance, metres, from each pose (n,) to the nearest of the others (m,) in the same direction, or infinity.

    A distance of `scale_m` counts as much as 45°.
    """
    if not len(poses) or not len(others):
        return np.full(len(poses), np.inf)
    places, own = (np.hstack([each.translation / scale_m, each.rotation[:, :, 2] / _CHORD]) for each in (others, poses))
    apart = KDTree(places).query(own, k=min(_LOOKED_AT, len(others)))[1].reshape(len(own), -1)
    difference = places[apart] - own[:, None]
    distance = scale_m * np.linalg.norm(difference[..., :3], axis=-1)
    return np.where(np.linalg.norm(difference[..., 3:], axis=-1) <= 1.0, distance, np.inf).min(axis=1)


def runs(mask: Bool[np.ndarray, " n"], sequence: Int64[np.ndarray, " n"]) -> Iterator[slice]:
    """Consecutive images of one recording that are in the mask."""
    rows = np.flatnonzero(mask)
    if len(rows):
        breaks = np.flatnonzero((np.diff(rows) > 1) | (np.diff(sequence[rows]) != 0)) + 1
        for run in np.split(rows, breaks):
            yield slice(int(run[0]), int(run[-1]) + 1)


def describe_runs(found: Sequence[slice], numbers: Int64[np.ndarray, " n"]) -> str:
    """The first and last image of each run, or its only one, by the numbers of all images, (n,)."""
    ends = ((numbers[run.start], numbers[run.stop - 1]) for run in found)
    ranges = (f"{begin} to {end}" if end > begin else f"{begin}" for begin, end in ends)
    return listed(ranges, _NAMED_RUNS, others="more ranges")


def pass_numbers(images: TrainingSet) -> Int64[np.ndarray, " n"]:
    """The number of the pass of each image, increasing.

    A pass begins with every sequence, and after a gap of more than a second and three usual intervals.
    """
    steps_s = np.diff(images.times_ns, prepend=images.times_ns[:1]) * 1e-9
    begins = np.diff(images.sequence, prepend=images.sequence[:1] - 1) != 0
    for number in np.unique(images.sequence):
        own = (images.sequence == number) & ~begins
        usual = float(np.median(steps_s[own])) if own.any() else 0.0
        begins |= own & ((steps_s > max(_BREAK_S, _BREAK_STEPS * usual)) | (steps_s < 0.0))
    return np.cumsum(begins) - 1


def some_runs(count: int, limit: int) -> Int64[np.ndarray, " k"]:
    """Indices of at most `limit` of `count` images, in evenly spaced runs of ten.

    Consecutive images show the correlation of errors, and images from all over the scene their size.
    """
    if count <= limit:
        return np.arange(count)
    runs = max(1, limit // RUN_IMAGES)
    starts = np.linspace(0, count - min(RUN_IMAGES, limit), runs).round().astype(np.int64)
    return np.unique(starts[:, None] + np.arange(min(RUN_IMAGES, limit)))


def odometry_segments(images: TrainingSet) -> list[OdometrySegment]:
    """Consecutive images with odometry from each to the next, and their true poses; of a walk, those of one camera."""
    segments: list[OdometrySegment] = []
    walk = images.walk
    first = {int(walk[i]): int(images.sequence[i]) for i in reversed(range(len(walk)))}
    begins = [i for i, step in enumerate(images.odometry) if step is None]
    for begin, end in zip(begins, [*begins[1:], len(images)][: len(begins)], strict=True):
        steps = [step for step in images.odometry[begin + 1 : end] if step is not None]
        if steps and first[int(walk[begin])] == images.sequence[begin]:
            truth = images.poses[np.arange(begin, end)]
            segments.append(OdometrySegment(steps, truth, int(images.sequence[begin])))
    return segments
