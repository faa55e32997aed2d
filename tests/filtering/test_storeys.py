"""Storeys of a building: found where cameras were, the storey of a pose, and of a belief."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import find_peaks

from filtering.errors import VaporTrackError
from filtering.estimate import Estimate, Mode
from filtering.se3 import Poses
from filtering.storeys import Storeys, peaks_of
from tests.helpers.corridors import corridor
from tests.helpers.simulated_run import true_walk

THREE = Storeys((1.6, 4.6, 8.0))


def at_heights(heights_m: list[float]) -> Poses:
    return Poses(
        np.broadcast_to(np.eye(3), (len(heights_m), 3, 3)), np.array([[0.0, 0.0, height] for height in heights_m])
    )


def believing(particles: Poses, weights: np.ndarray) -> Estimate:
    modes = (Mode(particles[0], np.eye(6), 1.0),)
    covariances = np.broadcast_to(np.eye(6), (len(particles), 6, 6))
    return Estimate(modes, "ambiguous", particles, covariances, np.log(weights), 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)


def test_a_pose_is_on_the_nearest_storey_also_below_the_lowest_and_above_the_highest():
    assert THREE.of(at_heights([-9.0, 1.6, 3.0, 3.2, 4.6, 6.2, 6.4, 90.0])).tolist() == [0, 0, 0, 1, 1, 1, 2, 2]
    batch = at_heights([1.6, 8.0])
    assert THREE.of(batch[np.array([[0, 1], [1, 0]])]).tolist() == [[0, 2], [2, 0]]
    assert Storeys((2.0,)).of(at_heights([-5.0, 5.0])).tolist() == [0, 0]


def test_stairs_belong_to_the_storey_on_their_side_of_the_cut():
    storeys = Storeys((0.0, 3.0, 6.0), cuts_m=(2.5, 3.5))
    assert storeys.of(at_heights([1.6, 2.4, 2.6, 3.4, 3.6])).tolist() == [0, 0, 1, 1, 2]


@given(st.lists(st.tuples(st.floats(-20, 20), st.floats(1e-6, 1.0)), min_size=1, max_size=30))
def test_the_belief_is_on_storeys_by_the_weights_of_its_particles(hypotheses):
    heights, weights = np.array(hypotheses).T
    weights = weights / weights.sum()
    belief = THREE.belief(believing(at_heights(heights.tolist()), weights))
    assert belief.sum() == pytest.approx(1.0)
    on = THREE.of(at_heights(heights.tolist()))
    for storey in range(3):
        assert belief[storey] == pytest.approx(weights[on == storey].sum(), abs=1e-12)


def test_storeys_are_found_where_corridors_lie_above_each_other_whichever_axis_is_up():
    walk = Poses.concatenate([corridor(0, 12, z_m=z) for z in (0.0, 3.0, 7.0)])
    found = Storeys.found_in(walk)
    assert found is not None
    assert found.heights_m == pytest.approx((0.0, 3.0, 7.0), abs=0.05)
    assert found.up == (0.0, 0.0, 1.0)
    # As structure from motion has it: y down.
    turn = Poses(np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]), np.zeros(3))
    turned = Storeys.found_in(turn @ walk)
    assert turned is not None
    assert turned.up == (0.0, -1.0, 0.0)
    assert turned.heights_m == pytest.approx((0.0, 3.0, 7.0), abs=0.05)
    np.testing.assert_array_equal(turned.of(turn @ walk), found.of(walk))


def test_the_landings_of_a_staircase_are_its_storeys_and_no_half_landing_is_a_cut():
    """The camera circles up five storeys, and stays at the same height for a while halfway up each."""
    walk = true_walk(4000, storeys=6)
    storey, turn = np.divmod((walk.translation[:, 2] - walk.translation[:, 2].min()) / 3.0, 1.0)
    flights = np.interp(turn, [0.0, 0.1, 0.4, 0.6, 0.9, 1.0], [0.0, 0.0, 0.5, 0.5, 1.0, 1.0])
    walk = Poses(walk.rotation, np.column_stack([walk.translation[:, :2], 1.6 + 3.0 * (storey + flights)]))
    found = Storeys.found_in(walk)
    assert found is not None
    np.testing.assert_allclose(found.heights_m, 1.6 + 3.0 * np.arange(6), atol=0.1)
    after = (np.array(found.cuts_m) - found.heights_m[:-1]) / 3.0
    assert (np.abs(after - 0.5) > 0.1).all()
    assert ((after > 0.1) & (after < 0.9)).all()
    halfway = walk[flights == 0.5]
    shaken = (Poses(halfway.rotation, halfway.translation + up * np.eye(3)[2]) for up in (-0.2, 0.2))
    np.testing.assert_array_equal(*(found.of(each) for each in shaken))


def scipys_peaks(values, apart):
    return find_peaks(np.concatenate([[0.0], values, [0.0]]), distance=apart)[0] - 1


@given(st.lists(st.integers(0, 6).map(float), min_size=1, max_size=40), st.integers(1, 12))
def test_peaks_are_those_that_scipy_finds(values, apart):
    assert peaks_of(np.array(values), apart).tolist() == scipys_peaks(np.array(values), apart).tolist()


def test_one_storey_is_none_and_neither_is_nothing():
    assert Storeys.found_in(corridor(0, 12)) is None
    assert Storeys.found_in(Poses.identity(0)) is None
    assert Storeys.found_in(Poses.identity(7)) is None


@pytest.mark.parametrize(
    ("heights", "up", "said"),
    [
        ((), (0.0, 0.0, 1.0), "heights_m are"),
        ((1.0, 1.0), (0.0, 0.0, 1.0), "from the lowest up"),
        ((1.0, np.nan), (0.0, 0.0, 1.0), "finite"),
        ((1.0,), (0.0, 0.0, 2.0), "unit vector"),
        ((1.0,), (0.0, np.nan, 1.0), "unit vector"),
    ],
)
def test_what_are_no_storeys_is_refused(heights, up, said):
    with pytest.raises(VaporTrackError, match=said):
        Storeys(heights, up)


@pytest.mark.parametrize("cuts", [(1.0,), (1.0, 4.0, 5.0), (1.0, 2.0), (1.0, np.nan)])
def test_cuts_that_are_not_between_storeys_are_refused(cuts):
    with pytest.raises(VaporTrackError, match=r"expected one between every two of \(0\.0, 3\.0, 6\.0\)"):
        Storeys((0.0, 3.0, 6.0), cuts_m=cuts)
