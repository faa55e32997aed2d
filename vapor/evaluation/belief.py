"""Whether a method knows how good it is: what it says of itself, image by image, against the truth."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float64, Int64

from filtering.estimate import Mode, Status
from filtering.se3 import Poses
from sequences.frame import Trajectory
from vapor.evaluation.floors import on_true_floor, once_on_floor
from vapor.evaluation.lengths import scaled_mode
from vapor.evaluation.trajectory import SURE, evaluate_consistency, is_right

JUMP_M = 1.0
"""A false recovery takes the best mode at least this far from the truth."""


@dataclass(frozen=True)
class Belief:
    """What a method believed after each of n images.

    Attributes:
        modes: Hypotheses per image, the reported one first.
        status: Its own verdict per image.
    """

    modes: Sequence[tuple[Mode, ...]]
    status: Sequence[Status]

    @property
    def best(self) -> Poses:
        """The reported poses, world_from_camera, batch (n,)."""
        return Poses.stack([modes[0].world_from_camera for modes in self.modes])

    def scaled(self, factor: float) -> Belief:
        """The same where all lengths are multiplied by a factor."""
        return replace(self, modes=[tuple(scaled_mode(mode, factor) for mode in modes) for modes in self.modes])


def judge_belief(
    belief: Belief,
    times_ns: Int64[np.ndarray, " n"],
    truth: Poses,
    *,
    converged_at_s: float | None,
    seam: int | None,
    floor_height_m: float | None = None,
) -> dict[str, Any]:
    """Every figure on how far a method is to be trusted.

    Args:
        belief: After each of n images.
        times_ns: Stamps (n,).
        truth: True poses, batch (n,).
        converged_at_s: When it found itself, of `evaluate_trajectory`.
        seam: First image after the camera was carried off; None where it was not.
        floor_height_m: From floor to floor, where floors look alike.

    Returns:
        `status`: share of the images by verdict. `said_converged`, `after_convergence`, `all_images`:
        `evaluate_consistency` over the images of that status, those from `converged_at_s` on, and all.
        `truth_among_modes`: share of the images with a mode within 0.3 m and 20° of the truth. `longest_wrong_s`: how
        long at most it said `converged` and was wrong in all images. `false_recoveries`: their number, see
        `count_false_recoveries`. `kidnap`: None, or whether the last image before was `right_before`, and `images` as
        `recovery_images`. `on_floor`, with `floor_height_m`: `evaluate_consistency` over the images from when on its
        floor is right.
    """
    best = belief.best
    covariance = np.stack([modes[0].covariance for modes in belief.modes])
    verdicts = Counter(belief.status)
    said = np.array([status == "converged" for status in belief.status])
    elapsed_s = (times_ns - times_ns[0]) / 1e9
    after = np.zeros(len(said), bool) if converged_at_s is None else elapsed_s >= converged_at_s - 1e-9
    trajectory, true_trajectory = Trajectory(times_ns, best), Trajectory(times_ns, truth)
    right, error_m = is_right(best, truth), best.distance(truth)[0]
    of_floor: dict[str, Any] = {}
    if floor_height_m is not None:
        settled = once_on_floor(best, truth, floor_height_m)
        of_floor["on_floor"] = evaluate_consistency(trajectory, covariance, settled, true_trajectory)
    return of_floor | {
        "status": {name: verdicts[name] / len(said) for name in ("converged", "ambiguous", "lost")},
        "said_converged": evaluate_consistency(trajectory, covariance, said, true_trajectory),
        "after_convergence": evaluate_consistency(trajectory, covariance, after, true_trajectory),
        "all_images": evaluate_consistency(trajectory, covariance, np.ones(len(said), bool), true_trajectory),
        "truth_among_modes": truth_among_modes(belief.modes, truth),
        "longest_wrong_s": longest_s(said & ~right, times_ns),
        "false_recoveries": count_false_recoveries(right, error_m, seam=seam),
        "kidnap": None
        if seam is None
        else {"right_before": bool(right[seam - 1]), "images": recovery_images(right, seam=seam)},
    }


def judge_floor(poses: Poses, truth: Poses, floor_height_m: float) -> dict[str, Any]:
    """How often poses (n,) are right but for their floor, and once their floor is right.

    Returns:
        `but_for_it`: share of the images that are right if they are moved to the true floor. `settled_images`: those
        from the first on which, and on all later ones of which, the floor is right; `settled_right`: share of them that
        are right, None if there are none.
    """
    right, settled = is_right(poses, truth), once_on_floor(poses, truth, floor_height_m)
    return {
        "but_for_it": float(np.mean(is_right(on_true_floor(poses, truth, floor_height_m), truth))),
        "settled_images": int(settled.sum()),
        "settled_right": float(np.mean(right[settled])) if settled.any() else None,
    }


def truth_among_modes(modes: Sequence[tuple[Mode, ...]], truth: Poses) -> float:
    """Share of the images with any mode, however light, within 0.3 m and 20° of the true pose."""
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
    right: Bool[np.ndarray, " n"], error_m: Float64[np.ndarray, " n"], *, seam: int | None = None
) -> int:
    """How often the pose was right at an image and more than 1 m off at the next.

    Args:
        right: Whether the pose is right, (n,).
        error_m: Its error of position, metres, (n,).
        seam: First image after the camera was carried off, where any method is thrown off.
    """
    leaps = right[:-1] & (error_m[1:] > JUMP_M)
    if seam is not None:
        leaps[seam - 1] = False
    return int(leaps.sum())


def recovery_images(right: Bool[np.ndarray, " n"], *, seam: int) -> int | None:
    """How many images at its new place a method needed to be right again and stay so.

    Args:
        right: Whether the pose is right, (n,).
        seam: First image at the new place.

    Returns:
        1 for the image at the seam itself; the last of them is right, and with it at least 95 % of all that follow.
        None if there is no such image.
    """
    later = right[seam:]
    remaining = np.arange(len(later), 0, -1)
    right_from_here = np.cumsum(later[::-1])[::-1]
    candidates = np.flatnonzero(later & (right_from_here >= SURE * remaining))
    return int(candidates[0]) + 1 if len(candidates) else None


def mode_status(mode: Mode, converged_std_m: float, converged_weight: float) -> Status:
    """The verdict of a baseline, by what of the filter's rule it has: the weight of its best mode, and its position."""
    sure = mode.widest_std_m <= converged_std_m and mode.weight >= converged_weight
    return "converged" if sure else "ambiguous"
