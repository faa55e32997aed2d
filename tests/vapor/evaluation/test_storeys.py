"""Whether a pose is counted on the right storey, and right but for it."""

import numpy as np
import pytest

from filtering.estimate import Mode
from filtering.se3 import Poses
from filtering.storeys import Storeys
from sequences.frame import Trajectory
from tests.helpers.simulated_run import true_walk
from vapor.evaluation.consistency import evaluate_belief
from vapor.evaluation.storeys import evaluate_storey, evaluate_storeys, once_on_storey, storey_accuracy
from vapor.tracking.loop import Belief

HEIGHT = 3.0


def raised(truth: Poses, metres: list[float], along: float = 0.0) -> Poses:
    return Poses(truth.rotation, truth.translation + np.array([[along, 0.0, up] for up in metres]))


def test_from_when_on_the_storey_is_right_counts_to_the_end():
    truth = true_walk(5)
    assert once_on_storey(raised(truth, [3, 0, 3, 0.1, 0]), truth, HEIGHT).tolist() == [False] * 3 + [True] * 2
    assert once_on_storey(truth, truth, HEIGHT).all()
    assert not once_on_storey(raised(truth, [0, 0, 0, 0, 3]), truth, HEIGHT).any()


def test_poses_are_right_but_for_their_storey_and_once_on_it():
    truth = true_walk(5)
    poses = raised(truth, [3, 3, 0.5, 0.5, 0])
    assert evaluate_storey(poses, truth, HEIGHT) == {
        "but_for_it": 0.6, "settled_images": 3, "settled_right": pytest.approx(1 / 3)
    }  # fmt: skip
    never = evaluate_storey(raised(truth, [3] * 5, along=1.0), truth, HEIGHT)
    assert never == {"but_for_it": 0.0, "settled_images": 0, "settled_right": None}


FLOORS = Storeys((1.6, 4.6, 7.6))


def test_storeys_are_right_as_often_as_the_nearest_heights_agree():
    truth = Poses(true_walk(4).rotation, np.array([[0.0, 0.0, z] for z in (1.6, 1.7, 4.5, 7.6)]))
    assert storey_accuracy(truth, truth, FLOORS) == 1.0
    assert storey_accuracy(raised(truth, [1.35, 1.45, -1.5, 9.0]), truth, FLOORS) == 0.5
    assert storey_accuracy(raised(truth, [0.0] * 4, along=50.0), truth, FLOORS) == 1.0


def test_the_belief_over_storeys_is_judged_where_the_truth_is_known():
    """Five images, the third without a true pose; sure in the last three, wrongly so in the last."""
    heights = [1.6, 1.6, 1.6, 4.6, 4.6]
    poses = Poses(true_walk(5).rotation, np.array([[0.0, 0.0, z] for z in heights]))
    times_ns = 10**9 * np.arange(5)
    known = np.array([0, 1, 3, 4])
    belief = np.array([[0.5, 0.5, 0], [0.9, 0.1, 0], [0.96, 0.04, 0], [0, 1, 0], [0.01, 0.02, 0.97]])
    methods = {
        "filter": Trajectory(times_ns, raised(poses, [3.0, 0, 9, 0, 3.0])),
        "single_image": Trajectory(times_ns, raised(poses, [3.0, 3.0, 0, -3.0, 0])),
    }
    truth = Trajectory(times_ns[known], poses[known])
    assert evaluate_storeys(FLOORS, belief, methods, truth) == {
        "heights_m": [1.6, 4.6, 7.6],
        "belief": [0.01, 0.02, 0.97],
        "sure": 0.6,
        "sure_and_wrong": 0.5,
        "true_storey": pytest.approx((0.5 + 0.9 + 1.0 + 0.02) / 4),
        "accuracy": {"filter": 0.5, "single_image": 0.25},
    }
    unknown = evaluate_storeys(FLOORS, belief, methods, None)
    assert unknown == {"heights_m": [1.6, 4.6, 7.6], "belief": [0.01, 0.02, 0.97], "sure": 0.6}
    never = evaluate_storeys(FLOORS, np.full((5, 3), 1 / 3), methods, truth)
    assert (never["sure"], never["sure_and_wrong"]) == (0.0, None)


def test_a_belief_is_evaluated_once_on_its_storey():
    truth = true_walk(5)
    poses = raised(truth, [3, 3, 0.5, 0, 0])
    modes = [(Mode(poses[i], 0.01 * np.eye(6), 1.0),) for i in range(5)]
    times_ns = 100_000_000 * np.arange(5)
    found = evaluate_belief(
        Belief(modes, ["ambiguous"] * 5),
        times_ns,
        truth,
        converged_at_s=None,
        kidnap_index=None,
        storey_height_m=HEIGHT,
    )["on_storey"]
    assert (found["images"], found["wrong"]) == (3, pytest.approx(1 / 3))
    assert found["coverage"]["95%"] == pytest.approx(2 / 3)
    plain = evaluate_belief(Belief(modes, ["ambiguous"] * 5), times_ns, truth, converged_at_s=None, kidnap_index=None)
    assert "on_storey" not in plain
