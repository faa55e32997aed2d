import matplotlib
import numpy as np
import pytest
from matplotlib import pyplot

from filtering.errors import VaporTrackError
from filtering.se3 import Poses
from sequences.frame import Trajectory
from vapor.reporting.trajectory_plot import plot_trajectories
from vapor.tracking.methods import METHODS

matplotlib.use("Agg")


@pytest.fixture(autouse=True)
def closed():
    yield
    pyplot.close("all")


def path(positions):
    positions = np.asarray(positions, np.float64)
    poses = Poses(np.tile(np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]]), (len(positions), 1, 1)), positions)
    return Trajectory(np.arange(len(positions)) * 100_000_000, poses)


STRAIGHT = path(np.linspace([0, 0, 1], [2, 1, 1], 21))


def test_methods_and_the_truth_have_the_labels_and_colours_of_the_reports():
    axes = plot_trajectories(
        {"truth": STRAIGHT, "single_image": STRAIGHT, "filter": STRAIGHT, "theirs": STRAIGHT.poses}
    )
    drawn = {line.get_label(): line for line in axes.lines}
    assert [*drawn] == ["truth", "single image", "particle filter", "theirs", "begin"]
    assert drawn["particle filter"].get_color() == METHODS["filter"].color
    assert drawn["single image"].get_linestyle() == "None"
    np.testing.assert_array_equal(drawn["theirs"].get_xydata(), STRAIGHT.poses.translation[:, :2])
    np.testing.assert_array_equal(drawn["begin"].get_xydata(), [[0.0, 0.0]])
    assert (axes.get_xlabel(), axes.get_ylabel(), axes.get_aspect()) == ("x [m]", "y [m]", 1.0)


def test_a_line_is_broken_where_a_hypothesis_jumps():
    positions = STRAIGHT.poses.translation.copy()
    positions[10:, 2] += 3.0
    _, axes = pyplot.subplots()
    assert plot_trajectories({"mine": path(positions)}, axes, plane="xz") is axes
    drawn = axes.lines[0].get_xydata()
    assert np.flatnonzero(np.isnan(drawn).any(axis=1)).tolist() == [10]
    assert len(drawn) == len(positions) + 1


def test_trajectories_without_a_pose_are_named():
    with pytest.raises(VaporTrackError, match="no pose in 1 trajectories"):
        plot_trajectories({"mine": Poses.identity(0)})


def test_a_trajectory_without_a_name_is_an_error_that_says_so(unchecked):
    with pytest.raises(VaporTrackError, match="one Trajectory, expected trajectories by name"):
        plot_trajectories(STRAIGHT)


def test_the_truth_lies_below_the_others_and_is_wider_and_the_begin_is_its_own():
    axes = plot_trajectories({"filter": path(np.linspace([1, 0, 1], [2, 1, 1], 21)), "truth": STRAIGHT})
    drawn = {line.get_label(): line for line in axes.lines}
    assert drawn["truth"].get_zorder() < drawn["particle filter"].get_zorder()
    assert drawn["truth"].get_linewidth() > drawn["particle filter"].get_linewidth()
    np.testing.assert_array_equal(drawn["begin"].get_xydata(), [[0.0, 0.0]])
