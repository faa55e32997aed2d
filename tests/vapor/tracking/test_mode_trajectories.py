"""The poses of each mode over time, from estimates and from the file of a run."""

import io

import numpy as np
import pytest

from filtering.se3 import Poses
from sequences.errors import SequenceError
from tests.helpers.simulation import AHEAD, lifted, new_localizer, seen_at
from vapor.reporting.modes_file import COLUMNS, read_mode_trajectories, write_modes
from vapor.tracking.mode_trajectories import mode_trajectories

STEP_NS = 100_000_000


@pytest.fixture(scope="module")
def walked():
    """Estimates of a walk where two storeys look alike until the tenth image, and the true poses."""
    localizer, pose, truth, estimates = new_localizer(), Poses.identity(), [], []
    for i in range(30):
        pose = pose @ AHEAD.previous_from_current if i else pose
        truth.append(pose)
        seen = seen_at(lifted(pose, (0.0, 3.0)), (0.6, 0.4)) if i < 10 else seen_at(lifted(pose, (3.0,)))
        estimates.append(localizer.update(seen, AHEAD if i else None))
    return estimates, Poses.stack(truth)


def times_of(estimates):
    return [i * STEP_NS for i in range(len(estimates))]


def test_the_second_best_mode_has_a_trajectory_of_its_own(walked):
    estimates, truth = walked
    first = estimates[0]
    trajectories = mode_trajectories(times_of(estimates), estimates)
    low, high = (trajectories[mode.identity] for mode in first.modes)
    assert high.trajectory.times_ns.tolist() == times_of(estimates)
    np.testing.assert_allclose(high.trajectory.poses.translation, lifted_all(truth, 3.0), atol=0.15)
    assert high.ranks[0] == 1
    assert high.ranks[-1] == 0
    assert high.weights[-1] > 0.9 > high.weights[0]
    assert len(low.trajectory) < 30
    np.testing.assert_allclose(low.trajectory.poses.translation, truth.translation[: len(low.trajectory)], atol=0.15)


def lifted_all(truth, up_m):
    return truth.translation + np.array([0.0, 0.0, up_m])


def test_the_file_of_a_run_gives_the_same_trajectories(walked, tmp_path):
    estimates, _ = walked
    text = io.StringIO()
    text.write(f"{COLUMNS}\n")
    for time_ns, estimate in zip(times_of(estimates), estimates, strict=True):
        write_modes(text, time_ns, estimate.modes)
    path = tmp_path / "modes.csv"
    path.write_text(text.getvalue())
    read, made = read_mode_trajectories(path), mode_trajectories(times_of(estimates), estimates)
    assert read.keys() == made.keys()
    for identity, of_file in read.items():
        np.testing.assert_array_equal(of_file.trajectory.times_ns, made[identity].trajectory.times_ns)
        np.testing.assert_array_equal(of_file.ranks, made[identity].ranks)
        np.testing.assert_allclose(of_file.weights, made[identity].weights, atol=1e-6)
        of_file, of_estimates = (each.trajectory.poses.as_matrix() for each in (of_file, made[identity]))
        np.testing.assert_allclose(of_file, of_estimates, atol=1e-5)


ROW = "1.5,0,0.5,0,0,0,0,0,0,1,0.1,1"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "begins with '', expected the columns time,identity"),
        ("time,status\n", "begins with 'time,status', expected the columns time,identity"),
        (f"{COLUMNS}\n{ROW}\n1.5,0\n", "modes.csv:3: 2 columns, expected the twelve"),
        (f"{COLUMNS}\n{ROW}\n{ROW}\n", "modes.csv:3: mode 0 is there twice"),
        (f"{COLUMNS}\n{ROW}\n{ROW.replace('1.5', '1.4')}\n", "modes.csv:3: time 1.4 is before"),
        (f"{COLUMNS}\n{ROW.replace(',0.5,', ',1.5,')}\n", "modes.csv:2: weight"),
        (f"{COLUMNS}\n{ROW.replace('0,0,0,1,', '0,0,0,0,')}\n", "modes.csv:2: quaternion .* has zero length"),
    ],
)
def test_a_file_that_is_none_of_modes_is_refused(tmp_path, text, message):
    path = tmp_path / "modes.csv"
    path.write_text(text)
    with pytest.raises(SequenceError, match=message):
        read_mode_trajectories(path)
