"""Whether figures on a method's reported confidence are what they are called."""

import numpy as np
import pytest

from filtering.estimate import Mode
from filtering.se3 import Poses
from tests.helpers.simulated_run import true_walk
from vapor.evaluation.consistency import count_false_recoveries, evaluate_belief, recovery_images, truth_among_modes
from vapor.evaluation.trajectory import is_right
from vapor.tracking.loop import Belief, mode_status

S = 1_000_000_000


def moved(pose: Poses, metres: float, degrees: float = 0.0) -> Poses:
    turn = Poses.exp(np.array([0, 0, 0, 0, 0, np.radians(degrees)]))
    return Poses(pose.rotation @ turn.rotation, pose.translation + np.array([metres, 0, 0]))


def mode(pose: Poses, weight: float = 1.0, std: float = 0.1) -> Mode:
    return Mode(pose, std**2 * np.eye(6), weight)


def test_right_is_within_both_limits():
    truth = Poses.identity(4)
    poses = Poses.stack([moved(truth[0], *error) for error in ((0.29, 19), (0.31, 0), (0.0, 21), (0.0, 0))])
    assert is_right(poses, truth).tolist() == [True, False, False, True]


def test_recovery_counts_the_images_at_the_new_place_up_to_the_one_that_is_right_to_stay():
    before = [True] * 10
    assert recovery_images(np.array(before + [True] * 40), kidnap_index=10) == 1
    assert recovery_images(np.array(before + [False] * 7 + [True] * 33), kidnap_index=10) == 8
    # A lucky image at once, and one slip in thirty-two afterwards.
    later = [True, False, False, False, False, False, False, False, *([True] * 10), False, *([True] * 21)]
    assert recovery_images(np.array(before + later), kidnap_index=10) == 9
    assert recovery_images(np.array(before + [False] * 40), kidnap_index=10) is None
    # What was right before counts for nothing.
    assert recovery_images(np.array([False] * 10 + [True] * 40), kidnap_index=10) == 1


def test_a_false_recovery_leaves_the_truth_by_more_than_a_metre_at_once():
    right = np.array([True, True, False, True, False, False, True, True])
    error_m = np.array([0.1, 0.1, 3.0, 0.1, 0.9, 3.0, 0.1, 0.1])
    assert count_false_recoveries(right, error_m) == 1  # 0.9 m is a drift, and 3 m follows what was wrong before
    assert count_false_recoveries(right, error_m, kidnap_index=2) == 0  # there the camera leapt, not the method
    assert count_false_recoveries(right, error_m, kidnap_index=3) == 1


def test_the_truth_is_among_the_modes_however_light_the_mode():
    truth = true_walk(4)
    far = [mode(moved(truth[i], 5.0), 0.97) for i in range(4)]
    near = [mode(moved(truth[i], distance), 0.03) for i, distance in enumerate((0.0, 0.29, 0.31, 0.0))]
    modes = [(far[0], near[0]), (far[1], near[1]), (far[2], near[2]), (far[3],)]
    assert truth_among_modes(modes, truth) == 0.5


def test_a_belief_is_evaluated_by_its_best_mode_where_it_says_converged():
    n = 40
    truth = true_walk(n)
    error_m = np.where(np.arange(n) < 10, 4.0, 0.1)
    error_m[20:22] = 4.0
    modes = [(mode(moved(truth[i], error_m[i])), mode(truth[i], 0.1)) for i in range(n)]
    status = ["ambiguous"] * 10 + ["converged"] * 28 + ["lost"] * 2
    found = evaluate_belief(Belief(modes, status), S // 10 * np.arange(n), truth, converged_at_s=2.2, kidnap_index=None)
    assert found["status"] == {"converged": 0.7, "ambiguous": 0.25, "lost": 0.05}
    assert found["converged_images"]["images"] == 28
    assert found["converged_images"]["wrong"] == pytest.approx(2 / 28)
    assert found["converged_images"]["coverage"]["95%"] == pytest.approx(26 / 28)
    assert found["after_convergence"]["images"] == 18
    assert found["after_convergence"]["wrong"] == 0.0
    assert found["after_convergence"]["median_nees"] == pytest.approx(1.0, rel=1e-6)
    assert found["truth_among_modes"] == 1.0
    assert found["false_recoveries"] == 1
    assert found["kidnap"] is None
    assert sum(each["images"] for each in found["reliability"].values()) == n
    assert sum(each["images"] * each["right"] for each in found["reliability"].values()) == pytest.approx(28)


def test_a_kidnapped_belief_is_evaluated_before_and_after():
    truth = true_walk(30)
    modes = [(mode(moved(truth[i], 4.0 if 10 <= i < 16 else 0.0)),) for i in range(30)]
    belief = Belief(modes, ["converged"] * 30)
    found = evaluate_belief(belief, S // 10 * np.arange(30), truth, converged_at_s=None, kidnap_index=10)
    assert found["kidnap"] == {"right_before": True, "images": 7}
    assert found["false_recoveries"] == 0
    assert found["after_convergence"]["images"] == 0
    assert not evaluate_belief(belief, S // 10 * np.arange(30), truth, converged_at_s=None, kidnap_index=16)["kidnap"][
        "right_before"
    ]


@pytest.mark.parametrize(
    ("of", "status"),
    [
        (mode(Poses.identity(), std=0.49), "converged"),
        (mode(Poses.identity(), std=0.51), "ambiguous"),
        (mode(Poses.identity(), 0.91), "converged"),
        (mode(Poses.identity(), 0.89), "ambiguous"),
    ],
)
def test_a_hypothesis_is_sure_while_its_position_is_and_it_outweighs_the_others(of, status):
    assert mode_status(of, 0.5, 0.9) == status
