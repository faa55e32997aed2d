"""Offsets between the clocks of odometry and poses, on simulated walks."""

from collections.abc import Callable

import numpy as np
import pytest

from filtering.se3 import Poses
from sequences.errors import SequenceError
from sequences.frame import Trajectory
from sequences.odometry import OdometryNoise, simulate_odometry
from sequences.scenes.ceiling import roll_through_hall
from sequences.scenes.corridor import walk_corridor
from sequences.scenes.staircase import walk_stairs
from sequences.trajectories.interpolation import interpolate
from sequences.trajectories.time_offset import find_time_offset

Walk = Callable[[float, np.random.Generator], Poses]
WALKS: list[Walk] = [
    lambda duration_s, rng: walk_stairs(duration_s, rng=rng),
    lambda duration_s, rng: walk_corridor(duration_s, rng=rng),
    lambda duration_s, rng: roll_through_hall(duration_s, margin_m=1.0, rng=rng),
]
SECOND = 10**9


def two_records(path: Poses, rate_hz: int, offset_s: float, rng: np.random.Generator) -> tuple[Trajectory, Trajectory]:
    """Odometry of a base at 50 Hz; poses of another body that shake by 5 mm and 0.2°, by a clock that is behind."""
    path_ns = np.arange(len(path)) * (SECOND // 50)
    odometry_ns = np.arange(3_000_000, path_ns[-1], SECOND // 50)
    poses_ns = np.arange(0, path_ns[-1], SECOND // rate_hz)
    base, _ = interpolate(path_ns, path, odometry_ns, max_gap_s=1.0)
    odometry, _ = simulate_odometry(odometry_ns, base, OdometryNoise(), rng=rng)
    truth, _ = interpolate(path_ns, path, poses_ns, max_gap_s=1.0)
    shaking = rng.standard_normal((len(poses_ns), 6)) * np.repeat([0.005, 0.003], 3)
    poses = truth @ Poses.exp(rng.standard_normal(6)) @ Poses.exp(shaking)
    return Trajectory(odometry_ns, odometry), Trajectory(poses_ns - round(offset_s * SECOND), poses)


@pytest.mark.parametrize("rate_hz", [30, 10])
@pytest.mark.parametrize("walk", WALKS)
@pytest.mark.usefixtures("unchecked")
def test_known_offsets_are_found_within_five_milliseconds(walk: Walk, rate_hz: int) -> None:
    for seed in range(3):
        rng = np.random.default_rng(seed)
        offset_s = float(rng.uniform(-3.0, 3.0)) + 1000.0 * seed
        odometry, poses = two_records(walk(60.0, rng), rate_hz, offset_s, rng)
        assert find_time_offset(odometry, poses) == pytest.approx(offset_s, abs=0.005)


@pytest.mark.parametrize(
    ("turning", "said"),
    [
        (lambda t: 0.0 * t, r"that of the \w+ varies by .* rad/s, expected at least 0\.02"),
        (lambda t: 0.5 * t, r"that of the \w+ varies by .* rad/s, expected at least 0\.02"),
        (lambda t: np.sin(2 * t), r"as much alike at two offsets \(correlation (0\.9\d|1\.00) and (0\.9\d|1\.00)\)"),
    ],
    ids=["standing", "turning steadily", "turning to and fro"],
)
def test_rotation_that_says_too_little_is_refused(turning: Callable[[np.ndarray], np.ndarray], said: str) -> None:
    rng = np.random.default_rng(0)
    tangents = np.zeros((3000, 6))
    tangents[:, 5] = turning(np.arange(3000) / 50)
    odometry, poses = two_records(Poses.exp(tangents), 30, 1.0, rng)
    quiet = Trajectory(poses.times_ns, Poses(poses.poses.rotation, np.zeros((len(poses), 3))))
    with pytest.raises(
        SequenceError, match=rf"rotation determines no time offset.*{said}.*give --time-offset-s a number"
    ):
        find_time_offset(odometry, quiet)


def test_two_walks_of_other_days_do_not_agree() -> None:
    rng = np.random.default_rng(0)
    odometry, _ = two_records(WALKS[0](60.0, rng), 30, 0.0, rng)
    _, poses = two_records(WALKS[0](60.0, rng), 30, 0.0, rng)
    with pytest.raises(SequenceError, match=r"no time offset: odometry and poses turn (as much )?alike"):
        find_time_offset(odometry, poses)


def test_poses_a_second_apart_say_when_they_were_too_far_apart() -> None:
    rng = np.random.default_rng(0)
    odometry, poses = two_records(WALKS[0](60.0, rng), 1, 0.0, rng)
    with pytest.raises(SequenceError, match=r"poses 1 s apart, expected at most 0\.5 s to find a time offset in; give"):
        find_time_offset(odometry, poses)
