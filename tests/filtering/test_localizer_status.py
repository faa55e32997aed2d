"""When a belief is lost, ambiguous or converged, and how it recovers."""

import numpy as np
import pytest

from filtering.se3 import Poses
from tests.helpers.simulation import (
    AHEAD,
    ERRORS,
    ODOMETRY_STD,
    STAY,
    lifted,
    motion,
    new_localizer,
    seen_at,
    walk,
    weight_near,
)


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("rate", [1, 3, 10, 30])
def test_foreign_images_are_lost_after_about_a_second_or_six_images_and_the_map_in_view_again_is_found(rate):
    localizer = new_localizer()
    walk(localizer, 30)
    step = motion(0, 0, 0, 0, 0, 0, std=ODOMETRY_STD / np.sqrt(rate / 10), duration_s=1 / rate)
    foreign = seen_at(Poses.exp(np.array([[9.0, 0, 0, 0, 0, 0]])), unfamiliarity=2.0)
    statuses = [localizer.update(foreign, step).status for _ in range(max(3 * rate, 10))]
    since_s = (statuses.index("lost") + 1) / rate
    # e^(−1.2) is the least agreement, and so is 0.8 to the 5.4
    assert since_s == pytest.approx(max(1.2, 5.4 / rate), abs=max(0.34, 1.0 / rate))
    assert statuses[-1] == "lost"
    pose = localizer.predict(motion(0, 0, 0, 0, 0, 0, std=np.zeros(6), duration_s=0.0)).modes[0].world_from_camera
    statuses = [localizer.update(seen_at(pose), step).status for _ in range(max(4 * rate, 10))]
    since_s = (statuses.index("converged") + 1) / rate
    assert since_s < max(3.0, 8.0 / rate)
    assert "lost" not in statuses[max(rate, 3) :]


def test_a_belief_whose_shares_say_sure_is_lost_all_the_same_when_images_fit_it_nowhere():
    localizer = new_localizer()
    before, _ = walk(localizer, 30)
    assert before[-1].status == "converged"
    for _ in range(30):
        estimate = localizer.update(seen_at(Poses.exp(np.array([[50.0, 0, 0, 0, 0, 0]]))), STAY)
    assert estimate.modes[0].weight > 0.9
    assert estimate.status == "lost"
    assert estimate.agreement < 0.3


@pytest.mark.usefixtures("unchecked")
def test_a_kidnapped_camera_is_followed_within_a_few_lengths_and_meanwhile_the_belief_is_not_sure():
    localizer = new_localizer()
    before, pose = walk(localizer, 40)
    assert before[-1].status == "converged"
    elsewhere = Poses.exp(np.array([40.0, -7, 2, 0, 0, 2.0]))
    estimates, pose = walk(localizer, 60, pose=elsewhere, seed=1)
    near = [weight_near(estimate, elsewhere.translation, within=9.0) for estimate in estimates]
    found = int(np.argmax(np.array(near) > 0.9))
    lengths = 0.1 / ERRORS.length_m * found
    assert 1.0 < lengths < 6.0
    statuses = [estimate.status for estimate in estimates]
    assert "converged" not in statuses[4:found]  # in a third of a second the images before are outweighed
    assert "ambiguous" in statuses[:found]
    assert statuses[-1] == "converged"
    assert estimates[-1].modes[0].world_from_camera.distance(pose)[0] < 0.3


def test_predicting_moves_the_belief_and_never_makes_it_surer():
    localizer = new_localizer()
    before, _ = walk(localizer, 30, shares=(0.6, 0.3), heights_m=(0.0, 3.0))
    last = before[-1]
    for _ in range(200):
        estimate = localizer.predict(AHEAD)
        np.testing.assert_allclose(
            [mode.weight for mode in estimate.modes[:2]], [mode.weight for mode in before[-1].modes[:2]], atol=0.02
        )
        assert estimate.modes[0].widest_std_m >= last.modes[0].widest_std_m - 1e-9
        assert (estimate.agreement, estimate.novelty, estimate.unfamiliarity) == (before[-1].agreement, 0.0, 0.0)
        last = estimate
    moved = before[-1].modes[0].world_from_camera.distance(last.modes[0].world_from_camera)[0]
    assert moved > 3.0
    assert last.modes[0].widest_std_m > 1.5 * before[-1].modes[0].widest_std_m


def test_a_belief_too_wide_is_not_converged_though_it_is_one():
    localizer = new_localizer(converged_std_m=0.08)
    assert localizer.update(seen_at(Poses.identity(1)), None).status == "ambiguous"
    assert walk(localizer, 40)[0][-1].status == "converged"


def test_the_best_mode_changes_only_when_another_clearly_outweighs_it():
    localizer = new_localizer(switch_ratio=1.5)
    localizer.update(seen_at(lifted(Poses.identity(), (0.0, 3.0)), (0.55, 0.45)), None)
    orders = []
    estimates, _ = walk(localizer, 60, shares=(0.25, 0.75), heights_m=(0.0, 3.0))
    for estimate in estimates:
        best, other = estimate.modes[:2]
        orders.append((best.world_from_camera.translation[2] > 1.5, best.weight / other.weight))
    switched = next(i for i, (up, _) in enumerate(orders) if up)
    assert any(ratio < 1.0 for _, ratio in orders[:switched])  # it stayed though it was lighter,
    assert all(ratio > 1 / 1.5 for _, ratio in orders[:switched])  # but not by much
    assert all(up for up, _ in orders[switched:])
