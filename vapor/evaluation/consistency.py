"""Consistency of reported confidence with errors against the truth."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np
from jaxtyping import Bool, Float64, Int64

from filtering.estimate import STATUSES, Mode, squared_radius
from filtering.se3 import Poses
from sequences.frame import Trajectory
from vapor.evaluation.reliability import Reliability
from vapor.evaluation.storeys import once_on_storey
from vapor.evaluation.trajectory import associate, is_right, stays_right
from vapor.tracking.loop import Belief

REGIONS: Mapping[str, float] = MappingProxyType({"50%": 0.5, "90%": 0.9, "95%": 0.95})
"""Regions of a mode, by the probability that they hold."""

JUMP_M = 1.0
"""A false recovery takes the best mode at least this far from the truth."""

_LEAST_VARIANCE = 1e-12  # of a mode whose particles coincide: a micrometre, a microradian


def evaluate_consistency(
    estimate: Trajectory,
    covariance: Float64[np.ndarray, "n 6 6"],
    degrees_of_freedom: Float64[np.ndarray, " n"],
    converged: Bool[np.ndarray, " n"],
    truth: Trajectory,
) -> dict[str, Any]:
    """Whether a filter is as good as it reports, over the images with status "converged".

    Best modes (n,) are world_from_camera, with covariances in the tangent at the mode, ξ = (v, ω), and degrees of
    freedom (`Mode.degrees_of_freedom`).

    Returns:
        `images`: number with that status and a true pose. `wrong`: the fraction of them that are not right (`RIGHT`).
        `coverage`: for each of the 50, 90 and 95 % regions of the best mode (`Mode.squared_radius`) the fraction of
        them with the true pose inside. `median_nees`: median normalised estimation error squared, ξᵀ Σ⁻¹ ξ, 5.35 for a
        true covariance (Bar-Shalom et al. 2001, §5.4). All but `images` are None where that is 0.
    """
    found, true_poses = associate(estimate.times_ns, truth)
    sure = converged[found]
    images = int(sure.sum())
    if images == 0:
        return {"images": 0, "wrong": None, "coverage": None, "median_nees": None}
    best, true_poses = estimate.poses[found][sure], true_poses[sure]
    error = (best.inverse() @ true_poses).log()
    regular = covariance[found][sure] + _LEAST_VARIANCE * np.eye(6)
    nees = np.einsum("ni,ni->n", error, np.linalg.solve(regular, error[..., None])[..., 0])
    nu = degrees_of_freedom[found][sure]
    return {
        "images": images,
        "wrong": float(np.mean(~is_right(best, true_poses))),
        "coverage": {
            name: float(np.mean(nees <= squared_radius(probability, nu))) for name, probability in REGIONS.items()
        },
        "median_nees": float(np.median(nees)),
    }


def evaluate_belief(
    belief: Belief,
    times_ns: Int64[np.ndarray, " n"],
    truth: Poses,
    *,
    converged_at_s: float | None,
    kidnap_index: int | None,
    storey_height_m: float | None = None,
) -> dict[str, Any]:
    """All figures on the confidence of a method.

    Args:
        belief: After each of n images.
        times_ns: Stamps (n,).
        truth: True poses, batch (n,).
        converged_at_s: Of `evaluate_trajectory`.
        kidnap_index: First image after the camera was carried off; None where it was not.
        storey_height_m: From storey to storey, where storeys look alike.

    Returns:
        `status`: fraction of the images by status. `converged_images`, `after_convergence`, `all_images`:
        `evaluate_consistency` over the images of that status, those from `converged_at_s` on, and all.
        `truth_among_modes`: fraction of the images with a mode within 0.3 m and 20° of the truth. `longest_wrong_s`:
        longest time with status "converged" and wrong in all images. `false_recoveries`: their number, see
        `count_false_recoveries`. `kidnap`: None, or whether the last image before was `right_before`, and `images` as
        `recovery_images`. `reliability`: of the best mode's weight, see `Reliability.as_json`. `on_storey`, with
        `storey_height_m`: `evaluate_consistency` over the images from when on its storey is right.
    """
    best = belief.best
    trajectory, true_trajectory = Trajectory(times_ns, best), Trajectory(times_ns, truth)
    covariance = np.stack([modes[0].covariance for modes in belief.modes])
    nu = np.array([modes[0].degrees_of_freedom for modes in belief.modes])
    counts = Counter(belief.status)
    sure = np.array([status == "converged" for status in belief.status])
    elapsed_s = (times_ns - times_ns[0]) / 1e9
    after = np.zeros(len(sure), bool) if converged_at_s is None else elapsed_s >= converged_at_s - 1e-9
    right, error_m = is_right(best, truth), best.distance(truth)[0]
    over = {"converged_images": sure, "after_convergence": after, "all_images": np.ones(len(sure), bool)}
    if storey_height_m is not None:
        over["on_storey"] = once_on_storey(best, truth, storey_height_m)
    kidnap = None
    if kidnap_index is not None:
        images = recovery_images(right, kidnap_index=kidnap_index)
        kidnap = {"right_before": bool(right[kidnap_index - 1]), "images": images}
    return {
        "status": {name: counts[name] / len(sure) for name in STATUSES},
        **{name: evaluate_consistency(trajectory, covariance, nu, of, true_trajectory) for name, of in over.items()},
        "truth_among_modes": truth_among_modes(belief.modes, truth),
        "reliability": Reliability.of(np.array([modes[0].weight for modes in belief.modes]), right).as_json(),
        "longest_wrong_s": longest_s(sure & ~right, times_ns),
        "false_recoveries": count_false_recoveries(right, error_m, kidnap_index=kidnap_index),
        "kidnap": kidnap,
    }


def truth_among_modes(modes: Sequence[tuple[Mode, ...]], truth: Poses) -> float:
    """Fraction of the images with any mode, however light, within 0.3 m and 20° of the true pose."""
    found = [
        is_right(Poses.stack([mode.world_from_camera for mode in of_image]), truth[[i] * len(of_image)]).any()
        for i, of_image in enumerate(modes)
    ]
    return float(np.mean(found))


def longest_s(flags: Bool[np.ndarray, " n"], times_ns: Int64[np.ndarray, " n"]) -> float:
    """The longest time over which all images (n,) have a flag, seconds: each lasts until the next, the last no time."""
    longest_ns, since = 0, None
    for flag, time_ns in zip(flags, times_ns, strict=True):
        if since is not None:
            longest_ns = max(longest_ns, int(time_ns - since))
        since = None if not flag else time_ns if since is None else since
    return longest_ns / 1e9


def count_false_recoveries(
    right: Bool[np.ndarray, " n"], error_m: Float64[np.ndarray, " n"], *, kidnap_index: int | None = None
) -> int:
    """How often the pose was right at an image and more than 1 m off at the next, but for the first after a kidnap."""
    leaps = right[:-1] & (error_m[1:] > JUMP_M)
    if kidnap_index is not None:
        leaps[kidnap_index - 1] = False
    return int(leaps.sum())


def recovery_images(right: Bool[np.ndarray, " n"], *, kidnap_index: int) -> int | None:
    """Number of images at the new place until a method is right, with at least 95 % of the images from then on.

    1 stands for the first image there, `kidnap_index`; None if there is no such image.
    """
    candidates = np.flatnonzero(stays_right(right[kidnap_index:]))
    return int(candidates[0]) + 1 if len(candidates) else None
