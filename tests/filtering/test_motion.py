import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from filtering.errors import VaporTrackError
from filtering.motion import (
    MotionNoise,
    Odometry,
    OdometryBias,
    covariance_factor,
    require_odometry,
)
from filtering.se3 import Poses


def test_a_singular_covariance_has_a_factor():
    covariance = np.zeros((6, 6))
    covariance[0, 0] = 4.0
    factor = covariance_factor(covariance)
    np.testing.assert_allclose(factor @ factor.T, covariance, atol=1e-12)


def test_stated_noise_grows_with_motion_and_time():
    noise = MotionNoise()
    still = noise.covariance(Poses.identity(), 0.1)
    moving = noise.covariance(Poses.exp(np.array([1.0, 0, 0, 0, 0, 0.5])), 0.1)
    later = noise.covariance(Poses.identity(), 1.0)
    assert (np.diag(moving) > np.diag(still)).all()
    np.testing.assert_allclose(np.diag(later), 10 * np.diag(still))


TWIST = np.array([0.9, -0.2, 0.4, 0.3, -0.5, 0.8])


@st.composite
def motions(draw):
    """A tangent whose turn is at most π, seconds it takes (0 too), and shares that its parts have of it."""
    rng = np.random.default_rng(draw(st.integers(0, 10_000)))
    turn = rng.standard_normal(3)
    turn *= draw(st.floats(0.0, 3.1)) / np.linalg.norm(turn)
    moved = rng.standard_normal(3) * draw(st.sampled_from([0.0, 0.01, 1.0, 20.0]))
    cuts = np.sort(draw(st.lists(st.floats(0.0, 1.0), max_size=6)))
    return np.concatenate([moved, turn]), draw(st.sampled_from([0.0, 0.1, 30.0])), np.diff([0.0, *cuts, 1.0])


@settings(max_examples=100)
@given(motion=motions())
def test_a_motion_in_any_parts_is_as_uncertain_as_in_one(motion):
    tangent, duration_s, shares = motion
    noise = MotionNoise()

    def part(share):
        moved = Poses.exp(share * tangent)
        return Odometry(moved, noise.covariance(moved, share * duration_s), share * duration_s)

    composed = part(shares[0])
    for share in shares[1:]:
        composed = composed.then(part(share))
    whole = part(1.0)
    np.testing.assert_allclose(
        composed.previous_from_current.as_matrix(), whole.previous_from_current.as_matrix(), atol=1e-9
    )
    scale = np.sqrt(np.outer(np.diag(whole.covariance), np.diag(whole.covariance))) + 1e-30
    np.testing.assert_allclose(composed.covariance / scale, whole.covariance / scale, atol=1e-9)
    assert composed.duration_s == pytest.approx(duration_s)


def test_what_composes_is_what_happens_to_poses():
    """`then` says what errors drawn for two increments do to the pose after both."""
    rng = np.random.default_rng(0)
    root = rng.normal(scale=0.02, size=(2, 6, 6))
    first, second = (
        Odometry(Poses.exp(TWIST * sign), factor @ factor.T, 0.5) for sign, factor in zip((1, -0.7), root, strict=True)
    )
    drawn = [
        step.previous_from_current @ Poses.exp(rng.standard_normal((40_000, 6)) @ factor.T)
        for step, factor in zip((first, second), root, strict=True)
    ]
    both = first.then(second)
    errors = (both.previous_from_current.inverse() @ drawn[0] @ drawn[1]).log()
    scale = np.sqrt(np.outer(np.diag(both.covariance), np.diag(both.covariance)))
    # 40 000 draws: entries of a correlation matrix have a standard error of at most √2/200; curvature adds its own.
    np.testing.assert_allclose(errors.T @ errors / 40_000 / scale, both.covariance / scale, atol=0.04)


def test_a_motion_in_no_time_errs_by_its_length_alone_and_none_at_all_does_not_err():
    noise = MotionNoise()
    assert not noise.covariance(Poses.identity(), 0.0).any()
    straight = noise.covariance(Poses.exp(np.array([4.0, 0, 0, 0, 0, 0])), 0.0)
    assert straight[0, 0] == pytest.approx((0.02 * 2) ** 2)
    assert straight[3, 3] == pytest.approx((0.01 * 2) ** 2)


@pytest.mark.parametrize("duration_s", [-0.1, float("nan"), float("inf")])
def test_a_duration_that_is_none_is_refused_with_its_value(duration_s):
    with pytest.raises(VaporTrackError, match=f"took {duration_s} s, expected"):
        MotionNoise().covariance(Poses.identity(), duration_s)
    with pytest.raises(VaporTrackError, match=f"took {duration_s} s, expected"):
        require_odometry(Odometry(Poses.identity(), np.eye(6), duration_s))


def test_a_negative_drift_is_refused():
    with pytest.raises(VaporTrackError, match=r"drift is .*-1.0.*, expected each axis"):
        OdometryBias(drift=(0.0, 0.0, 0.0, 0.0, 0.0, -1.0))


def test_after_a_part_of_which_the_rotation_alone_is_known_the_way_that_is_left_is_unknown():
    whole = Odometry(Poses.exp(TWIST), 1e-4 * np.eye(6), 1.0)
    rest = whole.after(Odometry.turn(Poses.exp(0.5 * TWIST), 1e-6 * np.eye(3), 0.5))
    assert not rest.knows_translation
    np.testing.assert_allclose(rest.tangent, np.append(np.zeros(3), 0.5 * TWIST[3:]), atol=1e-9)
    assert rest.duration_s == 0.5
