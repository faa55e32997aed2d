"""How good a trajectory is against the truth, in the map's frame: no alignment anywhere."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from jaxtyping import Bool, Float64, Int64
from scipy.special import chdtri

from filtering.errors import VaporTrackError
from filtering.motion import Odometry
from filtering.se3 import Poses
from sequences.frame import Trajectory
from sequences.outputs.manifest import MANIFEST, verify
from sequences.trajectories.tum import read_tum

THRESHOLDS: Mapping[str, tuple[float, float]] = MappingProxyType(
    {"0.1m/10deg": (0.1, 10.0), "0.2m/15deg": (0.2, 15.0), "0.3m/20deg": (0.3, 20.0)}
)
"""Recall thresholds: metres and degrees, both to be met."""

RIGHT = "0.3m/20deg"
"""The threshold within which a pose counts as right when convergence is judged."""

TAIL_M: Mapping[str, float] = MappingProxyType({"0.1m": 0.1, "0.25m": 0.25, "0.5m": 0.5})
"""Translation errors in metres beyond which images are counted: medians say nothing of the tail."""

FILES: Mapping[str, str] = MappingProxyType(
    {
        "single_image": "single_image.tum",
        "dead_reckoning": "dead_reckoning.tum",
        "kalman": "kalman.tum",
        "gaussian_sum": "gaussian_sum.tum",
        "filter": "trajectory.tum",
        "smoothed": "smoothed.tum",
    }
)
"""The methods of a report, in its order, and the file of a run's directory that holds each one's trajectory."""

TRACKING = ("kalman", "gaussian_sum", "filter", "smoothed")
"""Methods that can converge: they remember, and they can find themselves."""

REGIONS: Mapping[str, float] = MappingProxyType({"50%": 0.5, "90%": 0.9, "95%": 0.95})
"""Regions of a mode's Gaussian, by the share of it that they hold."""

SURE = 0.95
"""Share of the remaining images that must be right once a method has found itself."""

_TRUTH = "ground_truth.tum"
_LEAST_VARIANCE = 1e-12  # of a mode whose particles coincide: a micrometre, a microradian


def is_right(poses: Poses, truth: Poses) -> Bool[np.ndarray, "*n"]:
    """Which poses are within 0.3 m and 20° of the truth."""
    limit_m, limit_deg = THRESHOLDS[RIGHT]
    translation_m, rotation_rad = poses.distance(truth)
    return (translation_m <= limit_m) & (np.degrees(rotation_rad) <= limit_deg)


def associate(
    times_ns: Int64[np.ndarray, " n"], truth: Trajectory, *, max_gap_s: float = 0.25
) -> tuple[Bool[np.ndarray, " n"], Poses]:
    """True poses at given stamps: exact where a stamp is equal, else interpolated on SE(3) between its neighbours.

    Args:
        times_ns: Stamps (n,), integer nanoseconds.
        truth: True poses, at least one.
        max_gap_s: Longest gap between neighbours, in seconds, that is interpolated over.

    Returns:
        Which stamps (n,) have a true pose, and the true poses (k,) of those, in order.
    """
    known_ns = truth.times_ns
    after = np.searchsorted(known_ns, times_ns, side="left")
    right = np.minimum(after, len(known_ns) - 1)
    left = np.maximum(after - 1, 0)
    exact = known_ns[right] == times_ns
    between = (after > 0) & (after < len(known_ns)) & (known_ns[right] - known_ns[left] <= round(max_gap_s * 1e9))
    found = exact | between
    left, right = np.where(exact, right, left)[found], right[found]
    span = np.maximum(known_ns[right] - known_ns[left], 1)
    fraction = (times_ns[found] - known_ns[left]) / span
    return found, truth.poses[left].interpolate(truth.poses[right], fraction)


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
    """Errors of a trajectory against the truth, without any alignment.

    Args:
        estimate: Estimated world_from_camera; poses whose truth is unknown are left out (see `associate`).
        truth: True world_from_camera.
        tracking: Whether the method carries a belief from image to image, and so can converge.

    Returns:
        `median_translation_m`, `median_rotation_deg`, `ape_rmse_m` (root mean square of the translation error) and
        `recall`: for each of `THRESHOLDS` the share of images within both limits; `worse_than`: for each of `TAIL_M`
        the share of images with a larger translation error. With `tracking` also `converged_at_s` (see
        `convergence_s`, null if never), `success`: whether that moment lies before four fifths of the sequence, and
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
    """The moment from when on a method is right.

    It is the first image that is right itself, from which on, itself included, at least 95 % of the images are
    right, and that lies strictly before four fifths of the sequence's duration: the last fifth must remain to
    prove it, or a single lucky image at the end would count.

    Args:
        times_ns: Stamps (n,).
        right: Whether each image's pose is right, (n,).
        start_ns: Stamp of the sequence's first image, from which seconds count; the first of `times_ns` if None.

    Returns:
        Seconds since the first image; None if there is no such moment.
    """
    start_ns = int(times_ns[0]) if start_ns is None else start_ns
    remaining = np.arange(len(right), 0, -1)
    right_from_here = np.cumsum(right[::-1])[::-1]
    elapsed_ns = times_ns - start_ns
    early = 5 * elapsed_ns < 4 * elapsed_ns[-1]
    candidates = np.flatnonzero(right & early & (right_from_here >= SURE * remaining))
    return float(elapsed_ns[candidates[0]] / 1e9) if len(candidates) else None


def evaluate_consistency(
    estimate: Trajectory,
    covariance: Float64[np.ndarray, "n 6 6"],
    converged: Bool[np.ndarray, " n"],
    truth: Trajectory,
) -> dict[str, Any]:
    """Whether a filter is as good as it says, over the images of which it says that it has converged.

    Args:
        estimate: Best modes, world_from_camera, (n,).
        covariance: Their covariances in the tangent at the mode, ξ = (v, ω).
        converged: Whether the status was "converged", (n,).
        truth: True world_from_camera.

    Returns:
        `images`: how many said so and have a true pose. `wrong`: the share of them that are not right (`RIGHT`).
        `coverage`: for each of the 50, 90 and 95 % regions of the best mode's Gaussian the share of them with the true
        pose inside.
        `median_nees`: median normalised estimation error squared, ξᵀ Σ⁻¹ ξ, 5.35 for a true covariance (Bar-Shalom
        et al. 2001, §5.4). All but `images` are None where that is 0.
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
    return {
        "images": images,
        "wrong": float(np.mean(~is_right(best, true_poses))),
        "coverage": {name: float(np.mean(nees <= chdtri(6, 1 - share))) for name, share in REGIONS.items()},
        "median_nees": float(np.median(nees)),
    }


def dead_reckoning(first_pose: Poses, odometry: Sequence[Odometry | None]) -> Poses:
    """Poses from odometry alone.

    Args:
        first_pose: world_from_camera of the first image, one pose.
        odometry: Per image the motion since the previous one, (n,), n ≥ 1. The first is not used; where a later one
            is None the motion is unknown and the pose stays.

    Returns:
        world_from_camera, batch (n,).
    """
    poses = [first_pose]
    for motion in odometry[1:]:
        poses.append(poses[-1] if motion is None else poses[-1] @ motion.previous_from_current)
    return Poses.stack(poses)


def evaluate_methods(methods: Mapping[str, Trajectory], truth: Trajectory) -> dict[str, dict[str, Any]]:
    """`evaluate_trajectory` of every method, by name, in the order of `FILES`."""
    return {
        name: evaluate_trajectory(methods[name], truth, tracking=name in TRACKING) for name in FILES if name in methods
    }


def files_read(directory: Path, ground_truth: Path | None = None) -> list[Path]:
    """Files that `evaluate_directory` reads, as far as they are there."""
    truth = directory / _TRUTH if ground_truth is None else ground_truth
    return [*(directory / name for name in (*FILES.values(), MANIFEST)), truth]


def evaluate_directory(directory: Path, ground_truth: Path | None = None) -> dict[str, Any]:
    """Recompute the metrics of a run from the trajectories that it wrote.

    Args:
        directory: What `vapor-track run` wrote; `trajectory.tum` must be there, the other files of `FILES` may be.
        ground_truth: True poses as a TUM file; None for `ground_truth.tum` in the directory.

    Returns:
        `frames`, `frames_with_true_pose`, and for each method found its metrics, as in `report.json`.

    Raises:
        VaporTrackError: a file is missing, malformed or not as its manifest lists it, or nothing overlaps.
    """
    if not directory.is_dir():
        raise VaporTrackError(f"{directory}: no such directory, expected one that `vapor-track run` wrote")
    if not (directory / FILES["filter"]).is_file():
        raise VaporTrackError(
            f"{directory}: no {FILES['filter']} in it, expected a directory that `vapor-track run` wrote"
        )
    verify(directory, [*FILES.values(), *([_TRUTH] if ground_truth is None else [])])
    truth_path = directory / _TRUTH if ground_truth is None else ground_truth
    if not truth_path.is_file():
        hint = "; give the true poses with --ground-truth FILE" if ground_truth is None else ""
        raise VaporTrackError(f"{truth_path}: no such file, expected true poses as TUM text{hint}")
    truth = read_tum(truth_path)
    methods = {name: read_tum(directory / file) for name, file in FILES.items() if (directory / file).is_file()}
    try:
        metrics = evaluate_methods(methods, truth)
    except VaporTrackError as error:
        raise VaporTrackError(f"{directory} against {truth_path}: {error}") from error
    found, _ = associate(methods["filter"].times_ns, truth)
    return {"frames": len(found), "frames_with_true_pose": int(found.sum()), **metrics}


def _span(trajectory: Trajectory) -> str:
    first_s, last_s = trajectory.times_ns[[0, -1]] / 1e9
    return f"{first_s:.3f} s to {last_s:.3f} s"
