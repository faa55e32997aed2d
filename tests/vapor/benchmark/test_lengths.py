"""Scenes at another scale: whatever is a length is scaled, and nothing else."""

from types import SimpleNamespace

import numpy as np
import pytest

from filtering.config import LocalizerConfig
from filtering.estimate import Mode
from filtering.motion import Odometry
from filtering.se3 import Poses
from sequences.odometry_fit.result import OdometryFit
from sequences.scenes import find_scene
from tests.helpers.corridors import corridor
from vapor.benchmark.evaluation.comparison import Comparison
from vapor.benchmark.evaluation.lengths import scaled_calibration, scaled_localizer, scaled_odometry
from vapor.benchmark.trials import run as trial_run
from vapor.benchmark.trials.trial import Segment, Trial
from vapor.checkpoints.calibration import Calibration
from vapor.tracking.loop import Belief
from vapor.tracking.methods import METHODS

pytestmark = pytest.mark.usefixtures("unchecked")


def test_a_calibration_is_scaled_with_the_odometry_that_it_found():
    fit = OdometryFit(
        (1e-4,) * 6,
        (2e-4,) * 6,
        (0.01,) * 6,
        20.0,
        0.01,
        0.02,
        (1e-3,) * 6,
        (0.1,) * 6,
        (0.1,) * 6,
        0.1,
        500,
        2,
        50.0,
        9.0,
        0,
    )
    motion = Odometry(Poses.exp(np.array([0.3, -0.1, 0.2, 0.1, 0.2, -0.3])), np.eye(6), 0.5)
    calibration = Calibration(odometry=fit)
    scaled = scaled_calibration(calibration, 30.0)
    expected = scaled_odometry(fit.restated(motion), 30.0)
    found = scaled.odometry.restated(scaled_odometry(motion, 30.0))
    np.testing.assert_allclose(found.covariance, expected.covariance, atol=1e-15)
    assert scaled.odometry.slow_errors.drift == pytest.approx((0.3, 0.3, 0.3, 0.01, 0.01, 0.01))
    assert scaled.odometry.slow_errors.scale == fit.slow_errors.scale
    assert scaled.errors == calibration.errors.scaled(30.0)
    assert scaled_calibration(calibration, 1.0) == calibration


def test_settings_of_the_filter_that_are_lengths_are_scaled():
    assert scaled_localizer(LocalizerConfig(), 1.0) == LocalizerConfig()
    scaled = scaled_localizer(LocalizerConfig(converged_std_m=0.2), 30.0)
    assert scaled.converged_std_m == pytest.approx(6.0)
    assert scaled.gap.speed_m_per_s == pytest.approx(30.0 * LocalizerConfig().gap.speed_m_per_s)


@pytest.mark.parametrize("priors", [None, 50])
@pytest.mark.parametrize("scale", [1.0, 30.0])
def test_floors_are_evaluated_in_the_lengths_of_the_scene(scale, priors, monkeypatch):
    """At another scale the poses are scaled back before whole floors are counted; of one floor none is right or not."""
    height = find_scene("corridor").floor_height_m
    assert height == 3.2
    truth = Poses(np.tile(np.eye(3), (4, 1, 1)), np.array([[x, 0.0, 0.0] for x in range(4)]))
    off = Poses(truth.rotation, truth.translation + np.array([[0.0, 0.0, height * up] for up in (1.05, 1, 0, 0)]))
    modes = tuple((Mode(off[i], 0.01 * np.eye(6), 1.0),) for i in range(4))
    beliefs = dict.fromkeys(("kalman", "gaussian_sum", "filter"), Belief(modes, ["ambiguous"] * 4))
    compared = Comparison(10**8 * np.arange(4), truth, dict.fromkeys(METHODS, off), beliefs, modes, 1, 1.0)
    monkeypatch.setattr(trial_run, "follow_trial", lambda trial, setup, replay: None)
    monkeypatch.setattr(trial_run, "compare", lambda followed: compared.scaled(scale))
    storeys = Poses.concatenate([corridor(0, 5, z_m=z) for z in (0.0, height)])
    given = SimpleNamespace(
        ablation="full", cue_images=0, checkpoint=lambda: SimpleNamespace(prior_poses=storeys[:priors])
    )
    for scene in ("corridor", "ceiling"):
        trial = Trial(scene, "cue", (Segment(0, 0, 4),), scale=scale)
        found = trial_run.localize(trial, given, given)  # pyright: ignore[reportArgumentType]
        told, belief = found["methods"]["smoothed"], found["belief"]["filter"]
        assert told.get("floor_accuracy") == (0.5 if priors is None else None)
        assert "sequences" not in found
        if scene == "corridor":
            assert told["floor"] == {"but_for_it": 1.0, "settled_images": 2, "settled_right": 1.0}
            assert belief["on_floor"]["images"] == 2
        else:
            assert "floor" not in told
            assert "on_floor" not in belief
