"""Storeys of a building: which one poses are on, and errors of poses but for it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Bool, Float64, Int64

from filtering.se3 import Poses
from filtering.storeys import Storeys
from sequences.frame import Trajectory
from vapor.evaluation.trajectory import associate, is_right

SURE_OF_STOREY = 0.95
"""Fraction of the belief on one storey from which on the filter is sure of it."""


def storey_accuracy(poses: Poses, truth: Poses, storeys: Storeys) -> float:
    """Fraction of the poses (n,), n ≥ 1, that are on the storey of the true one."""
    return float(np.mean(storeys.of(poses) == storeys.of(truth)))


def evaluate_storeys(
    storeys: Storeys, belief: Float64[np.ndarray, "n f"], methods: Mapping[str, Trajectory], truth: Trajectory | None
) -> dict[str, Any]:
    """Storeys that the filter believed in after each of n images (`Storeys.belief`), and each method's storey accuracy.

    Returns:
        `heights_m` of the storeys; `belief`: fraction of the belief on each after the last image; `sure`: fraction of
        the images after which 95 % and more of it is on one storey. With true poses, over the images that have one:
        `sure_and_wrong`: fraction of the sure ones whose storey is another, None if there are none; `true_storey`: mean
        fraction of the belief that is on the true storey; `accuracy`: see `storey_accuracy`, by method.
    """
    sure = belief.max(axis=1) >= SURE_OF_STOREY
    figures: dict[str, Any] = {
        "heights_m": list(storeys.heights_m),
        "belief": np.round(belief[-1], 6).tolist(),
        "sure": float(np.mean(sure)),
    }
    if truth is None:
        return figures
    found, true_poses = associate(methods["filter"].times_ns, truth)
    if not found.any():
        return figures
    of_truth, sure, belief = storeys.of(true_poses), sure[found], belief[found]
    wrong = belief.argmax(axis=1) != of_truth
    return figures | {
        "sure_and_wrong": float(np.mean(wrong[sure])) if sure.any() else None,
        "true_storey": float(np.mean(belief[np.arange(len(belief)), of_truth])),
        "accuracy": {
            name: storey_accuracy(each.poses[found], true_poses, storeys)
            for name, each in methods.items()
            if len(each) == len(found)
        },
    }


def storeys_off(poses: Poses, truth: Poses, storey_height_m: float) -> Int64[np.ndarray, " n"]:
    """By how many storeys poses (n,) are too high, to the nearest storey."""
    return np.round((poses.translation[:, 2] - truth.translation[:, 2]) / storey_height_m).astype(np.int64)


def once_on_storey(poses: Poses, truth: Poses, storey_height_m: float) -> Bool[np.ndarray, " n"]:
    """The images from the first on which, and on all later ones of which, the storey is right, (n,)."""
    is_right_storey = storeys_off(poses, truth, storey_height_m) == 0
    return np.logical_and.accumulate(is_right_storey[::-1])[::-1]


def evaluate_storey(poses: Poses, truth: Poses, storey_height_m: float) -> dict[str, Any]:
    """Fractions of poses (n,) that are right but for their storey (`but_for_it`), and once their storey is right.

    `settled_images` are those from the first on which, and on all later ones of which, the storey is right;
    `settled_right` is the fraction of them that is right, None if there are none.
    """
    right, settled = is_right(poses, truth), once_on_storey(poses, truth, storey_height_m)
    up = np.zeros_like(poses.translation)
    up[:, 2] = storey_height_m * storeys_off(poses, truth, storey_height_m)
    on_true_storey = Poses(poses.rotation, poses.translation - up)
    return {
        "but_for_it": float(np.mean(is_right(on_true_storey, truth))),
        "settled_images": int(settled.sum()),
        "settled_right": float(np.mean(right[settled])) if settled.any() else None,
    }
