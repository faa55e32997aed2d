"""The mass that images leave unassigned, and what the weights of places are worth."""

from dataclasses import replace

import numpy as np
import pytest

from filtering.errors import VaporTrackError
from filtering.localizer import ParticleLocalizer
from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from tests.helpers.simulation import AHEAD, ERRORS, lifted, motion, new_localizer, seen_at, weight_near

CALIBRATED = replace(ERRORS, weight_power=1.0, possible_fraction=1e-6, length_m=1e-6, length_rad=1e-6)


def total(estimate):
    return estimate.unassigned + sum(mode.weight for mode in estimate.modes)


@pytest.mark.parametrize("outlier_probability", [0.05, 0.3, 0.6])
def test_the_first_image_is_right_with_the_probability_that_it_states(outlier_probability):
    noise = replace(ERRORS, outlier_probability=outlier_probability)
    first = new_localizer().update(seen_at(Poses.identity(1), noise=noise), None)
    assert first.modes[0].weight == pytest.approx(1.0 - outlier_probability)
    assert first.unassigned == pytest.approx(outlier_probability)
    assert first.status == {0.05: "converged", 0.3: "ambiguous", 0.6: "lost"}[outlier_probability]


def test_what_the_weights_of_an_image_lack_stays_unassigned():
    first = new_localizer().update(seen_at(lifted(Poses.identity(), (0.0, 9.0)), (0.3, 0.3)), None)
    assert first.unassigned == pytest.approx(1.0 - 0.6 * 0.95)
    assert total(first) == pytest.approx(1.0)


def test_a_second_view_that_fits_takes_what_was_unassigned_and_standing_does_not():
    noise = replace(ERRORS, outlier_probability=0.3)
    onward = motion(1.0, 0, 0, 0, 0, 0)
    localizer = new_localizer()
    localizer.update(seen_at(Poses.identity(1), noise=noise), None)
    for _ in range(30):
        stood = localizer.update(seen_at(Poses.identity(1), noise=noise), motion(0, 0, 0, 0, 0, 0))
    assert stood.unassigned == pytest.approx(0.3)
    there = Poses.stack([onward.previous_from_current])
    moved = localizer.update(seen_at(there, noise=noise), onward)
    assert moved.unassigned == pytest.approx(0.09, abs=0.01)
    assert moved.status == "converged"


def test_a_camera_that_was_carried_off_is_found_from_the_unassigned_mass():
    localizer, pose = new_localizer(), Poses.identity()
    weights = []
    for i in range(80):
        seen = pose if i < 40 else Poses(pose.rotation, pose.translation + np.array([0, 0, 8.0]))
        estimate = localizer.update(seen_at(Poses.stack([seen])), AHEAD if i else None)
        weights.append((estimate.modes[0].world_from_camera.translation[2] > 4.0, estimate.unassigned, total(estimate)))
        pose = pose @ AHEAD.previous_from_current
    up, unassigned, totals = map(np.array, zip(*weights, strict=True))
    assert not up[:40].any()
    assert up[65:].all()
    assert unassigned[39] < 0.01 < unassigned[40:].max()
    assert (totals <= 1.0 + 1e-9).all()


@pytest.mark.parametrize("share", [0.55, 0.8, 0.95])
def test_a_constant_preference_between_two_floors_never_adds_up(share):
    """100 lengths along two floors that look alike, of which the network prefers one."""
    localizer, pose = new_localizer(), Poses.identity()
    onward = motion(0.5, 0, 0, 0, 0, 0)
    for i in range(100):
        estimate = localizer.update(seen_at(lifted(pose, (0.0, 3.0)), (1.0 - share, share)), onward if i else None)
        assert estimate.status == "ambiguous"
        pose = pose @ onward.previous_from_current
    assert weight_near(estimate, (49.5, 0, 3)) == pytest.approx(
        np.sqrt(share) / (np.sqrt(share) + np.sqrt(1 - share)), abs=0.02
    )


def test_calibrated_weights_of_new_views_multiply_as_bayes_says():
    rng, localizer, pose, log_odds = np.random.default_rng(4), new_localizer(), Poses.identity(), 0.0
    for i in range(25):
        share = 1.0 / (1.0 + np.exp(-0.5 * rng.standard_normal() - 0.1))
        log_odds += np.log(share / (1.0 - share))
        posterior = seen_at(lifted(pose, (0.0, 3.0)), (share, 1.0 - share), noise=CALIBRATED)
        estimate = localizer.update(posterior, AHEAD if i else None)
        exact = 1.0 / (1.0 + np.exp(-log_odds))
        assert weight_near(estimate, pose.translation) == pytest.approx(exact, abs=0.02)
        pose = pose @ AHEAD.previous_from_current


def test_an_image_without_any_weight_is_no_first_one():
    nothing = PosePosterior.from_estimates(Poses.identity(2), 0.1, 0.1, ERRORS, weights=np.zeros(2))
    with pytest.raises(VaporTrackError, match="no place of any weight"):
        ParticleLocalizer(None, rng=np.random.default_rng(0)).update(nothing, None)
