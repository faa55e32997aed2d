"""The trajectory of each mode of a run: its poses over time, for as long as it goes on."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64

from filtering.estimate import Estimate
from filtering.se3 import Poses
from sequences.frame import Trajectory


@dataclass(frozen=True)
class ModeTrajectory:
    """A mode over the n steps at which it was reported.

    Attributes:
        identity: Of the mode.
        trajectory: Its poses, (n,).
        weights: Its weight at each step, (n,).
        ranks: Its place among the modes of each step, from 0 for the best one, (n,).

    Example:
        >>> import vapor
        >>> modes = vapor.read_mode_trajectories("result/modes.csv")
        >>> one = next(iter(modes.values()))
        >>> len(one.trajectory) == len(one.weights) == len(one.ranks)
        True
    """

    identity: int
    trajectory: Trajectory
    weights: Float64[np.ndarray, " n"]
    ranks: Int64[np.ndarray, " n"]


def mode_trajectories(times_ns: Iterable[int], estimates: Iterable[Estimate]) -> dict[int, ModeTrajectory]:
    """The trajectory of each mode, by its identity.

    That of the second-best mode at the end is `trajectories[estimates[-1].modes[1].identity]`.

    Args:
        times_ns: Stamps of the estimates, strictly increasing.
        estimates: Of one localizer, in the order of time.

    Raises:
        ValueError: there are more of the ones than of the others.

    Example:
        >>> import numpy as np
        >>> import vapor
        >>> places = vapor.Poses.from_quat_xyzw([[1, 2, 0], [1, 6, 0]], [[0, 0, 0, 1], [0, 0, 0, 1]])
        >>> posterior = vapor.PosePosterior.from_estimates(places, 0.1, 0.05, vapor.MeasurementNoise())  # m, rad
        >>> localizer = vapor.ParticleLocalizer(None, rng=np.random.default_rng(0))
        >>> estimate = localizer.update(posterior, None)
        >>> modes = vapor.mode_trajectories([0], [estimate])
        >>> modes[estimate.modes[1].identity].trajectory.poses.translation.round(1)
        array([[1., 6., 0.]])
    """
    found: dict[int, list[tuple[int, Poses, float, int]]] = {}
    for time_ns, estimate in zip(times_ns, estimates, strict=True):
        for rank, mode in enumerate(estimate.modes):
            row = (int(time_ns), mode.world_from_camera, mode.weight, rank)
            found.setdefault(mode.identity, []).append(row)
    return gathered(found)


def gathered(found: Mapping[int, Sequence[tuple[int, Poses, float, int]]]) -> dict[int, ModeTrajectory]:
    """Trajectories of rows (stamp, pose, weight, rank) of each identity, in the order of time."""
    trajectories = {}
    for identity, rows in found.items():
        times_ns, poses, weights, ranks = zip(*rows, strict=True)
        trajectory = Trajectory(np.array(times_ns, np.int64), Poses.stack(poses))
        trajectories[identity] = ModeTrajectory(identity, trajectory, np.array(weights), np.array(ranks, np.int64))
    return trajectories
