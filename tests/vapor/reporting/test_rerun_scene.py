"""What is the same in every scene of Rerun: the first view, sizes, colours of hypotheses, images in their places."""

import numpy as np
import pytest

from filtering.motion import Odometry
from filtering.se3 import Poses
from filtering.storeys import up_axis
from tests.helpers.simulated_run import true_walk
from vapor.reporting.rerun_place import whole_view
from vapor.reporting.rerun_shapes import BEST, HypothesisColors, steps

HALF_VIEW = np.tan(np.radians(55.0 / 2))  # of Rerun's eye


def seen_from(eye: np.ndarray, target: np.ndarray, up: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Where points (n, 3) are in a picture that reaches from -1 to 1; NaN behind the eye."""
    ahead = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(ahead, up)
    right /= np.linalg.norm(right)
    depth = (points - eye) @ ahead
    aside = (points - eye) @ np.stack([right, np.cross(right, ahead)], axis=1)
    return np.where(depth[:, None] > 0, aside / (HALF_VIEW * depth[:, None]), np.nan)


@pytest.mark.parametrize("up", [[0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
@pytest.mark.parametrize("sides", [(3.0, 4.0, 2.5), (100.0, 20.0, 3.0), (4.0, 4.0, 60.0), (1.0, 0.0, 0.0)])
def test_the_first_view_holds_the_whole_box_and_is_not_far_away(sides, up):
    low, high, up = np.array([5.0, -7.0, 2.0]), np.array([5.0, -7.0, 2.0]) + sides, np.array(up)
    eye, target = whole_view(low, high, up)
    corners = np.array(np.meshgrid(*zip(low, high, strict=True))).reshape(3, 8).T
    seen = np.abs(seen_from(eye, target, up, corners))
    assert (eye - target) @ up > 0  # from above
    assert (seen < 1.0).all()
    assert seen.max() > 0.6


def test_up_is_where_the_images_have_it_and_z_where_they_do_not_tell():
    np.testing.assert_array_equal(up_axis(true_walk(50)), [0.0, 0.0, 1.0])
    looking_up = Poses.exp(np.array([[0.0, 0.0, 0.0, 0.0, 0.0, turn] for turn in (0.0, 1.5, 3.0, 4.5)]))
    np.testing.assert_array_equal(up_axis(looking_up), [0.0, 0.0, 1.0])
    about_y = Poses.exp(np.array([[0.0, 0.0, 0.0, 0.0, turn, 0.0] for turn in (0.0, 1.0, 2.0, 4.0)]))
    np.testing.assert_array_equal(up_axis(about_y), [0.0, -1.0, 0.0])  # OpenCV's axes: y is down


def test_hypotheses_keep_their_colours_as_they_move_and_change_ranks_and_the_best_is_blue():
    colors = HypothesisColors(0.5)
    storeys = Poses(np.tile(np.eye(3), (4, 1, 1)), np.array([[0.0, 0.0, 3.0 * storey] for storey in range(4)]))
    first = colors.of(storeys, None)
    assert len(np.unique(first, axis=0)) == 4
    assert tuple(first[0]) == BEST
    step = Poses.exp(np.array([2.5, 0.0, 0.0, 0.0, 0.0, 0.0]))
    order = [2, 3, 0]
    later = colors.of((storeys @ step)[order], Odometry(step, np.eye(6), 0.1))
    assert tuple(later[0]) == BEST
    np.testing.assert_array_equal(later[1], first[3])
    assert tuple(later[2]) not in {*map(tuple, first[1:]), BEST}  # its own, when not the best
    again = colors.of(storeys @ step @ step, Odometry(step, np.eye(6), 0.1))
    np.testing.assert_array_equal(again[2:], first[2:])


def test_a_path_is_broken_where_it_jumps():
    points = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [3.0, 0.0, 0.0], [3.1, 0.0, 0.0]])
    np.testing.assert_allclose(steps(points, 1.0)[:, :, 0], [[0.0, 0.0], [0.0, 0.1], [3.0, 3.0], [3.0, 3.1]])
