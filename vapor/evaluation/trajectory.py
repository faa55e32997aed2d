"""Errors of a trajectory against the truth, in the map's frame: no alignment anywhere."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import numpy as np
from jaxtyping import Bool, Float64, Int64

from filtering.errors import VaporTrackError
from filtering.se3 import Poses
from sequences.frame import Trajectory
from sequences.trajectories.interpolation import interpolate
from vapor.tracking.methods import METHODS, in_order

THRESHOLDS: Mapping[str, tuple[float, float]] = MappingProxyType(
    {"0.1m/10deg": (0.1, 10.0), "0.2m/15deg": (0.2, 15.0), "0.3m/20deg": (0.3, 20.0)}
)
"""Recall thresholds: metres and degrees, both to be met."""

POSITION_M: Mapping[str, float] = MappingProxyType({"1m": 1.0, "3m": 3.0, "5m": 5.0})
"""Thresholds of position recall, metres, as localization in maps of cities reports (Sarlin et al., "OrienterNet",
CVPR 2023), there in two dimensions, here in three."""

RIGHT = "0.3m/20deg"
"""The threshold within which a pose counts as right."""

TAIL_M: Mapping[str, float] = MappingProxyType({"0.1m": 0.1, "0.25m": 0.25, "0.5m": 0.5})
"""Translation errors in metres beyond which images are counted: medians do not show large ones."""

SURE = 0.95
"""Fraction of the remaining images that must be right once a method has converged."""


_MOST_GAP_S = 0.25  # between true poses that are interpolated


def is_right(poses: Poses, truth: Poses) -> Bool[np.ndarray, "*n"]:
    """Which poses are within 0.3 m and 20° of the truth."""
    limit_m, limit_deg = THRESHOLDS[RIGHT]
    translation_m, rotation_rad = poses.distance(truth)
    return (translation_m <= limit_m) & (np.degrees(rotation_rad) <= limit_deg)


def associate(times_ns: Int64[np.ndarray, " n"], truth: Trajectory) -> tuple[Bool[np.ndarray, " n"], Poses]:
    """True poses at stamps (n,): exact where a stamp is equal, else interpolated on SE(3) between its neighbours.

    Returns:
        Whether each stamp has a true pose, (n,), and these true poses (k,) in order.
    """
    poses, found = interpolate(truth.times_ns, truth.poses, times_ns, max_gap_s=_MOST_GAP_S)
    return found, poses[found]


def pose_errors(
    estimate: Trajectory, truth: Trajectory
) -> tuple[Int64[np.ndarray, " k"], Float64[np.ndarray, " k"], Float64[np.ndarray, " k"]]:
    """Stamps, translation errors in metres and rotation errors in degrees of the k poses whose truth is known.

    Raises:
        VaporTrackError: a pose is not finite, or no stamp of the estimate has a true pose.
    """
    for name, trajectory in (("estimated", estimate), ("true", truth)):
        if not trajectory.poses.is_finite().all():
            bad = int(np.argmin(trajectory.poses.is_finite()))
            raise VaporTrackError(f"{name} pose at {trajectory.times_ns[bad] / 1e9:.6f} s is not finite")
    if len(estimate) == 0 or len(truth) == 0:
        raise VaporTrackError(
            f"nothing to compare: {len(estimate)} estimated and {len(truth)} true poses, expected at least one of each"
        )
    found, true_poses = associate(estimate.times_ns, truth)
    if not found.any():
        raise VaporTrackError(
            f"no estimate has a true pose: estimates span {_span(estimate)}, true poses {_span(truth)},"
            " expected them to overlap"
        )
    translation_m, rotation_rad = estimate.poses[found].distance(true_poses)
    return estimate.times_ns[found], translation_m, np.degrees(rotation_rad)


def evaluate_trajectory(estimate: Trajectory, truth: Trajectory, *, tracking: bool) -> dict[str, Any]:
    """Errors of a trajectory (world_from_camera) against the truth, without alignment, of poses whose truth is known.

    Returns:
        `median_translation_m`, `median_rotation_deg`, `ape_rmse_m` (root mean square of the translation error) and
        `recall`: for each of `THRESHOLDS` the fraction of images within both limits; `position_recall`: for each of
        `POSITION_M` the fraction of images whose translation error is within it; `worse_than`: for each of `TAIL_M` the
        fraction of images with a larger one. With `tracking`, of a method that carries a belief from image to image,
        also `converged_at_s` (see `convergence_s`, null if never), `success` (whether it converged), and
        `after_convergence`: number of `images` from that moment on, and their `recall` (null if never).

    Raises:
        VaporTrackError: a pose is not finite, or no stamp of the estimate has a true pose.
    """
    times_ns, translation_m, rotation_deg = pose_errors(estimate, truth)
    right = {
        name: (translation_m <= limit_m) & (rotation_deg <= limit_deg)
        for name, (limit_m, limit_deg) in THRESHOLDS.items()
    }
    metrics: dict[str, Any] = {
        "median_translation_m": float(np.median(translation_m)),
        "median_rotation_deg": float(np.median(rotation_deg)),
        "ape_rmse_m": float(np.sqrt(np.mean(translation_m**2))),
        "recall": {name: float(np.mean(inside)) for name, inside in right.items()},
        "position_recall": {name: float(np.mean(translation_m <= limit_m)) for name, limit_m in POSITION_M.items()},
        "worse_than": {name: float(np.mean(translation_m > limit_m)) for name, limit_m in TAIL_M.items()},
    }
    if tracking:
        start_ns = int(estimate.times_ns[0])
        converged_at_s = convergence_s(times_ns, right[RIGHT], start_ns=start_ns)
        metrics |= {"converged_at_s": converged_at_s, "success": converged_at_s is not None, "after_convergence": None}
        if converged_at_s is not None:
            after = times_ns - start_ns >= round(converged_at_s * 1e9)
            recall = {name: float(np.mean(inside[after])) for name, inside in right.items()}
            metrics["after_convergence"] = {"images": int(after.sum()), "recall": recall}
    return metrics


def convergence_s(
    times_ns: Int64[np.ndarray, " n"], right: Bool[np.ndarray, " n"], *, start_ns: int | None = None
) -> float | None:
    """Seconds from the first image of a sequence to the moment from which on a method is right; None if never.

    It is the first image that is right, from which on, itself included, at least 95 % of the images are right, and that
    lies strictly before four fifths of the sequence's duration: a single lucky image at the end does not count. The
    stamp of the sequence's first image is that of the first given image, or `start_ns`.
    """
    elapsed_ns = times_ns - (int(times_ns[0]) if start_ns is None else start_ns)
    early = 5 * elapsed_ns < 4 * elapsed_ns[-1]
    candidates = np.flatnonzero(early & stays_right(right))
    return float(elapsed_ns[candidates[0]] / 1e9) if len(candidates) else None


def stays_right(right: Bool[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
    """The images that are right and from which on, themselves included, at least 95 % are."""
    remaining = np.arange(len(right), 0, -1)
    return right & (np.cumsum(right[::-1])[::-1] >= SURE * remaining)


def evaluate_methods(methods: Mapping[str, Trajectory], truth: Trajectory) -> dict[str, dict[str, Any]]:
    """`evaluate_trajectory` of every method, by name, in the order of `METHODS`."""
    return {
        name: evaluate_trajectory(trajectory, truth, tracking=METHODS[name].can_converge)
        for name, trajectory in in_order(methods).items()
    }


def _span(trajectory: Trajectory) -> str:
    first_s, last_s = trajectory.times_ns[[0, -1]] / 1e9
    return f"{first_s:.3f} s to {last_s:.3f} s"
