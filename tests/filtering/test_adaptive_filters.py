"""Errors that are larger or smaller than modelled, in the filter and the baseline."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from filtering.adaptation import ErrorScale
from filtering.cameras import View
from filtering.config import GapConfig, LocalizerConfig
from filtering.kalman import KalmanConfig, KalmanLocalizer
from filtering.localizer import ParticleLocalizer
from filtering.posterior import PosePosterior
from filtering.se3 import Poses
from tests.helpers.modelled_walk import AHEAD, APART, SLOW, observed, scale_along, shifted, simulated, understated

pytestmark = pytest.mark.usefixtures("unchecked")

UP = np.array([0.0, 0.0, 9.0])

NEVER_CARRIED_OFF = LocalizerConfig(kidnap_per_view=0.0, max_kidnap_per_view=0.0, slow_errors=SLOW)


def filtered(path):
    localizer = ParticleLocalizer(None, NEVER_CARRIED_OFF, rng=np.random.default_rng(0))
    return [
        localizer.update(posterior, odometry).modes[0]
        for posterior, odometry in zip(path.posteriors, path.odometry, strict=True)
    ]


def followed(path):
    kalman = KalmanLocalizer(KalmanConfig(slow_errors=SLOW))
    return [
        kalman.update(posterior, odometry) for posterior, odometry in zip(path.posteriors, path.odometry, strict=True)
    ]


@pytest.mark.parametrize("localize", [filtered, followed])
def test_regions_grow_with_the_errors_and_hold_the_truth_more_often(localize, monkeypatch):
    held, widths = {True: [], False: []}, {True: [], False: []}
    for adapts in (True, False):
        if not adapts:
            monkeypatch.setattr(ErrorScale, "factor", 1.0)
        for seed in range(2):
            path = understated(simulated(seed), 4.0)
            modes = localize(path)[150::5]
            truth = path.truth[150::5]
            error = (Poses.stack([mode.world_from_camera for mode in modes]).inverse() @ truth).log()
            covariances = np.stack([mode.covariance for mode in modes])
            squared = np.einsum("ni,nij,nj->n", error, np.linalg.inv(covariances), error)
            held[adapts] += list(squared < chi2.ppf(0.9, 6))
            widths[adapts] += [mode.widest_std_m for mode in modes]
    assert np.mean(held[True]) > 0.75
    assert np.mean(held[False]) < np.mean(held[True]) - 0.2
    assert np.mean(widths[True]) > 1.1 * np.mean(widths[False])


@pytest.mark.parametrize("localize", [filtered, followed])
def test_regions_shrink_with_errors_that_are_smaller_and_still_hold_the_truth(localize, monkeypatch):
    path, held, widths = understated(simulated(0), 0.25), {}, {}
    for adapts in (True, False):
        if not adapts:
            monkeypatch.setattr(ErrorScale, "factor", 1.0)
        modes = localize(path)[150::5]
        error = (Poses.stack([mode.world_from_camera for mode in modes]).inverse() @ path.truth[150::5]).log()
        covariances = np.stack([mode.covariance for mode in modes])
        squared = np.einsum("ni,nij,nj->n", error, np.linalg.inv(covariances), error)
        held[adapts] = np.mean(squared < chi2.ppf(0.95, 6))
        widths[adapts] = np.mean([mode.widest_std_m for mode in modes])
    assert widths[True] < 0.8 * widths[False]
    assert held[True] > 0.8


@pytest.mark.parametrize("localize", [filtered, followed])
def test_errors_that_follow_the_model_leave_the_estimate_as_it_is_without(localize, monkeypatch):
    path = simulated(0)
    widths = []
    for adapts in (True, False):
        if not adapts:
            monkeypatch.setattr(ErrorScale, "factor", 1.0)
        widths.append(localize(path)[-1].widest_std_m)
    assert widths[0] == pytest.approx(widths[1], rel=0.1)


def test_a_gap_forgets_the_place_compared_with_and_keeps_what_was_found():
    path = understated(simulated(0), 4.0)
    gap = GapConfig(speed_m_per_s=0.0, turn_rad_per_s=0.0)
    localizer = ParticleLocalizer(None, replace(NEVER_CARRIED_OFF, gap=gap), rng=np.random.default_rng(0))
    for posterior, odometry in zip(path.posteriors, path.odometry, strict=True):
        estimate = localizer.update(posterior, odometry)
    nothing = PosePosterior.nothing(path.posteriors[0].errors)
    after = localizer.update(nothing, None, elapsed_s=0.0)
    np.testing.assert_allclose(after.covariances, estimate.covariances, rtol=1e-9)
    scale = scale_along(path)
    forgotten = observed(replace(scale, place=None).predict(AHEAD, APART), path.posteriors[0])
    assert (forgotten.total, forgotten.count) == (scale.total, scale.count)
    assert forgotten.place.translation == pytest.approx(path.posteriors[0].means.translation[0])


def test_images_that_say_nothing_are_not_compared():
    path = understated(simulated(0), 4.0)
    every_third = [
        posterior if i % 3 == 0 else replace(shifted(posterior, UP), unfamiliarity=2.0)
        for i, posterior in enumerate(path.posteriors)
    ]
    widths = []
    for posteriors in (every_third, [p if i % 3 == 0 else PosePosterior.nothing() for i, p in enumerate(every_third)]):
        widths.append(filtered(replace(path, posteriors=posteriors))[-1].covariance)
    np.testing.assert_allclose(widths[0], widths[1])


def test_each_camera_of_a_rig_has_its_own():
    """One of two errs nine times more than it says: the rig is localized about as if it said so, and knew the other."""
    one, other = simulated(0, 120), simulated(1, 120)
    seen = {"stated": other, "understated": understated(other, 9.0)}
    widths = {}
    for name, back in seen.items():
        localizer = ParticleLocalizer(None, NEVER_CARRIED_OFF, rng=np.random.default_rng(0))
        for here, there, odometry in zip(one.posteriors, back.posteriors, one.odometry, strict=True):
            views = [View(here, Poses.identity(), "front"), View(there, Poses.identity(), "back")]
            estimate = localizer.update(views, odometry)
        widths[name] = estimate.modes[0].widest_std_m
    assert widths["understated"] == pytest.approx(widths["stated"], rel=0.15)
