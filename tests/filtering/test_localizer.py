"""The story the library exists for: what one image leaves ambiguous resolves over time."""

import numpy as np
import pytest

from filtering.config import LocalizerConfig
from filtering.errors import VaporTrackError
from filtering.localizer import ParticleLocalizer
from filtering.motion import Odometry
from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from tests.helpers.simulation import (
    AHEAD,
    FLOOR_HEIGHT_M,
    FOREIGN,
    RNG,
    Oracle,
    assert_same_belief,
    climb,
    image_of,
    lifted,
    new_localizer,
    seen_at,
    walk,
    weight_near,
)

FLOORS = (-2, -1, 0, 1, 2)


def localize(seed, num_frames, unique, config=None):
    rng = RNG(seed)
    truth, odometry = climb(num_frames, rng=rng)
    localizer = ParticleLocalizer(Oracle(truth, FLOORS, unique), config or LocalizerConfig(), rng=rng)
    estimates = [localizer.step(image_of(i), odometry[i]) for i in range(num_frames)]
    best = Poses.stack([estimate.modes[0].world_from_camera for estimate in estimates])
    return estimates, best.distance(truth)[0], truth


# --- the story ------------------------------------------------------------------------------------


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("seed", range(3))
def test_an_ambiguous_belief_collapses_to_the_truth_once_a_unique_place_is_seen(seed):
    estimates, error_m, _ = localize(seed, 60, unique=range(20, 45))
    assert all(len(estimate.modes) >= 3 for estimate in estimates[:20])
    assert all(estimate.status == "ambiguous" for estimate in estimates[:20])
    assert (error_m[45:] < 0.3).all()
    assert estimates[-1].status == "converged"


@pytest.mark.usefixtures("unchecked")
def test_without_a_unique_place_the_true_floor_stays_among_the_modes_and_convergence_is_never_claimed():
    estimates, _, truth = localize(11, 40, unique=range(0))
    assert all(estimate.status == "ambiguous" for estimate in estimates)
    for i, estimate in enumerate(estimates):
        nearest = min(float(mode.world_from_camera.distance(truth[i])[0]) for mode in estimate.modes)
        assert nearest < 0.3


def test_modes_are_a_floor_apart_and_their_covariance_does_not_bridge_them():
    estimates, _, _ = localize(12, 5, unique=range(0))
    modes = estimates[-1].modes
    heights = np.sort([mode.world_from_camera.translation[2] for mode in modes])
    np.testing.assert_allclose(np.diff(heights), FLOOR_HEIGHT_M, atol=0.3)
    assert all(np.sqrt(mode.covariance[2, 2]) < 0.3 for mode in modes)
    assert sum(mode.weight for mode in modes) == pytest.approx(1.0, abs=0.05)


def test_the_same_seed_gives_the_same_bits_and_another_seed_does_not():
    first, second, other = (localize(seed, 6, range(0))[0][-1] for seed in (3, 3, 4))
    np.testing.assert_array_equal(first.particles.translation, second.particles.translation)
    np.testing.assert_array_equal(first.log_weights, second.log_weights)
    assert not np.array_equal(first.particles.translation[:1], other.particles.translation[:1])


def test_weights_are_normalised_and_hypotheses_no_more_than_asked():
    localizer = new_localizer(max_hypotheses=10)
    estimates, _ = walk(localizer, 40, shares=(0.4, 0.3, 0.2), heights_m=(0.0, 3, 6))
    for estimate in estimates:
        assert len(estimate.particles) <= 10
        assert np.exp(estimate.log_weights).sum() == pytest.approx(1.0)
        assert (np.diff(estimate.log_weights) <= 1e-12).all()


# --- the beginning --------------------------------------------------------------------------------


@pytest.mark.usefixtures("unchecked")
def test_a_first_image_that_is_all_but_sure_of_a_wrong_place_does_not_decide():
    """95 % of its samples are where the camera is not; later images cannot tell the two places apart."""
    localizer = new_localizer()
    first = localizer.update(seen_at(lifted(Poses.identity(), (0.0, 3.0)), (0.95, 0.05)), None)
    assert first.status == "ambiguous"
    assert weight_near(first, (0, 0, 3)) == pytest.approx(1 / 2.9)
    estimates, pose = walk(localizer, 100, shares=(0.5, 0.5), heights_m=(0.0, 3.0))
    assert all(estimate.status == "ambiguous" for estimate in estimates)
    assert weight_near(estimates[-1], lifted(pose, (3.0,)).translation[0]) > 0.25


def test_odometry_on_the_first_step_is_not_used():
    far = Odometry(Poses.exp(np.array([50.0, 0, 0, 0, 0, 0])), np.eye(6), 0.1)
    estimates = [new_localizer().update(seen_at(Poses.identity(1)), odometry) for odometry in (None, far)]
    assert_same_belief(*estimates, atol=0)


def test_a_first_image_that_says_nothing_is_refused_and_the_next_begins():
    localizer = new_localizer()
    for nothing in (PosePosterior.nothing(), FOREIGN):
        with pytest.raises(VaporTrackError, match="first image has no place"):
            localizer.update(nothing, None)
    assert_same_belief(
        localizer.update(seen_at(Poses.identity(1)), None), new_localizer().update(seen_at(Poses.identity(1)), None),
        atol=0,
    )  # fmt: skip


def test_a_first_image_that_is_foreign_gives_a_belief_that_is_lost_until_a_familiar_one_begins_it_anew():
    localizer = new_localizer()
    wrong = seen_at(Poses.exp(np.array([[30.0, 0, 0, 0, 0, 0]])), unfamiliarity=3.0)
    assert localizer.update(wrong, None).status == "lost"
    assert localizer.update(wrong, AHEAD).status == "lost"
    begun = localizer.update(seen_at(Poses.identity(1)), AHEAD)
    assert begun.status == "converged"
    assert weight_near(begun, (0, 0, 0)) == pytest.approx(1.0)


def test_there_is_nothing_to_predict_before_the_first_image():
    with pytest.raises(VaporTrackError, match="no image was localized yet"):
        new_localizer().predict(AHEAD)
