"""Regions of a mode hold what they say, after one image with Student t tails and after many."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2, f

from filtering.errors import VaporTrackError
from filtering.estimate import Mode, posterior_modes, squared_radius
from filtering.motion import Odometry
from filtering.se3 import Poses
from tests.helpers.simulation import ERRORS, STD, new_localizer, seen_at, walk

NOISE = replace(ERRORS, typical_std=tuple(STD), constant_fraction=0.0)


def test_a_mode_of_one_calibrated_image_has_the_regions_of_its_tails():
    rng = np.random.default_rng(0)
    seen = replace(seen_at(Poses.identity(), noise=NOISE), calibrated=True)
    nu = NOISE.degrees_of_freedom
    mode = new_localizer().update(seen, None).modes[0]
    assert mode.degrees_of_freedom == pytest.approx(nu)
    assert posterior_modes(seen)[0].degrees_of_freedom == nu
    tails = np.sqrt(nu / rng.chisquare(nu, (4000, 1)))
    truth = Poses.exp(tails * STD * rng.standard_normal((4000, 6)))
    for probability in (0.5, 0.9, 0.95):
        assert mode.contains(truth, probability).mean() == pytest.approx(probability, abs=0.025)


def test_a_mode_of_stated_covariances_has_gaussian_regions():
    mode = new_localizer().update(seen_at(Poses.identity(), noise=NOISE), None).modes[0]
    assert mode.squared_radius(0.9) == pytest.approx(chi2.ppf(0.9, 6))


def test_a_mode_of_many_images_becomes_gaussian_and_one_that_widens_gets_its_tails_back():
    estimates, _ = walk(new_localizer(), 80, noise=NOISE)
    assert estimates[-1].modes[0].degrees_of_freedom == np.inf  # stated
    localizer = new_localizer()
    pose = Poses.identity()
    step = Poses.exp(np.array([0.1, 0, 0, 0, 0, 0.02]))
    odometry = Odometry(step, np.diag([1e-4] * 6) ** 2, 0.1)
    of_step = []
    for _ in range(80):
        seen = replace(seen_at(pose, noise=NOISE), calibrated=True)
        of_step.append(localizer.update(seen, odometry).modes[0].degrees_of_freedom)
        pose = pose @ step
    assert of_step[0] == pytest.approx(NOISE.degrees_of_freedom)
    assert of_step[-1] > 10 * NOISE.degrees_of_freedom
    still = [localizer.update(replace(seen_at(pose, noise=NOISE), calibrated=True), odometry)]
    still.append(localizer.predict(None, elapsed_s=20.0))
    assert still[-1].modes[0].degrees_of_freedom == pytest.approx(NOISE.degrees_of_freedom)


def test_standing_still_buys_no_gaussian_regions():
    localizer = new_localizer()
    seen = replace(seen_at(Poses.identity(), noise=NOISE), calibrated=True)
    still = Odometry.still(0.03)
    for _ in range(100):
        mode = localizer.update(seen, still).modes[0]
    assert mode.degrees_of_freedom < 3 * NOISE.degrees_of_freedom


def test_squared_radii_are_those_of_the_distributions():
    assert squared_radius(0.9, np.array([4.0, np.inf])) == pytest.approx([6 * f.ppf(0.9, 6, 4), chi2.ppf(0.9, 6)])
    mode = Mode(Poses.identity(), np.eye(6), 1.0)
    assert mode.contains(Poses.exp(np.array([1.0, 0, 0, 0, 0, 0])), 0.5)
    assert not mode.contains(Poses.exp(np.array([4.0, 0, 0, 0, 0, 0])), 0.9)


@pytest.mark.parametrize("probability", [0.0, 1.0, 95.0, np.nan])
def test_a_region_of_no_probability_is_refused(probability):
    with pytest.raises(VaporTrackError, match=r"region of probability .* expected one between 0 and 1"):
        Mode(Poses.identity(), np.eye(6), 1.0).squared_radius(probability)
